"""The gripper squeezes the completed bottle: what it is, in which state, and how to grasp it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..recognition.touch.contents import ContentsModel, ContentsState, wall_from_stiffness
from ..recognition.touch.haptic_model import UNKNOWN, ModelSettings, fit_model
from ..recognition.touch.outline_match import nearest_variant
from ..simulation.faults import FaultKind
from ..simulation.tabletop.kitchen import KitchenTable
from ..tasks.manipulation.bayes_squeeze import BayesSqueezer, correct_by_squeezes
from ..tasks.manipulation.classify import Classification, ClassifySettings, classify_by_squeezing
from ..tasks.manipulation.contents_task import LIFT_M_S, ContentsFinding, identify_contents
from ..tasks.manipulation.grasp import LiftPlan, grasp_and_lift
from ..tasks.manipulation.hand import Hand, Place
from ..tasks.manipulation.squeeze_task import SqueezeCurve, SqueezeSettings
from .bottle import GROUPS, HEIGHTS, PLACE, STATES, training_objects
from .probe_chapters import set_the_table
from .story import ChapterResult, Illustration, Known, Measure, Mission, done, failed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..grasping.planner import Grasp, GraspPlan

__all__ = ["grasp_the_bottle", "recognise_the_bottle"]

#: At a single place an unusual bottle can be as stiff and as wide as another class.
CONFIDENCE, MIN_SQUEEZES, MAX_SQUEEZES = 0.98, 2, 8
#: Heights are parts of the completed outline, whose top is known to a few millimetres [m].
HEIGHT_SIGMA_M = 0.003
#: An empty bottle needs tenths of a newton, which a finger that ends two tenths of a millimetre off the
#: planned height has lost: it is held by this at least, where the wall bears it [N].
MIN_GRIP_N = 2.5
#: Above this fraction of the height the fingers may miss the rim: the height is known to millimetres only.
TOP = 0.85


def the_hand(mission: Mission) -> tuple[KitchenTable, Hand]:
    """Arm and gripper at the table, with the bottle where it truly stands.

    Parameters
    ----------
    mission
        Its fault may let the bottle slip or fall.
    """
    if mission.kitchen is None:
        bottle = set_the_table(mission)
        x, y, _ = bottle.T_base_bottle.translation_m
        never = math.inf
        # Squeezes and grasp take 35 s and more: it falls in the midst of them.
        late = float(mission.rng(30).uniform(2.0, 34.0))
        mission.kitchen = KitchenTable(
            bottle.container,
            mission.rng(31),
            place_m=(float(x), float(y)),
            slip_at_s=0.0 if mission.fault is FaultKind.SLIP else never,
            fall_at_s=late if mission.fault is FaultKind.OBJECT_FALLS else never,
        )
    kitchen = mission.kitchen
    return kitchen, Hand(kitchen.arm, kitchen, kitchen, kitchen.feel, kitchen.weigh)


def recognise_the_bottle(mission: Mission) -> ChapterResult:
    """Squeeze where it tells most until the class is sure, then once more, firmly, for the state.

    Parameters
    ----------
    mission
        With the completed outline; receives class, squeezes, wall and state.
    """
    known, bottle = mission.known, set_the_table(mission)
    assert known.outline_m is not None
    _, hand = the_hand(mission)
    object_m = _foot_m(known)
    model = fit_model(training_objects(), GROUPS, settings=ModelSettings(pose_m=HEIGHT_SIGMA_M))
    squeezer = BayesSqueezer(model, float(known.outline_m[-1, 1]), HEIGHTS, mission.rng(32))
    settings = ClassifySettings(
        confidence=CONFIDENCE,
        min_squeezes=MIN_SQUEEZES,
        squeezes=MAX_SQUEEZES,
        squeeze=SqueezeSettings(object_m=object_m),
    )
    found = classify_by_squeezing(hand, squeezer, settings)
    ranked = _report_classes(mission, found)
    if not found.ending.success:
        return failed(f"{found.ending.outcome}: {found.ending.why}")
    if found.best == UNKNOWN:
        return failed(f"it is like none of the classes that are known ({ranked})")
    model_wall_m = _take_class(known, found)
    assert known.class_model is not None
    if known.class_model.base.shape != "circle":
        return failed(f"it is taken for {found.best}, whose contents cannot be identified in this way")
    gentle = [(curve.place.height_m, curve.stiffness_N_per_m) for curve in found.curves]
    wall = wall_from_stiffness(known.outline_m, gentle, model_wall_m)
    states = {name: ContentsState(*one) for name, one in STATES.items()}
    contents = identify_contents(hand, ContentsModel(known.outline_m, wall, states), object_m)
    known.wall_factor = wall / model_wall_m
    parts = [
        Measure("class", found.best, bottle.description.name),
        Measure("squeezes for the class", len(found.curves), None),
        Measure("wall [mm]", 1e3 * wall, 1e3 * bottle.wall_m),
        *_contents_measures(contents, bottle.state, bottle.container.mass_kg),
        Illustration(
            _belief_figure(squeezer.history(), contents.curves[-1]),
            "How sure it is of the class, and the last squeeze that tells the state",
        ),
    ]
    if not contents.sure:
        return failed(f"it is a {found.best}, but its state is not identified: {contents.why}", *parts)
    known.state = contents.best
    right = found.best == bottle.description.name and contents.best == bottle.state
    gentle_text = f"{len(found.curves)} gentle ones before"
    return done(
        f"a {found.best} ({found.belief[found.best]:.2f}), {contents.why}, {gentle_text}", right, *parts
    )


def _foot_m(known: Known) -> tuple[float, float, float]:
    """Middle of the bottle's bottom in the base of the arm."""
    assert known.bottle_at_m is not None
    x, y, _ = PLACE.apply(np.array([*known.bottle_at_m, 0.0]))
    return float(x), float(y), 0.0


