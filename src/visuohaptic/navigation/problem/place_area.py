"""Areas of the floor where pushed objects should end, or should not (Alt 2016, Sec. 4.3.1, goal map)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core.ranges import NON_NEGATIVE, check_ranges
from .outlines import outline_of


@dataclass(frozen=True, slots=True, eq=False)
class PlaceArea:
    """An area in which it costs extra if a pushed object ends there, or outside of it.

    Examples
    --------
    >>> PlaceArea("escape route", np.array([[0, 0], [2, 0], [2, 1], [0, 1]]), 30.0).prefer
    False
    """

    id: str
    outline_m: Float[np.ndarray, "p 2"]  #: corners in the map frame
    cost_s: float = field(metadata=NON_NEGATIVE)  #: that a better place is worth [s]
    prefer: bool = False  #: whether it costs to end outside of all such areas, instead of inside this one

    def __post_init__(self) -> None:
        check_ranges(self)
        object.__setattr__(self, "outline_m", outline_of(self.outline_m, "PlaceArea"))
