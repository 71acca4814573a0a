"""Simulation of a grasp under large deformation: check that the wall holds (Alt 2016, Secs. 6.1.3, 6.4.2).

The map is linear. A thin wall softens, snaps through, and rotates under the finger; the
corotational shell model includes this. One grasp takes seconds, so only selected grasps are simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..core import POSITIVE, InputError, check_numbers
from ..core.geometry import vertex_normals
from ..deformation import Contents, EquilibriumPath, PinchPlane, ShellObject, contained_curve
from ..deformation.maps.curve_features import MAX_ITERATIONS
from ..deformation.shells.shell import ShellModel, enclosed_volume
from ..deformation.shells.stiffness_map import DualTips, dual_tip_compliance, opposing_points
from ..io.meshes.mesh_state import boundary_edges

#: End of the curve as a multiple of the deformation bound, and its number of steps.
REACH, STEPS = 1.6, 8
_Path = tuple[EquilibriumPath, list[Float[np.ndarray, "v 3"]]]


@dataclass(frozen=True, slots=True, eq=False)
class Confirmation:
    """Result of the nonlinear simulation of one grasp."""

    holds: bool  #: the grasp passed all checks
    reason: str  #: failed checks
    force_N: float
    deformation_m: float  #: of one side, at the force; infinite if the wall buckles before
    slant_rad: float  #: between force and the wall's inward normal, at the force or at the bound
    pressed_out_m3: float  #: decrease of the volume, at the force or at the bound
    curve_m: Float[np.ndarray, "k"]  #: deformations of the force-deformation curve, up to the force
    curve_N: Float[np.ndarray, "k"]  #: its forces
    shape_m: Float[np.ndarray, "v 3"]  #: vertices at the force, or at the end of the curve


def pinch_at(container: ShellObject, vertex: int) -> DualTips:
    """The pair of contacts of one vertex and the point across the height axis.

    Parameters
    ----------
    container
        Parametric or imported container.
    vertex
        Vertex of the first finger.

    Raises
    ------
    InputError
        Invalid vertex, or no opposite wall.
    """
    if not 0 <= vertex < len(container.mesh.vertices_m):
        raise InputError(
            "pinch_at", f"found {vertex}, expected 0 to {len(container.mesh.vertices_m) - 1}", field="vertex"
        )
    tips = opposing_points(container.mesh, np.array([vertex]), axis_point_m=container.axis_point_m)
    if not tips.valid[0]:
        raise InputError("pinch_at", f"vertex {vertex} has no wall across the height axis")
    return tips


def confirm_grasp(
    container: ShellObject,
    pinched: int | DualTips,
    force_N: float,
    *,
    contents: Contents | None = None,
    headspace_m3: float | None = None,
    max_deformation_m: float = 0.005,
    friction: float | None = None,
    model: ShellModel | None = None,
) -> Confirmation:
    """Close two tips on a vertex and its opposite until the force is reached.

    Parameters
    ----------
    container
        Parametric or imported container.
    pinched
        Vertex of the first finger, with the second opposite, or one pair of contacts.
    force_N
        Force of each finger.
    contents
        Enclosed gas and liquid; open by default.
    headspace_m3
        For an open container with liquid: volume that may be displaced before it overflows.
    max_deformation_m
        Bound of the deformation of one side.
    friction
        mu of the fingers: the wall may rotate by at most ``atan(mu)``.
    model
        The container's shell model, if already available.
    """
    check_numbers("confirm_grasp", POSITIVE, force_N=force_N)
    tips = pinched if isinstance(pinched, DualTips) else pinch_at(container, pinched)
    compliance, walk = _walk(container, pinched, contents, model)
    # A stiff location reaches the force long before the bound; a soft one may soften further.
    bound, near = REACH * max_deformation_m, force_N * max(compliance, 1e-12)
    steps = [far * k / STEPS for far in (near, bound) for k in range(1, STEPS + 1)]
    path, walls = walk(
        [at for k, at in enumerate(steps) if at <= bound and (k < STEPS or at > near)], force_N
    )
    at = np.concatenate([[0.0], path.control_m])
    load = np.concatenate([[0.0], path.load])
    shapes = [container.mesh.vertices_m, *walls]
    reached = np.flatnonzero(load >= force_N)
    if len(reached):
        # Up to the first crossing: a snap-through may follow.
        k = int(reached[0])
        fraction = (force_N - load[k - 1]) / (load[k] - load[k - 1])
        deformation = float(at[k - 1] + fraction * (at[k] - at[k - 1]))
        shape = shapes[k - 1] + fraction * (shapes[k] - shapes[k - 1])
    else:
        deformation, shape = float("inf"), shapes[-1]
    slant = _slant_rad(container, tips, shape)
    pressed_out = _volume_m3(container, container.mesh.vertices_m) - _volume_m3(container, shape)
    reason = ""
    if deformation > max_deformation_m:
        reached_text = (
            f"{1e3 * deformation:.1f} mm" if np.isfinite(deformation) else f"over {1e3 * at[-1]:.1f} mm"
        )
        reason = f"deforms by {reached_text} under {force_N:.3g} N, limit {1e3 * max_deformation_m:.3g} mm"
        if not path.complete:
            reason += f" ({path.reason})"
    elif headspace_m3 is not None and pressed_out > headspace_m3:
        reason = f"presses out {1e6 * pressed_out:.1f} ml, free are {1e6 * headspace_m3:.1f} ml"
    elif friction is not None and np.tan(slant) >= friction:
        reason = f"the wall turns away by {np.degrees(slant):.1f} degrees, friction holds {np.degrees(np.arctan(friction)):.1f}"
    return Confirmation(not reason, reason, force_N, deformation, slant, pressed_out, at, load, shape)


def _walk(
    container: ShellObject, pinched: int | DualTips, contents: Contents | None, model: ShellModel | None
) -> tuple[float, Callable[[Sequence[float], float], _Path]]:
    """Approach of the tips per newton without contents [m/N]; and the path to deformations or a force, with the wall at each point.

    A pinch across the height axis is computed on the symmetric part of the object.
    """
    if not isinstance(pinched, DualTips):
        plane = PinchPlane.through(container, pinched)
        return float(plane.linear(pinched).sum()), lambda steps, force_N: plane.path(
            pinched, steps, contents, max_iterations=MAX_ITERATIONS, until_load=force_N
        )
    model = model or container.model()

    def walk(steps: Sequence[float], force_N: float) -> _Path:
        path = contained_curve(
            container, model, pinched, 0, steps, contents, max_iterations=MAX_ITERATIONS, until_load=force_N
        )
        return path, [point.state.points_m for point in path.points]

    return float(dual_tip_compliance(model, pinched)[0]), walk


def _volume_m3(container: ShellObject, points: Float[np.ndarray, "v 3"]) -> float:
    """Enclosed volume with the mouth closed by a triangle fan: a deformed mouth is not plane, and a fan has no preferred chord.

    Without the part under a foot that a lid closes, which is constant: it is clamped.
    """
    wall = enclosed_volume(points, container.mesh.faces, container.mesh.fraction)
    rim = mouth_edges(container)
    if not len(rim):
        return wall
    centre = points[rim[:, 0]].mean(axis=0)
    a, b = points[rim[:, 0]], points[rim[:, 1]]
    return wall + float(np.einsum("i,fi->", centre, np.cross(a, b))) / 6


def mouth_edges(container: ShellObject) -> Int[np.ndarray, "e 2"]:
    """Edges around the mouth of an open container, as vertex pairs; none for a closed one.

    The lids of an imported mesh may also close its foot.

    Parameters
    ----------
    container
        Parametric or imported container.
    """
    edges, height = boundary_edges(container.lid), container.mesh.vertices_m[:, 2]
    upper = height[edges].mean(axis=1) > 0.5 * (height.min() + height.max())
    return np.asarray(edges[upper])


def _slant_rad(container: ShellObject, tips: DualTips, points: Float[np.ndarray, "v 3"]) -> float:
    """Larger of the angles between each finger's force and the deformed wall's inward normal."""
    normal = vertex_normals(points, container.mesh.faces)
    force = tips.direction[0]
    first = -normal[tips.first[0]]
    second = -(tips.weights[0] @ normal[tips.second[0]])
    second = second / max(float(np.linalg.norm(second)), 1e-12)
    return float(np.arccos(np.clip(min(first @ force, -(second @ force)), -1, 1)))
