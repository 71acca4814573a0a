"""Results of load stepping: equilibrium states in the order they were reached."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..shells.corotational import ShellState


@dataclass(frozen=True, slots=True, eq=False)
class PathPoint:
    """One equilibrium state."""

    load: float  #: lambda, times the reference load
    control_m: float  #: control displacement
    state: ShellState
    iterations: int  #: Newton iterations of this point, including steps that were cut
    stable: bool  #: the determinant of the tangent is positive


@dataclass(frozen=True, slots=True, eq=False)
class EquilibriumPath:
    """Points in the order they were reached, without the undeformed state."""

    points: tuple[PathPoint, ...]
    complete: bool  #: every requested point was reached
    reason: str = ""  #: reason if it is not complete

    @property
    def load(self) -> Float[np.ndarray, "k"]:
        """lambda of each point."""
        return np.array([point.load for point in self.points])

    @property
    def control_m(self) -> Float[np.ndarray, "k"]:
        """Control displacement of each point [m]."""
        return np.array([point.control_m for point in self.points])

    @property
    def iterations(self) -> int:
        """Newton iterations of the whole path."""
        return sum(point.iterations for point in self.points)
