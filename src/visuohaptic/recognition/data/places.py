"""Places of the stiffness features: 16 heights, four sides."""

#: As in :mod:`visuohaptic.deformation.maps.features`; repeated here because that import takes half a second.
HEIGHTS, SIDES = 16, ("x+", "x-", "y+", "y-")
#: A touch is a height 1 .. 16 and the axis along which the tips press, "x" or "y".
Touch = tuple[int, str]