def _report_classes(mission: Mission, found: Classification) -> str:
    """Lines of the squeezes; returns the three most probable classes."""
    for curve in found.curves:
        mission.log(
            f"  squeezed at {1e3 * curve.place.height_m:.0f} mm: {curve.stiffness_N_per_m / 1e3:.2f} N/mm, "
            f"{2e3 * curve.surface_m:.1f} mm wide"
        )
    ranked = sorted(found.belief.items(), key=lambda item: -item[1])
    classes = ", ".join(f"{name} {probability:.2f}" for name, probability in ranked[:3])
    mission.log(f"  classes: {classes}")
    return classes


def _take_class(known: Known, found: Classification) -> float:
    """Keep the class with its nearest variant; returns the wall of the variant [m]."""
    from ..deformation.shapes.container import load_container

    assert known.outline_m is not None
    known.curves, known.class_name = found.curves, found.best
    known.class_model = nearest_variant(
        load_container(GROUPS.get(found.best, (found.best,))[0]), known.outline_m
    )
    return float(known.class_model.wall[0])


def _contents_measures(contents: ContentsFinding, state: str, mass_kg: float) -> list[Measure]:
    """State and mass beside the truth."""
    felt = None if contents.mass_kg is None else contents.mass_kg[0]
    return [
        Measure("state", contents.best, state),
        Measure("its probability", contents.belief[contents.best], None),
        Measure("mass felt [kg]", felt, mass_kg),
    ]


def grasp_the_bottle(mission: Mission) -> ChapterResult:
    """Plan on the recognised class's stiffness map, corrected by what was felt; grasp and lift.

    Parameters
    ----------
    mission
        With outline, class, squeezes and state.
    """
    kitchen, hand = the_hand(mission)
    plan, scale = _planned(mission.known)
    mass = plan.load.mass_kg if plan.load is not None else math.nan
    if not plan.grasps:
        return failed(f"no grasp: {plan.reason} ({1e3 * mass:.0f} g)")
    best = plan.grasps[0]
    lift = _lift_plan(best, float(best.first_m[2]) / scale, _foot_m(mission.known))
    mission.log(
        f"  {1e3 * mass:.0f} g need {best.needed_N:.1f} N at {1e3 * lift.place.height_m:.0f} mm; the wall deforms "
        f"by {1e3 * best.deformation_m:.1f} mm there"
    )
    held = grasp_and_lift(hand, lift)
    parts = (
        Measure("mass [kg]", mass, kitchen.container.mass_kg),
        Measure("force of each finger, needed at least [N]", best.needed_N, None),
        Measure("force of each finger, felt [N]", held.force_N, kitchen.force_N),
        Measure(
            "deformation of one side at the grasp [mm]", 1e3 * held.deformation_m, 1e3 * kitchen.deformation_m
        ),
        Measure("lifted [m]", lift.lift_m if held.ending.success else 0.0, kitchen.lifted_m),
        Illustration(
            _score_figure(plan),
            "Grasp score on the stiffness map of the recognised class, and the grasp (circles)",
        ),
    )
    if not held.ending.success:
        return failed(f"{held.ending.outcome}: {held.ending.why}", *parts)
    right = kitchen.lifted_m > 0.8 * lift.lift_m and not kitchen.fallen
    return done(f"lifted: {held.ending.why}", right, *parts)


