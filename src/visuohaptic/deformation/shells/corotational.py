"""A shell under large displacements and rotations, small strains (Alt 2016, Sec. 6.1.3).

Each triangle has a linear element in a corotating frame: the frame that best fits the deformed triangle
removes the rigid motion, and the linear stiffness is applied to the remainder. Forces are the
exact gradient of the strain energy, the tangent is their exact derivative.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from . import _corotational_kernels as kernels
from . import _shell_kernels
from ._front_kernels import constrain
from .factor import Factor, factorise
from .shell import ShellModel, enclosed_volume, volume_gradient

#: Gauge pressure [Pa] by enclosed volume [m^3], and its derivative [Pa/m^3].
PressureLaw = Callable[[float], tuple[float, float]]


@dataclass(frozen=True, slots=True, eq=False)
class ShellState:
    """A deformed shell."""

    points_m: Float[np.ndarray, "v 3"]  #: positions of the vertices
    rotations: Float[np.ndarray, "v 3 3"]  #: rotations of the vertices

    def moved(self, step: Float[np.ndarray, "v 6"]) -> ShellState:
        """The state after further displacements and spins.

        Parameters
        ----------
        step
            Displacements [m] and spins [rad] of each vertex, in world axes.
        """
        spins = np.ascontiguousarray(step[:, 3:])
        return ShellState(self.points_m + step[:, :3], kernels.rotate_nodes(self.rotations, spins))

    def step_to(self, other: ShellState) -> Float[np.ndarray, "v 6"]:
        """Displacements [m] and spins [rad] that lead to another state.

        Parameters
        ----------
        other
            State of the same shell.
        """
        turn = other.rotations @ self.rotations.swapaxes(1, 2)
        out = np.empty((len(turn), 6))
        out[:, :3] = other.points_m - self.points_m
        kernels.rotation_vectors(turn, out[:, 3:])
        return out


class CorotationalShell:
    """Forces and tangent of a :class:`.ShellModel` for any deformed state.

    Parameters
    ----------
    model
        Undeformed mesh, material, supports.
    pressure
        Pressure law of the contents, or None for an open container. The pressure follows the wall.
    lid
        Triangles over the mouth that close the volume and carry no stiffness; pressure on them is
        transferred to their rim only through the volume's gradient.
    lid_signs, lid_fraction
        For a part that represents several copies (:mod:`.symmetry_reduction`): the lid's
        corners are at these signs times the points, and this fraction of the lid belongs to the part.
    """

    def __init__(
        self,
        model: ShellModel,
        *,
        pressure: PressureLaw | None = None,
        lid: np.ndarray | None = None,
        lid_signs: np.ndarray | None = None,
        lid_fraction: float = 1.0,
    ) -> None:
        self.model = model
        self.pressure = pressure
        self.lid = np.zeros((0, 3), dtype=np.int64) if lid is None else np.asarray(lid, dtype=np.int64)
        self.lid_signs = np.ones((len(self.lid), 3, 3)) if lid_signs is None else np.asarray(lid_signs)
        self.lid_fraction = lid_fraction

    @cached_property
    def _elements(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        mesh = self.model.mesh
        return _shell_kernels.element_frames(mesh.vertices_m, mesh.faces, *self.model.sections)

    @cached_property
    def rest(self) -> ShellState:
        """The undeformed state."""
        return ShellState(self.model.mesh.vertices_m, np.tile(np.eye(3), (self.model.nodes, 1, 1)))

    def volume(self, state: ShellState) -> float:
        """Enclosed volume [m^3], including the lid.

        Parameters
        ----------
        state
            Deformed shell.
        """
        mesh = self.model.mesh
        a, b, c = self._lid_corners(state)
        over = self.lid_fraction / 6 * float(np.sum(a * np.cross(b, c)))
        return enclosed_volume(state.points_m, mesh.faces, mesh.fraction) + over

    def volume_gradient(self, state: ShellState) -> Float[np.ndarray, "v 6"]:
        """dV/du of the deformed shell [m^2].

        Parameters
        ----------
        state
            Deformed shell.
        """
        mesh = self.model.mesh
        out = np.zeros((self.model.nodes, 6))
        out[:, :3] = volume_gradient(state.points_m, mesh.faces, mesh.fraction)
        if len(self.lid):
            a, b, c = self._lid_corners(state)
            third = self.lid_fraction / 6 * np.cross(b - a, c - a)
            np.add.at(out[:, :3], self.lid, third[:, None] * self.lid_signs)
        return out

    def _lid_corners(self, state: ShellState) -> Float[np.ndarray, "3 l 3"]:
        return np.moveaxis(state.points_m[self.lid] * self.lid_signs, 1, 0)

    def energy(self, state: ShellState) -> float:
        """Strain energy of the wall [J].

        Parameters
        ----------
        state
            Deformed shell.
        """
        return self._evaluate(state, tangent=False)[2]

    def internal_force(self, state: ShellState) -> Float[np.ndarray, "v 6"]:
        """Internal forces of wall and springs [N], [N m], minus those of the enclosed pressure.

        Parameters
        ----------
        state
            Deformed shell.
        """
        return self._assemble(state, self._evaluate(state, tangent=False)[0])

    def linearised(self, state: ShellState) -> tuple[Float[np.ndarray, "v 6"], Tangent]:
        """Internal force and factorised tangent stiffness; those of :attr:`rest`, where every path begins, are kept.

        Parameters
        ----------
        state
            Deformed shell.
        """
        return self._at_rest if state is self.rest else self._linearised(state)

    @cached_property
    def _at_rest(self) -> tuple[Float[np.ndarray, "v 6"], Tangent]:
        return self._linearised(self.rest)

    def _linearised(self, state: ShellState) -> tuple[Float[np.ndarray, "v 6"], Tangent]:
        forces, matrices, _ = self._evaluate(state, tangent=True)
        mesh = self.model.mesh
        rank_one: tuple[np.ndarray, float] | None = None
        if self.pressure is not None:
            gauge_Pa, slope = self.pressure(self.volume(state))
            kernels.pressure_tangent(
                state.points_m, mesh.faces, np.asarray(mesh.fraction), gauge_Pa, matrices
            )
            gradient = np.where(self.model.fixed, 0.0, self.volume_gradient(state))
            rank_one = gradient.ravel(), -slope
        constrain(matrices, mesh.faces, self.model.fixed)
        factor = self._factor(matrices)
        return self._assemble(state, forces), Tangent(factor, rank_one)

    def with_pressure(self, pressure: PressureLaw | None) -> CorotationalShell:
        """The same wall with other contents.

        Parameters
        ----------
        pressure
            Pressure law of the contents, or None for an open container.
        """
        other = CorotationalShell(
            self.model,
            pressure=pressure,
            lid=self.lid,
            lid_signs=self.lid_signs,
            lid_fraction=self.lid_fraction,
        )
        other.__dict__["_elements"] = self._elements
        return other

    def _factor(self, matrices: Float[np.ndarray, "f 18 18"]) -> Factor:
        tree, diagonal = self.model.tree, self.model.support_diagonal
        if self.pressure is None:
            # A stable state has a definite tangent, and the Cholesky factorisation takes half the time.
            try:
                return factorise(tree, matrices, diagonal)
            except InputError:
                pass
        return factorise(tree, matrices, diagonal, definite=False)

    def _evaluate(self, state: ShellState, *, tangent: bool) -> tuple[np.ndarray, np.ndarray, float]:
        mesh = self.model.mesh
        forces = np.empty((len(mesh.faces), 18))
        matrices = np.empty((len(mesh.faces) if tangent else 0, 18, 18))
        frames, corners, stiffness = self._elements
        energy = kernels.forces_and_tangent(
            state.points_m, state.rotations, mesh.faces, frames, corners, stiffness, True, forces, matrices
        )
        return forces, matrices, energy

    def _assemble(self, state: ShellState, forces: Float[np.ndarray, "f 18"]) -> Float[np.ndarray, "v 6"]:
        faces = self.model.mesh.faces
        out = np.zeros((self.model.nodes, 6))
        for corner in range(3):
            part = forces[:, 6 * corner : 6 * corner + 6]
            for column in range(6):
                out[:, column] += np.bincount(faces[:, corner], part[:, column], self.model.nodes)
        if self.model.springs is not None:
            out += self.model.springs * self.rest.step_to(state)
        if self.pressure is not None:
            out -= self.pressure(self.volume(state))[0] * self.volume_gradient(state)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Tangent:
    """Factorised tangent stiffness, with the rank-one term of an enclosed gas."""

    factor: Factor
    rank_one: tuple[np.ndarray, float] | None  #: a and s of ``K + s a a^T``

    @property
    def sign(self) -> int:
        """Sign of the determinant: it changes at limit and bifurcation points."""
        if self.rank_one is None:
            return self.factor.negative
        a, s = self.rank_one
        return self.factor.negative * (1 if 1 + s * (a @ self.factor.solve(a)) >= 0 else -1)

    def solve(self, loads: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "n m"]:
        """Sherman-Morrison formula applied to the sparse factor.

        Parameters
        ----------
        loads
            Right-hand sides, (n, m).
        """
        if self.rank_one is None:
            return self.factor.solve(loads)
        a, s = self.rank_one
        both = self.factor.solve(np.column_stack([loads, a]))
        plain, along = both[:, :-1], both[:, -1]
        return plain - np.outer(along, s * (a @ plain) / (1 + s * (a @ along)))
