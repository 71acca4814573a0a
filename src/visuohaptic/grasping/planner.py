"""Ranked grasps of one object (Alt 2016, Secs. 6.2, 7.2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int

from ..core import InputError, StiffnessMap, at_least, check_numbers
from ..deformation import GraspCoupling, ShellModel, ShellObject, couple, is_round
from ..deformation.maps.confidence_band import object_map, object_stiffness
from ..deformation.nonlinear.contents import Contents, enclosed_gradient, tip_approach
from ..deformation.shells.stiffness_map import DualTips, antipodal_points, opposing_points
from .approach import ApproachSpace, find_approach
from .confirm import Confirmation, confirm_grasp
from .feasibility import FeasibilityMap, Spill, Verdict, feasibility_map, relative_sigma, spill_of
from .force import Load, object_load, success_probability
from .grasp_task import Grasp, GraspTask
from .rim import rim_grasps
from .score import GraspScores, grasp_scores

#: Duration of the arm motion [s], or another cost; infinite if the goal is not reachable.
ArmCost = Callable[[Grasp], float]
#: Scores under a force, spilling, and rim grasps.
_Rated = tuple[GraspScores, Spill | None, list[Grasp]]
#: A grasp closer to a better one than this many neighbourhoods is a duplicate.
APART = 2.0
#: A grasp at the same height with the same width and stiffness, to these fractions, is a rotated duplicate.
SAME_WIDTH, SAME_STIFFNESS = 0.05, 0.2
#: Maximum number of grasps rejected by the simulation before the search stops.
MAX_REFUSED = 6


@dataclass(frozen=True, slots=True, eq=False)
class GraspPlan:
    """Ranked grasps, best first, and the maps from which they were selected."""

    grasps: tuple[Grasp, ...]
    rejected: tuple[Grasp, ...]  #: selected on the map, rejected by the nonlinear simulation
    surface: StiffnessMap
    scores: GraspScores
    feasibility: FeasibilityMap
    task: GraspTask
    load: Load | None = None
    notes: tuple[str, ...] = field(default=())

    @property
    def reason(self) -> str:
        """Reason why there is no grasp; empty if there is one."""
        if self.grasps:
            return ""
        if self.notes and not self.rejected:
            return self.notes[0]
        if self.rejected and self.rejected[0].confirmation is not None:
            return (
                f"the best grasp on the map fails in the simulation: {self.rejected[0].confirmation.reason}"
            )
        used = np.unique(self.surface.faces)
        found = self.feasibility.verdict[used]
        if (found == Verdict.FEASIBLE).any():
            best = float(np.max(self.scores.pair[used]))
            return f"the best score is {best:.2f}, expected at least {self.task.min_score:.2f}"
        # Fractions of the vertices with a wall in front of the fingers.
        geometric = (Verdict.NOTHING_OPPOSITE, Verdict.PARTIAL_OVERLAP, Verdict.NEAR_FLOOR)
        rest = found[~np.isin(found, geometric)]
        common = int(np.bincount(rest if len(rest) else found).argmax())
        return (
            f"no place is feasible; the most common reason: {Verdict(common).name.lower().replace('_', ' ')}"
        )


def plan_grasps(
    container: ShellObject,
    task: GraspTask | None = None,
    *,
    count: int = 5,
    confirm: bool | None = None,
    arm_cost: ArmCost | None = None,
    surface: StiffnessMap | None = None,
    scene_m: Float[np.ndarray, "s 3"] | None = None,
) -> GraspPlan:
    """Ranked grasps of a container.

    Parameters
    ----------
    container
        Parametric or imported container.
    task
        Force, state, gripper.
    count
        Maximum number of grasps.
    confirm
        Run the nonlinear simulation for each grasp, and continue with the next if it fails; takes seconds
        for each, and is run once per height for a round object. By default where the wall deforms by more than
        its thickness: below, the linear map is accurate to first order. A pinch of the rim is not simulated.
    arm_cost
        Ranking of the goals; by score without it. An infinite cost removes the goal.
    surface
        Its map in the task's state, if already available; for pairs through the height axis.
    scene_m
        Points of its surroundings, in its frame [m], which are obstacles of the gripper.

    Examples
    --------
    >>> from visuohaptic.deformation import load_object
    >>> plan = plan_grasps(load_object("cup-rim", around=32), GraspTask(force_N=20.0), count=1)
    >>> bool(plan.grasps[0].first_m[2] > 0.08)  # at the rim
    True
    """
    task = task or GraspTask()
    contents = Contents(fill=task.fill) if task.closed else None
    tips = None
    if surface is None and task.pairs == "antipodal" and not is_round(container):
        tips = antipodal_points(container.mesh, max_slant_rad=float(np.arctan(task.gripper.friction)))
        values = object_stiffness(container, tips, contents)
        surface = StiffnessMap(container.mesh.vertices_m, container.surface_faces, *values)
    surface = surface or object_map(container, contents)
    load = task.load or object_load(container, task.fill, liquid_kg_per_m3=task.liquid_kg_per_m3)
    headspace = None if task.closed or not task.fill else (1 - task.fill) * container.volume_m3
    model = None if confirm is False and headspace is None else container.model()
    even, max_linear_m = is_round(container), _wall_m(container)
    known: dict[tuple[float, float], Confirmation] = {}

    def check(grasp: Grasp) -> Confirmation | None:
        soft = confirm or (confirm is None and grasp.deformation_m > max_linear_m[grasp.vertex])
        if grasp.rim or not soft:
            return None
        place = round(float(grasp.first_m[2]), 6), round(grasp.force_N, 3)
        if not (even and place in known):
            known[place] = confirm_grasp(
                container,
                grasp.vertex if tips is None else tips.take([grasp.vertex]),
                grasp.force_N,
                contents=contents,
                headspace_m3=headspace,
                max_deformation_m=task.parameters.max_deformation_m,
                friction=task.gripper.friction,
                model=model,
            )
        # From another vertex of the same ring: the same curve, with the shape rotated.
        return known[place]

    def rate(force: float | np.ndarray) -> _Rated:
        scores = grasp_scores(surface, force, task.parameters, axis_point_m=container.axis_point_m, tips=tips)
        rims = rim_grasps(container, surface, scores, task, load)
        if model is None or headspace is None:
            return scores, None, rims
        return scores, spill_of(container, model, scores, task.fill), rims

    return _plan(surface, task, load, rate, count, arm_cost, check, ApproachSpace.of(surface, scene_m))


def _wall_m(container: ShellObject) -> Float[np.ndarray, "v"]:
    """Smallest thickness of the wall at each vertex [m]."""
    mesh = container.mesh
    out = np.full(len(mesh.vertices_m), np.inf)
    np.minimum.at(out, mesh.faces, np.asarray(mesh.thickness_m)[:, None])
    return out


def plan_map(
    surface: StiffnessMap,
    task: GraspTask,
    *,
    count: int = 5,
    arm_cost: ArmCost | None = None,
    scene_m: Float[np.ndarray, "s 3"] | None = None,
) -> GraspPlan:
    """Ranked grasps from a stiffness map alone, e.g. from a file or a database.

    Without a wall the weight is unknown: the task gives the force, or the load.

    Parameters
    ----------
    surface
        Stiffness map, z up.
    task
        Task with a force, or a load.
    count
        Maximum number of grasps.
    arm_cost
        Ranking of the goals; by score without it. An infinite cost removes the goal.
    scene_m
        As of :func:`plan_grasps`.

    Raises
    ------
    InputError
        The task has neither force nor load, or is for an open container with liquid.
    """
    if task.force_N is None and task.load is None:
        raise InputError(
            "plan_map",
            "a map does not contain the mass",
            remedy="give the force or the mass (--force, --mass)",
        )
    if task.fill and not task.closed:
        raise InputError(
            "plan_map", "a map does not contain the spill limit", remedy="give the object instead"
        )
    return _plan(
        surface,
        task,
        task.load,
        lambda force: (grasp_scores(surface, force, task.parameters), None, []),
        count,
        arm_cost,
        lambda grasp: None,
        ApproachSpace.of(surface, scene_m),
    )


def _plan(
    surface: StiffnessMap,
    task: GraspTask,
    load: Load | None,
    rate: Callable[[float | np.ndarray], _Rated],
    count: int,
    arm_cost: ArmCost | None,
    check: Callable[[Grasp], Confirmation | None],
    space: ApproachSpace,
) -> GraspPlan:
    check_numbers("plan_grasps", at_least(1), count=count)
    force: float | np.ndarray = 1.0 if task.force_N is None else task.force_N
    scores, spill, rims = rate(force)
    found = feasibility_map(surface, scores, force, task, load=load, spill=spill)
    if task.force_N is None:
        # The minimum force that holds at each location; the scores depend on it.
        force = np.clip(found.window_force_N, 1e-3, 1e6)
        scores, spill, rims = rate(force)
        found = feasibility_map(surface, scores, force, task, load=load, spill=spill)
    goals = [
        replace(goal, arm_cost=cost)
        for goal in (*_goals(surface, scores, found, task, load), *rims)
        if np.isfinite(cost := 0.0 if arm_cost is None else float(arm_cost(goal)))
    ]
    # The load of a rim grasp is offset from the fingers: it is used for loads that side grasps do not hold.
    goals.sort(key=lambda goal: (goal.arm_cost, goal.rim, -goal.score))
    kept: list[Grasp] = []
    rejected: list[Grasp] = []
    blocked = 0
    for goal in goals:
        if len(kept) == count or len(rejected) > MAX_REFUSED:
            break
        if arm_cost is None and any(_turned(goal, other, task) for other in (*kept, *rejected)):
            continue
        approach = find_approach(space, goal.first_m, goal.second_m, task.gripper)
        if approach is None:
            blocked += 1
            continue
        said = check(goal)
        if said is not None and any(other.confirmation is said for other in rejected):
            continue
        goal = replace(goal, approach=approach, confirmation=said)
        (kept if said is None or said.holds else rejected).append(goal)
    notes: tuple[str, ...] = (
        (f"{blocked} places have no way free of object, scene and table",) if blocked else ()
    )
    if kept and np.isnan(surface.stiffness_sigma_N_per_m[np.isfinite(surface.stiffness_N_per_m)]).any():
        notes += ("the map states no standard deviation: it is taken to be as uncertain as that of a class",)
    return GraspPlan(tuple(kept), tuple(rejected), surface, scores, found, task, load, notes)


def _turned(one: Grasp, other: Grasp, task: GraspTask) -> bool:
    """Whether a grasp is another one rotated about the height axis: same height, width and stiffness."""
    near = abs(one.first_m[2] - other.first_m[2]) < APART * task.parameters.neighbourhood_m
    alike = abs(np.log(one.width_m / other.width_m)) < SAME_WIDTH
    bent = abs(one.deformation_m / one.force_N - other.deformation_m / other.force_N)
    soft = bent < SAME_STIFFNESS * max(one.deformation_m / one.force_N, 1e-12)
    return bool(near and alike and soft)


def _goals(
    surface: StiffnessMap, scores: GraspScores, found: FeasibilityMap, task: GraspTask, load: Load | None
) -> list[Grasp]:
    """Best vertices with a minimum distance from each other; both ends of a pinch are one grasp."""
    from scipy.spatial import cKDTree

    points, tips, score = surface.vertices_m, scores.tips, scores.pair
    spreads = relative_sigma(surface)
    used = np.zeros(len(points), dtype=bool)
    used[np.asarray(surface.faces)] = True
    open_: Int[np.ndarray, "g"] = np.flatnonzero(used & found.feasible & (score >= task.min_score))
    tree = cKDTree(points)
    reach = task.parameters.neighbourhood_m
    order = open_[np.lexsort((open_, -np.round(score[open_], 9)))]
    taken = np.zeros(len(points), dtype=bool)
    out = []
    for vertex in order:
        if taken[vertex]:
            continue
        other = tips.weights[vertex] @ points[tips.second[vertex]]
        for place in (points[vertex], other):
            taken[tree.query_ball_point(place, APART * reach)] = True
        near = [i for i in tree.query_ball_point(points[vertex], reach) if used[i]]
        k = float(surface.stiffness_N_per_m[vertex])
        deformation = float(scores.deformation_m[vertex])
        spread = float(spreads[vertex])
        success = (
            float("nan") if load is None else _success(vertex, scores, found, task, load, deformation, spread)
        )
        needed = float(found.needed_N[vertex])
        parts = {
            name: float(getattr(scores, name)[vertex])
            for name in ("contact", "curvature", "height", "deformation")
        }
        out.append(
            Grasp(
                int(vertex),
                points[vertex].copy(),
                other,
                tips.direction[vertex].copy(),
                float(score[vertex]),
                parts,
                float(found.force_N[vertex]),
                needed,
                float(found.deformation_limit_N[vertex]),
                float(found.spill_limit_N[vertex]),
                deformation,
                deformation * spread,
                float(found.width_m[vertex]),
                float(score[near].min()),
                success,
                needed**2 / k,  # for each of two sides: half the force times its displacement
            )
        )
    return out


def _success(
    vertex: int,
    scores: GraspScores,
    found: FeasibilityMap,
    task: GraspTask,
    load: Load,
    deformation_m: float,
    spread: float,
) -> float:
    """Probability that a grasp holds its load, times that of staying below the bound of the deformation."""
    from scipy.special import ndtr

    holds = success_probability(
        found.force_N[[vertex]], found.needed_N[[vertex]], scores.slant_rad[[vertex]], load, task.gripper, task.handling,
        unloaded_sigma_N=found.unloaded_sigma_N[[vertex]],
    )  # fmt: skip
    margin = np.log(task.parameters.max_deformation_m / max(deformation_m, 1e-12))
    return float(holds[0] * (margin > 0 if spread == 0 else ndtr(margin / spread)))


def multi_contact(
    container: ShellObject, vertices: Sequence[int], *, closed: bool = False, fill: float = 0.0
) -> GraspCoupling:
    """Coupling of several pinches: the coupling matrix of Sec. 7.2.

    The pinches are simultaneous and superposed linearly: ``deformation_m(forces)`` of the result is
    the mean deformation of both sides of each pinch, ``force_N`` its inverse. The deformations of adjacent pinches
    add up; distant pinches may even displace each other's walls outwards.

    Parameters
    ----------
    container
        Parametric or imported container.
    vertices
        First vertex of each pinch.
    closed
        The contents cannot escape.
    fill
        Fraction of the volume that is liquid, 0 to 1; of a closed container.
    """
    if len(set(vertices)) < len(vertices) or not vertices:
        raise InputError("multi_contact", f"found {list(vertices)}, expected vertices that differ")
    model = container.model()
    tips = opposing_points(container.mesh, np.array(vertices), axis_point_m=container.axis_point_m)
    coupling = couple(model, tips).compliance
    if closed:
        coupling = coupling - _gas(container, model, tips, fill)
    # Converts the approach of the two tips of a pinch to the deformation of one side, as in a stiffness map.
    return GraspCoupling(0.5 * coupling)


def _gas(container: ShellObject, model: ShellModel, tips: DualTips, fill: float) -> Float[np.ndarray, "m m"]:
    """Reduction of each entry by enclosed gas: Sherman-Morrison formula, as in :func:`.closed_compliance`."""
    a = enclosed_gradient(container, model)
    w = model.solve(a)
    along = tip_approach(tips, w, model.mesh.vertices_m)
    kappa = Contents(fill=fill).bulk_stiffness(container.volume_m3)
    out: np.ndarray = np.outer(along, along) / (1 / kappa + float(np.sum(a * w)))
    return out