def _planned(known: Known) -> tuple[GraspPlan, float]:
    """Grasps on the class's model, and its height by that of the bottle."""
    from ..deformation.maps.confidence_band import object_map
    from ..deformation.nonlinear.contents import Contents
    from ..deformation.shapes.mesher import mesh_container
    from ..grasping.grasp_task import GraspTask
    from ..grasping.planner import plan_grasps

    assert known.class_model is not None
    assert known.outline_m is not None
    closed, fill = STATES[known.state]
    model = mesh_container(known.class_model, around=32)
    # Heights are taken in parts: the class's variant is not exactly as high as the bottle.
    scale = model.height_m / float(known.outline_m[-1, 1])
    surface = object_map(model, Contents(fill=fill) if closed else None, band=False)
    surface = correct_by_squeezes(surface, known.curves, known.outline_m, scale=scale)
    plan = plan_grasps(
        model,
        GraspTask(closed=closed, fill=fill),
        count=3,
        surface=surface,
        arm_cost=lambda grasp: 0.0 if grasp.first_m[2] < TOP * model.height_m else math.inf,
    )
    return plan, scale


def _lift_plan(best: Grasp, height_m: float, object_m: tuple[float, float, float]) -> LiftPlan:
    """The planned grasp as the hand carries it out."""
    # Two fingers are as good either way round: the smaller turn is taken.
    angle = math.remainder(math.atan2(best.direction[1], best.direction[0]), math.pi)
    force = max(best.force_N, min(MIN_GRIP_N, best.deformation_limit_N))
    bound = 2.0 * force / best.force_N * (best.deformation_m + 3.0 * best.deformation_sigma_m) + 0.001
    return LiftPlan(
        Place(height_m, angle),
        force,
        deformation_m=min(bound, 0.01),
        object_m=object_m,
        arm_m_s=LIFT_M_S,
    )


def _belief_figure(history: Sequence[Mapping[str, float]], curve: SqueezeCurve) -> Figure:
    """Posterior of the classes after each squeeze, and one squeeze."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.6, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    names = list(history[-1])
    for count, belief in enumerate(history, 1):
        label = f"after {count} squeeze{'s' * (count > 1)}"
        left.plot([belief[name] for name in names], "o-", label=label, lw=1)
    left.set_xticks(range(len(names)), names, rotation=30, ha="right", fontsize=8)
    left.set(ylabel="probability", ylim=(-0.03, 1.03))
    left.legend(fontsize=8)
    right.plot(1e3 * curve.deformation_m, curve.force_N, "o-", color="C1")
    right.set(xlabel="deformation of one side [mm]", ylabel="force of one finger [N]")
    for axes in (left, right):
        axes.grid(alpha=0.3)
    return figure


def _score_figure(plan: GraspPlan) -> Figure:
    """Score and stiffness, unrolled, with the best grasp."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.6, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    points = plan.surface.vertices_m
    used = np.unique(plan.surface.faces)
    # Unrolled: angle about the axis against height.
    around = np.degrees(np.arctan2(points[used, 1], points[used, 0]))
    for axes, values, title in (
        (left, plan.scores.pair[used], "score of both fingers"),
        (right, 1e-3 * np.asarray(plan.surface.stiffness_N_per_m)[used], "stiffness [N/mm]"),
    ):
        order = np.argsort(values)
        shown = axes.scatter(
            around[order], 1e3 * points[used][order, 2], c=np.asarray(values)[order], s=9, cmap="viridis"
        )
        figure.colorbar(shown, ax=axes)
        axes.set(title=title, xlabel="angle about the axis [deg]", ylabel="height [mm]")
        best = plan.grasps[0]
        for place in (best.first_m, best.second_m):
            axes.plot(
                math.degrees(math.atan2(place[1], place[0])),
                1e3 * place[2],
                "o",
                ms=11,
                mfc="none",
                color="C3",
            )
    return figure
