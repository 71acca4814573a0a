"""Rim grasps: pinches of the wall itself at an open mouth, from above, with one finger inside and one outside.

The two forces cancel within the wall, so the container is not squeezed; but the centre of mass is offset from the fingers by s
along their line. The moment W s is balanced by non-uniform pressure over the patches of radius r: if the pressure is linear
over a disc, with mean p and p (1 - u) to p (1 + u) from edge to edge, a finger with force N holds N r u / 4, and both twice that.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..core.geometry import vertex_normals
from ..core.measurement import GRAVITY_M_S2
from ..core.objects import StiffnessMap
from ..deformation import ShellObject, liquid_level_m
from .confirm import mouth_edges
from .feasibility import relative_sigma
from .force import Load, required_force_N, success_probability
from .grasp_task import Grasp, GraspTask
from .score import GraspScores, deformation_score

#: u at the required force: half of the value at which an edge of the patch lifts off.
UNEVEN = 0.5
#: Number of locations around the mouth: one per 30 degrees, so that an arm that reaches half of them has several options.
AROUND = 12


def rim_grasps(
    container: ShellObject, surface: StiffnessMap, scores: GraspScores, task: GraspTask, load: Load
) -> list[Grasp]:
    """Pinches of the rim that hold the load, best first.

    Parameters
    ----------
    container
        Upright container; no result if it is closed, or filled up to the fingers.
    surface, scores
        Its stiffness map and the scores of its vertices.
    task
        Gripper, handling, and the applied force; the required one by default.
    load
        The load to lift.

    Notes
    -----
    The moment bends the wall like two forces W s / r at the edges of the patch; with the stiffness of a single pinch there, the
    deformation is overestimated. Scores are those of Alt 2016, Sec. 6.2, except for the contact: forces are normal to the wall.
    """
    gripper, radius = task.gripper, max(task.gripper.finger_radius_m, 1e-3)
    if task.closed or not len(container.lid):
        return []
    points, faces = container.mesh.vertices_m, container.mesh.faces
    normal, used, spread = vertex_normals(points, faces), np.unique(faces), relative_sigma(surface)
    wet_m = points[:, 2].min() + (liquid_level_m(container, task.fill) if task.fill else 0.0)
    mouth = np.unique(mouth_edges(container))
    angle = np.arctan2(
        points[mouth, 1] - container.axis_point_m[1], points[mouth, 0] - container.axis_point_m[0]
    )
    mouth = mouth[np.argsort(angle)][:: max(1, len(mouth) // AROUND)]
    weight_N = load.mass_kg * (GRAVITY_M_S2 + task.handling.acceleration_m_per_s2)
    out = []
    for corner in mouth:
        down = normal[corner, 2] * normal[corner] - np.array([0.0, 0.0, 1.0])
        target = points[corner] + radius * down / max(float(np.linalg.norm(down)), 1e-9)
        vertex = int(used[np.argmin(np.linalg.norm(points[used] - target, axis=1))])
        inward = -normal[vertex]
        lever_m = float(abs((np.array(load.centre_m) - points[vertex]) @ inward))
        bend_m = float(weight_N * lever_m / radius / surface.stiffness_N_per_m[vertex])
        needed = _needed_N(points[vertex], inward, load, task)
        force = needed if task.force_N is None else task.force_N
        parts = {
            "contact": float(np.clip(task.parameters.contact_weight * scores.overlap[vertex], 0.0, 1.0)),
            "curvature": float(scores.curvature[vertex]),
            "height": float(scores.height[vertex]),
            "deformation": float(deformation_score(np.array([bend_m]), task.parameters)[0]),
        }
        score = float(np.prod(list(parts.values())))
        holds = needed <= force <= gripper.max_force_N and points[vertex, 2] - radius > wet_m
        if not holds or score < task.min_score or not np.isfinite(bend_m):
            continue
        wall = (
            0.5 * float(np.asarray(container.mesh.thickness_m)[(faces == vertex).any(axis=1)].mean()) * inward
        )
        first, second = points[vertex] - wall, points[vertex] + wall
        args = np.array([force]), np.array([needed]), np.zeros(1)
        success = float(success_probability(*args, load, gripper, task.handling)[0])
        out.append(
            Grasp(
                vertex, first, second, inward, score, parts, force, needed, float("inf"), float("inf"), bend_m,
                bend_m * spread[vertex], 2 * float(np.linalg.norm(wall)), score, success, weight_N * lever_m / radius * bend_m,
                rim=True,
            )
        )  # fmt: skip
    return sorted(out, key=lambda grasp: -grasp.score)


def _needed_N(
    place_m: Float[np.ndarray, "3"], inward: Float[np.ndarray, "3"], load: Load, task: GraspTask
) -> float:
    """Force of each finger that neither slips nor exceeds the pressure gradient."""
    offset = np.array(load.centre_m) - place_m
    along = float(offset @ inward)
    x, y, z = place_m + offset - along * inward
    beside = replace(load, centre_m=(float(x), float(y), float(z)))
    ends = place_m[None] - 1e-3 * inward, place_m[None] + 1e-3 * inward
    slip = required_force_N(beside, *ends, np.zeros(1), task.gripper, task.handling)
    weight_N = load.mass_kg * (GRAVITY_M_S2 + task.handling.acceleration_m_per_s2)
    turn = 2 * weight_N * abs(along) / (UNEVEN * max(task.gripper.finger_radius_m, 1e-3))
    return max(float(slip[0]), task.handling.safety * turn)
