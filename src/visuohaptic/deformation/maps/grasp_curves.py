"""Force-deformation curve of one grasp on a container, under large deformation (Alt 2016, Sec. 6.1.6).

Where object and pinch are symmetric, only a half or a quarter of the object is computed; the result
is that of the whole object.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ...core.errors import InputError
from ...core.objects import SIDES
from ...core.ranges import check_choice, check_numbers, finite_array, within
from ..nonlinear.contents import Contents
from ..nonlinear.equilibrium_path import EquilibriumPath
from ..nonlinear.load_stepping import follow_displacement, reach_loads
from ..nonlinear.self_contact import SelfContactGuard
from ..shapes.mesher import ShellObject
from ..shapes.symmetry_reduction import SymmetricPart, symmetric_part
from ..shells.corotational import CorotationalShell, PressureLaw
from ..shells.stiffness_map import DualTips, opposing_points, tip_loads
from ..shells.surface_stress import surface_stress

#: Mean deformations of both tips at which a curve is computed by default [m].
DEFORMATIONS_m = (0.0005, 0.001, 0.002, 0.003, 0.005, 0.008)

_WALKS: dict[str, Any] = {"deformation_m": follow_displacement, "force_N": reach_loads}


@dataclass(frozen=True, slots=True, eq=False)
class GraspCurve:
    """Force-deformation curve of one dual-tip grasp, without the undeformed state."""

    force_N: Float[np.ndarray, "k"]  #: of one tip
    deformation_m: Float[np.ndarray, "k"]  #: mean of both tips
    first_m: Float[np.ndarray, "k"]  #: of the first tip
    second_m: Float[np.ndarray, "k"]  #: of the opposite tip
    gauge_Pa: Float[np.ndarray, "k"]  #: pressure of the contents; 0 when open
    stable: Bool[np.ndarray, "k"]  #: the state is stable at this force
    stress_Pa: Float[np.ndarray, "k"]  #: largest von Mises stress, see :func:`.surface_stress`
    point_m: Float[np.ndarray, "3"]  #: of the first tip, undeformed
    opposite_m: Float[np.ndarray, "3"]  #: of the second
    complete: bool  #: every requested point was reached
    reason: str  #: reason if it is not complete
    copies: int  #: symmetry: 4: a quarter was computed, 2: a half, 1: the whole
    nodes: int  #: number of computed vertices
    iterations: int  #: Newton iterations


class PinchPlane:
    """All pinches of an object along one direction: their common data are computed once.

    Parameters
    ----------
    container
        The object.
    angle_rad
        Direction about the height axis, from x+ towards y+.
    symmetric
        False computes the whole object even if it is symmetric.
    one_way
        Halve all cells along the same diagonal, see :func:`.symmetric_part`.
    part
        The part that represents the object, if it is known.
    """

    def __init__(
        self,
        container: ShellObject,
        angle_rad: float = 0.0,
        *,
        symmetric: bool = True,
        one_way: bool = False,
        part: SymmetricPart | None = None,
    ) -> None:
        self.container, self.angle_rad = container, angle_rad
        self.part = part or symmetric_part(container, angle_rad=angle_rad, reduce=symmetric, one_way=one_way)
        lid, signs = self.part.lid
        self._shell = CorotationalShell(
            self.part.model, lid=lid, lid_signs=signs, lid_fraction=1.0 / self.part.copies
        )
        self._filled: dict[Contents | None, CorotationalShell] = {}

    @classmethod
    def through(cls, container: ShellObject, vertex: int, *, symmetric: bool = True) -> PinchPlane:
        """The plane of a pinch across the height axis at a vertex.

        Parameters
        ----------
        container
            The object.
        vertex
            Location of the first tip.
        symmetric
            False computes the whole object even if it is symmetric.
        """
        away = container.mesh.vertices_m[vertex, :2] - np.array(container.axis_point_m)
        return cls(container, float(np.arctan2(away[1], away[0])), symmetric=symmetric)

    @cached_property
    def _guard(self) -> SelfContactGuard:
        return SelfContactGuard(self.part.whole)

    def curve(
        self,
        vertex: int,
        *,
        deformation_m: Sequence[float] = DEFORMATIONS_m,
        force_N: Sequence[float] | None = None,
        contents: Contents | None = None,
        max_iterations: int = 5000,
    ) -> GraspCurve:
        """Pinch at a vertex, see :func:`grasp_curve`.

        Parameters
        ----------
        vertex
            Location of the first tip.
        deformation_m
            Mean deformations of both tips, ascending [m].
        force_N
            Alternative: forces of one tip, ascending [N].
        contents
            Contents; open by default.
        max_iterations
            Maximum Newton iterations of the whole curve, which ends when they are used up.

        Raises
        ------
        InputError
            The vertex is fixed, has no opposite wall, or does not lie in this plane.
        """
        name, targets = ("deformation_m", deformation_m) if force_N is None else ("force_N", force_N)
        path, walls, spent = self._walked(vertex, name, targets, contents, max_iterations=max_iterations)
        return replace(self._read(path, walls, self._with(contents), vertex), iterations=spent)

    def path(
        self, vertex: int, deformation_m: Sequence[float], contents: Contents | None = None, **limits: float
    ) -> tuple[EquilibriumPath, list[Float[np.ndarray, "v 3"]]]:
        """Equilibria of a pinch until walls touch, and the vertices of the whole object at each [m].

        Parameters
        ----------
        vertex, deformation_m, contents
            As of :meth:`curve`.
        **limits
            As of :func:`.contained_curve`.
        """
        path, walls, _spent = self._walked(vertex, "deformation_m", deformation_m, contents, **limits)
        cosine, sine = np.cos(self.angle_rad), np.sin(self.angle_rad)
        back = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        rest = self.part.whole.mesh.vertices_m
        return path, [self.container.mesh.vertices_m + (wall - rest) @ back for wall in walls]

    def linear(self, vertex: int, contents: Contents | None = None) -> Float[np.ndarray, "2"]:
        """Deformation of each tip per newton of one tip, for small deformation [m/N].

        Parameters
        ----------
        vertex
            Location of the first tip.
        contents
            Contents; open by default.
        """
        tips, load = self._pinch(vertex)
        shell = self._with(contents)
        moved = shell.linearised(shell.rest)[1].solve(load.reshape(-1, 1)).reshape(load.shape)
        return self._tips_moved(self.part.expand(moved[:, :3]), tips)

    def can_pinch(self, vertex: int) -> bool:
        """Whether the vertex can move and has an opposite wall.

        Parameters
        ----------
        vertex
            Location of the first tip.
        """
        return bool(not self.container.fixed[vertex] and self._across(vertex).valid[0])

    def _across(self, vertex: int) -> DualTips:
        whole = self.part.whole
        # Along the plane's direction, even where a vertex is slightly off the axis.
        beside = float(whole.mesh.vertices_m[vertex, 1])
        return opposing_points(whole.mesh, np.array([vertex]), axis_point_m=(0.0, beside))

    def _pinch(self, vertex: int) -> tuple[DualTips, Float[np.ndarray, "p 6"]]:
        """The pair of tips, and the fraction of the load of 1 N on each tip that acts on the part."""
        part, whole = self.part, self.part.whole
        tips = self._across(vertex)
        points = self.container.mesh.vertices_m
        where = f"({', '.join(f'{value:.4g}' for value in points[vertex])}) m"
        if not tips.valid[0]:
            raise InputError("grasp_curve", f"no wall across the height axis from {where}")
        if whole.fixed[vertex]:
            raise InputError("grasp_curve", f"the wall is clamped at {where}", remedy="choose a higher point")
        load = tip_loads(len(points), tips)[:, [0]].toarray().reshape(-1, 6)
        gathered = part.gather(load)
        shared = gathered[part.image, :3] / np.bincount(part.image)[part.image, None] * part.signs
        if not np.allclose(shared, load[:, :3], atol=1e-6):
            raise InputError("grasp_curve", f"the pinch at {where} is not along this plane")
        return tips, gathered / part.copies

    @staticmethod
    def _tips_moved(moved: Float[np.ndarray, "v 3"], tips: DualTips) -> Float[np.ndarray, "2"]:
        first = tips.direction[0] @ moved[tips.first[0]]
        second = -tips.direction[0] @ (tips.weights[0] @ moved[tips.second[0]])
        return np.array([first, second])

    def _walked(
        self,
        vertex: int,
        name: str,
        targets: Sequence[float],
        contents: Contents | None,
        **limits: float,
    ) -> tuple[EquilibriumPath, list[np.ndarray], int]:
        """Path until walls touch, the turned wall at each point, and all iterations."""
        _tips, load = self._pinch(vertex)
        path = _WALKS[name](
            self._with(contents), load, _ascending(targets, name),
            control=load * (self.part.copies / 2), **limits,
        )  # fmt: skip
        walls = [self.part.expand(point.state.points_m) for point in path.points]
        kept = self._guard.cut(path, walls, self.container.mesh.vertices_m)
        return kept, walls[: len(kept.points)], path.iterations

    def _with(self, contents: Contents | None) -> CorotationalShell:
        if contents not in self._filled:
            self._filled[contents] = self._shell.with_pressure(self._law(contents))
        return self._filled[contents]

    def _law(self, contents: Contents | None) -> PressureLaw | None:
        # The part's own undeformed volume: with cells halved along one diagonal it differs slightly from that of the whole.
        copies = self.part.copies
        rest_m3 = copies * self._shell.volume(self._shell.rest)
        law = None if contents is None else contents.law(rest_m3)
        if law is None:
            return None

        def pressure(volume: float) -> tuple[float, float]:
            gauge, slope = law(copies * volume)
            return gauge, copies * slope

        return pressure

    def _read(
        self, path: EquilibriumPath, walls: list[np.ndarray], shell: CorotationalShell, vertex: int
    ) -> GraspCurve:
        part, tips = self.part, self._across(vertex)
        rest = part.whole.mesh.vertices_m
        original = self.container.mesh.vertices_m
        rows = []
        for point, wall in zip(path.points, walls, strict=True):
            gauge = shell.pressure(shell.volume(point.state))[0] if shell.pressure else 0.0
            own = self._tips_moved(wall - rest, tips)
            rows.append((point.load, point.control_m, *own, gauge, point.stable))
        force, mean, first, second, gauges, stable = np.array(rows, dtype=float).reshape(-1, 6).T
        shapes = np.reshape(walls, (-1, *rest.shape))
        stresses = surface_stress(self.container.mesh, self.container.material, shapes).max(axis=1)
        return GraspCurve(
            force,
            mean,
            first,
            second,
            gauges,
            stable > 0,
            stresses,
            original[vertex],
            tips.weights[0] @ original[tips.second[0]],
            path.complete,
            path.reason,
            part.copies,
            part.model.nodes,
            path.iterations,
        )


def grasp_curve(
    container: ShellObject,
    *,
    height_m: float | None = None,
    side: str = "x+",
    point_m: Sequence[float] | None = None,
    deformation_m: Sequence[float] = DEFORMATIONS_m,
    force_N: Sequence[float] | None = None,
    contents: Contents | None = None,
    symmetric: bool = True,
) -> GraspCurve:
    """Force-deformation curve of one grasp.

    Parameters
    ----------
    container
        Parametric or imported container, see :func:`.load_object`.
    height_m, side
        Location: height above the foot, on the side x+, x-, y+ or y-; half the height by default.
    point_m
        Alternative: the vertex nearest to this point is pinched.
    deformation_m
        Mean deformations of both tips, ascending.
    force_N
        Alternative: forces of one tip, ascending. Where the wall snaps through, the next stable state
        at this force is taken.
    contents
        Open by default.
    symmetric
        False computes the whole object even if it is symmetric.

    Examples
    --------
    >>> from visuohaptic.deformation import load_object
    >>> found = grasp_curve(load_object("bottle", around=16), deformation_m=[1e-4])
    >>> found.copies, found.complete
    (4, True)
    """
    vertex = side_vertex(container, side, height_m) if point_m is None else nearest_vertex(container, point_m)
    plane = PinchPlane.through(container, vertex, symmetric=symmetric)
    return plane.curve(vertex, deformation_m=deformation_m, force_N=force_N, contents=contents)


def side_vertex(container: ShellObject, side: str = "x+", height_m: float | None = None) -> int:
    """The vertex on a side at a height.

    Parameters
    ----------
    container
        Parametric or imported container.
    side
        One of ``x+``, ``x-``, ``y+``, ``y-``.
    height_m
        Above the foot [m]; half the height by default.
    """
    check_choice("side_vertex", SIDES, side, field="side")
    level = 0.5 * container.height_m if height_m is None else float(height_m)
    check_numbers("side_vertex", within(0, container.height_m), height_m=level)
    points = container.mesh.vertices_m - np.array(
        [*container.axis_point_m, container.mesh.vertices_m[:, 2].min()]
    )
    axis, sign = "xy".index(side[0]), 1.0 if side[1] == "+" else -1.0
    used = np.unique(container.surface_faces)
    some = points[used]
    # On the side: as close to level and plane as any vertex, and not on a cap.
    reach = sign * some[:, axis]
    score = np.hypot(some[:, 2] - level, some[:, 1 - axis])
    score[reach <= 0.25 * reach.max()] = np.inf
    return int(used[np.argmin(score)])


def nearest_vertex(container: ShellObject, point_m: Sequence[float]) -> int:
    """The vertex of the wall that is nearest to a point.

    Parameters
    ----------
    container
        Parametric or imported container.
    point_m
        In the frame of its mesh [m].

    Raises
    ------
    InputError
        Not three finite numbers.
    """
    point = finite_array("grasp_curve", point_m, 3, field="point_m")
    used = np.unique(container.mesh.faces)
    return int(used[np.argmin(np.linalg.norm(container.mesh.vertices_m[used] - point, axis=1))])


def _ascending(values: Sequence[float], name: str) -> list[float]:
    found = finite_array("grasp_curve", values, None, field=name)
    if not (np.diff(found, prepend=0.0) > 0).all():
        raise InputError("grasp_curve", f"found {values}, expected ascending numbers > 0", field=name)
    return found.tolist()
