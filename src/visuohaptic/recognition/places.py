"""Where stiffness features are: 16 heights, four sides."""

__all__ = ["HEIGHTS", "SIDES"]

#: As in :mod:`visuohaptic.deformation.features`; repeated here because that import takes half a second.
HEIGHTS, SIDES = 16, ("x+", "x-", "y+", "y-")
