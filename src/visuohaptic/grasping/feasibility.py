"""Feasible grasps and their force limits (Alt 2016, Sec. 6.2)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.objects import StiffnessMap
from ..deformation import ShellModel, ShellObject
from ..deformation.nonlinear.contents import enclosed_gradient, tip_approach
from .force import Load, required_force_N
from .grasp_task import GraspTask
from .score import GraspScores

#: Minimum fraction of the finger's patch with wall in front of it.
MIN_OVERLAP = 0.5
#: The volume displaced by a pinch grows faster than the force: in nonlinear simulations of flat
#: sides twice as fast within the allowed deformation.
SPILL_MARGIN = 2.0
#: Relative standard deviation of the stiffness of a map that states none: that of a class's map for one of its objects, common
#: and local part, see ``recognition.touch.refinement.CLASS``.
UNSTATED_SIGMA = float(np.hypot(0.55, 0.25))


class Verdict(IntEnum):
    """The first constraint that a grasp violates."""

    FEASIBLE = 0
    NOTHING_OPPOSITE = 1
    TOO_WIDE = 2  #: for the gripper's opening
    PARTIAL_OVERLAP = 3  #: too little wall in front of a finger
    NEAR_FLOOR = 4  #: the finger would touch the supporting surface
    SLANTED = 5  #: outside the friction cone
    TOO_SOFT = 6  #: the deformation would be above its bound
    SPILLS = 7  #: contents would overflow
    TOO_WEAK = 8  #: the required force exceeds the applied one or the gripper's maximum


@dataclass(frozen=True, slots=True, eq=False)
class Spill:
    """An open container with liquid."""

    headspace_m3: float  #: free volume
    pressed_out_m3_per_N: Float[np.ndarray, "v"]  #: decrease of the volume by a pinch, linear

    @property
    def limit_N(self) -> Float[np.ndarray, "v"]:
        """Force at which it overflows, with the margin for large deformation."""
        with np.errstate(divide="ignore", invalid="ignore"):
            limit = self.headspace_m3 / (SPILL_MARGIN * np.maximum(self.pressed_out_m3_per_N, 0.0))
        return np.nan_to_num(limit, nan=np.inf, posinf=np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class FeasibilityMap:
    """Feasibility at each vertex; forces are of one finger."""

    verdict: Int[np.ndarray, "v"]  #: see :class:`Verdict`
    force_N: Float[np.ndarray, "v"]  #: force of the grasp
    needed_N: Float[np.ndarray, "v"]  #: required to hold the load; 0 if no load is known
    deformation_limit_N: Float[np.ndarray, "v"]  #: force below which the deformation stays under its bound
    spill_limit_N: Float[np.ndarray, "v"]
    width_m: Float[np.ndarray, "v"]  #: distance of the fingers
    confidence: float  #: of ``deformation_limit_N``, from the map's standard deviation
    #: standard deviation of a finger's force, by the hand's position
    unloaded_sigma_N: Float[np.ndarray, "v"]
    max_force_N: float  #: of the gripper

    @property
    def window_force_N(self) -> Float[np.ndarray, "v"]:
        """Force that holds the load, with ``confidence`` also at a finger that an error of the hand's position unloads.

        It does not exceed the limits of deformation, contents and gripper, unless the load requires more.
        """
        from scipy.special import ndtri

        upper = np.fmin(np.fmin(self.deformation_limit_N, self.spill_limit_N), self.max_force_N)
        force = self.needed_N + float(ndtri(self.confidence)) * self.unloaded_sigma_N
        out: np.ndarray = np.fmax(self.needed_N, np.fmin(force, upper))
        return out

    @property
    def feasible(self) -> Bool[np.ndarray, "v"]:
        """Mask of feasible grasps."""
        out: np.ndarray = self.verdict == Verdict.FEASIBLE
        return out


def spill_of(container: ShellObject, model: ShellModel, scores: GraspScores, fill: float) -> Spill:
    """Volume that each pinch displaces from an open container: one solve for all, by reciprocity.

    Parameters
    ----------
    container
        Open container, upright.
    model
        Its shell model.
    scores
        Scores of its stiffness map, with the finger positions.
    fill
        Fraction of the volume that is liquid, 0 to 1.
    """
    w = model.solve(enclosed_gradient(container, model))
    return Spill((1 - fill) * container.volume_m3, -tip_approach(scores.tips, w, model.mesh.vertices_m))


def relative_sigma(surface: StiffnessMap) -> Float[np.ndarray, "v"]:
    """Relative standard deviation of the stiffness; :data:`UNSTATED_SIGMA` where the map has none, 0 where the wall does not deform.

    Parameters
    ----------
    surface
        Stiffness map.
    """
    k = surface.stiffness_N_per_m
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = np.nan_to_num(surface.stiffness_sigma_N_per_m / k, nan=UNSTATED_SIGMA, posinf=0.0)
    return np.where(np.isinf(k), 0.0, relative)


def feasibility_map(
    surface: StiffnessMap,
    scores: GraspScores,
    force_N: float | Float[np.ndarray, "v"],
    task: GraspTask | None = None,
    *,
    load: Load | None = None,
    spill: Spill | None = None,
) -> FeasibilityMap:
    """Check every vertex against gripper, contact, deformation, contents and load (Alt 2016, Sec. 6.2).

    Parameters
    ----------
    surface, scores
        Stiffness map and its scores, see :func:`.grasp_scores`.
    force_N
        Applied force of each finger [N]; one number, or one per vertex.
    task
        Gripper, handling, bound of the deformation and the confidence with which it is respected. The stiffness is
        log-normal, see :func:`relative_sigma`.
    load
        The lifted load; without it, no force is rejected as too weak.
    spill
        For an open container with liquid, see :func:`spill_of`.
    """
    from scipy.special import ndtri

    task = task or GraspTask()
    gripper = task.gripper
    points, tips = surface.vertices_m, scores.tips
    first = points[tips.first]
    second = np.einsum("mk,mki->mi", tips.weights, points[tips.second])
    width = np.where(tips.valid, np.linalg.norm(second - first, axis=1), np.nan)
    k = surface.stiffness_N_per_m
    with np.errstate(invalid="ignore", divide="ignore"):
        limit = k * np.exp(-float(ndtri(task.confidence)) * relative_sigma(surface))
        limit *= task.parameters.max_deformation_m
    slant = scores.slant_rad
    needed = np.zeros(len(points))
    if load is not None:
        needed = required_force_N(load, first, second, slant, gripper, task.handling)
    force = np.broadcast_to(np.asarray(force_N, dtype=float), needed.shape)
    spill_limit = np.full(len(points), np.inf) if spill is None else spill.limit_N
    floor = points[np.unique(surface.faces), 2].min()
    checks = (
        (Verdict.NOTHING_OPPOSITE, ~tips.valid | np.isnan(k)),
        (Verdict.TOO_WIDE, width > gripper.opening_m),
        (
            Verdict.PARTIAL_OVERLAP,
            np.minimum(scores.overlap, scores.opposite(scores.overlap)) < MIN_OVERLAP,
        ),
        (Verdict.NEAR_FLOOR, points[:, 2] - floor < gripper.finger_radius_m),
        (Verdict.SLANTED, np.tan(np.minimum(slant, 1.57)) >= gripper.friction),
        (Verdict.TOO_SOFT, ~(force <= np.nan_to_num(limit, nan=0.0, posinf=np.inf))),
        (Verdict.SPILLS, force > spill_limit),
        (Verdict.TOO_WEAK, (needed > force) | (force > gripper.max_force_N)),
    )
    verdict = np.zeros(len(points), dtype=np.int64)
    for why, bad in reversed(checks):
        verdict[bad] = why
    # Where the wall does not deform, no error of the position is possible.
    unloaded = gripper.position_sigma_m * np.nan_to_num(k, nan=0.0, posinf=0.0)
    forces = force.copy(), needed, limit, spill_limit
    return FeasibilityMap(verdict, *forces, width, task.confidence, unloaded, gripper.max_force_N)
