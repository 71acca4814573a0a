"""Places of the stiffness features: 16 heights, four sides."""

from ...core.objects import HEIGHTS, SIDES

__all__ = ["HEIGHTS", "SIDES", "Touch"]

#: A touch is a height 1 .. 16 and the axis along which the tips press, "x" or "y".
Touch = tuple[int, str]
