"""The gripper squeezes the completed bottle: class, state, and grasp."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core import Frame
from ..core.objects import HEIGHTS
from ..recognition.touch import map_of_outline, map_of_oval, smooth_errors, stiffness_samples
from ..recognition.touch.belief import with_outline
from ..recognition.touch.contents import FILLINGS, ContentsModel, wall_from_stiffness
from ..recognition.touch.haptic_model import UNKNOWN
from ..sensing.beam.tracked import TrackedBeam
from ..sensing.foam.sensor import FoamSensor
from ..tasks import Hand, LiftPlan, Place, RememberedContainer, SqueezeSettings, grasp_and_lift
from ..tasks.framework import SafetyLimits, Supervisor
from ..tasks.manipulation.bayes_squeeze import BayesSqueezer, correct_by_squeezes
from ..tasks.manipulation.classify import (
    Classification,
    ClassifyOutcome,
    ClassifySettings,
    classify_by_squeezing,
)
from ..tasks.manipulation.contents_task import LIFT_M_S, ContentsFinding, identify_contents, weigh
from ..tasks.manipulation.foam_finger import FoamFingerOnDrive
from ..tasks.memory import HEIGHT_SIGMA_M
from .bottle import CUPS, PLACE, ROUND, TableBottle, container_of_class, mission_classes
from .judge import Claim
from .probe_chapters import complete_the_bottle, identify
from .report import belief_figure, grasp_figure
from .results import ChapterResult, Illustration, Measure, counted, done, failed
from .served import REST, WEIGHTS, hand_truth, place_bottle, robot_at_table
from .story import Known, Mission

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..grasping import Grasp, GraspPlan

#: At a single location an unusual bottle can be as stiff and as wide as another class. Of objects of no class two in a hundred may
#: be misclassified; the posterior, which knows no object between the classes, is too certain of them: of 150 on open tables
#: (``benchmarks.table_bottles``) four were misclassified with 0.995, three with 0.998. Known objects need two
#: squeezes, unknown ones up to a dozen.
CONFIDENCE, MIN_SQUEEZES, MAX_SQUEEZES = 0.998, 2, 12
#: The gripper's limit, above the strongest squeeze [N], and repeatability of the arm, of its data sheet [m].
MAX_GRIP_N, REPEAT_M = 60.0, 2e-4
#: Margin around an outline for its axis, and maximum opening of the hand [m].
CLEAR_M, MAX_OPEN_M = 0.003, 0.11
#: Classes of the classifier, including the unknown class.
CLASSES = 6
#: Odds of the classes of an object that is seen not to be round, and how many of those recognised with CONFIDENCE are right, by the
#: rule of succession: 71 of 75 on open tables (``benchmarks.table_bottles --oval``), where another brand can be like the class.
NO_ROUND, OVAL_RIGHT = dict.fromkeys((*ROUND, *CUPS), 0.0), (71 + 1) / (75 + 2)
#: Above this fraction of the height the fingers may miss the rim: the height has an error of millimetres.
TOP = 0.85


def hand_of_mission(mission: Mission) -> tuple[Any, Hand]:
    """The parts of the robot at the bottle, and its hand under the supervisor, zeroed at its first use.

    Parameters
    ----------
    mission
        Keeps the robot and its zeroed sensors.
    """
    if mission.hand is None:
        mission.hand = mission.opened.enter_context(robot_at_table(mission, "hand"))
    robot, known = mission.hand, mission.known
    weights = iter(robot.load_camera)
    if known.finger is None:
        known.finger = FoamSensor.load(mission.folder / "finger" / "sensor.yaml")
    if known.wrist is None:
        known.wrist = TrackedBeam.load(mission.folder / "wrist" / "sensor.yaml")
        known.wrist.zero(itertools.islice(weights, len(REST)))
        known.wrist.calibrate(itertools.islice(weights, len(WEIGHTS)), WEIGHTS)
        known.wrist_sigma_N = math.sqrt(float(known.wrist.read(next(weights)).reading.zero[0, 0]))
    wrist = known.wrist
    guard = Supervisor(SafetyLimits(max_force_N=MAX_GRIP_N), clock=lambda: robot.arm.pose()[0])
    feel = guard.force(FoamFingerOnDrive(known.finger, robot.gripper))

    def weigh(_: Frame) -> float:
        """Downward pull on the beam at the wrist."""
        pull = wrist.read(next(weights)).reading.wrench
        return float(pull.force_N[0]) if pull.valid else math.nan

    scale = math.sqrt(float(wrist.sensor.correction.row_covariance[0, 0, 0]))
    arm, gripper, frames = guard.arm(robot.arm), guard.gripper(robot.gripper), guard.frames(robot.camera)
    return robot, Hand(arm, gripper, frames, feel, weigh, scale, known.wrist_sigma_N)


def recognise_the_bottle(mission: Mission) -> ChapterResult:
    """Squeeze where it is most informative until the class is certain, then firmly for the contents; a known container firmly first.

    Parameters
    ----------
    mission
        Mission with the completed outline; receives class, squeezes, wall, lid, fill and mass.
    """
    known, bottle = mission.known, place_bottle(mission)
    _, hand = hand_of_mission(mission)
    contents: ContentsFinding | None = None
    more: tuple[Claim, ...] = ()
    if (remembered := mission.known_bottle) is not None:
        contents = _contents(mission, hand, remembered.wall_m)
        if not identify(mission, known.touched_m):
            contents, completed = None, complete_the_bottle(mission)
            if not completed.done:
                return completed
            more = completed.claims
    found, history = _classified(mission, hand)
    ranked = _report_classes(mission, found)
    if not found.ending.success and not (
        mission.attempt and found.ending.outcome == ClassifyOutcome.UNDECIDED
    ):
        return failed(f"{found.ending.outcome}: {found.ending.why} ({ranked})")
    article = "an" if found.best[:1] in "aeiou" else "a"
    seems = "it is" if found.ending.success else "undecided, most probably it is"
    called = f"{seems} {'like none of the classes that are known' if found.best == UNKNOWN else f'{article} {found.best}'}"
    # After another squeeze it continues with the most probable class, without claiming it: the measurements correct the map.
    known.class_name = found.best
    known.class_model = container_of_class(found.best, known.outline_m, known.squash)
    if known.squash < 1.0:
        return _weigh_the_oval(mission, found, called, belief_figure(history, found.curves[-1]))
    if known.class_model.base.shape != "circle":
        return failed(f"it is taken for {found.best}, whose contents cannot be identified in this way")
    if contents is None:
        stiffness = [(curve.place.height_m, curve.stiffness_N_per_m) for curve in known.curves]
        contents = _contents(
            mission, hand, wall_from_stiffness(known.outline_m, stiffness, float(known.class_model.wall[0]))
        )
    parts = [
        Measure("squeezes for the class", len(known.curves)),
        Measure("wall [mm]", 1e3 * known.wall_m, 1e3 * bottle.wall_m),
        Illustration(
            belief_figure(history, contents.curves[-1]),
            "Probability of the classes, and the last squeeze, which determines the lid",
        ),
    ]
    if contents.lid == UNKNOWN or contents.mass_kg is None:
        return failed(f"{called}, but its contents are not identified: {contents.why}", *parts)
    known.belief = replace(known.belief, closed=contents.belief["closed"], filled=contents.posterior.filled)
    # An uncertain lid is not claimed: the grasp is planned for an open wall, which is softer.
    known.closed = contents.confident and contents.lid == "closed"
    known.fill, (known.mass_kg, known.mass_sigma_kg) = contents.fill[0], contents.mass_kg
    if mission.memory is not None:
        _keep_the_bottle(mission, found.belief[found.best], contents)
    gentle = f", {counted(len(known.curves), 'gentle squeeze')}" if known.curves else ""
    lid = "" if contents.confident else "whether it is closed stays undecided: "
    why = f"{called} (probability {found.belief[found.best]:.2f}{gentle}), {lid}{contents.why}"
    return done(why, *_contents_claims(found, contents, bottle), *more, *parts)


def _contents(mission: Mission, hand: Hand, wall_m: float) -> ContentsFinding:
    """Squeeze firmly and weigh, until lid and filling are known."""
    known, begin_s = mission.known, hand.arm.pose()[0]
    known.wall_m = wall_m
    model = ContentsModel(known.outline_m, wall_m, outline_sigma_m=known.outline_sigma_m)
    found = identify_contents(hand, model, _foot_m(known), _open_m(known))
    known.firm_curves += tuple(found.curves)
    mission.record_cost(hand.arm.pose()[0] - begin_s, len(found.curves))
    return found


def _classified(mission: Mission, hand: Hand) -> tuple[Classification, list[Mapping[str, float]]]:
    """Squeeze until the class is certain; also the probabilities after each squeeze."""
    known, begin_s = mission.known, hand.arm.pose()[0]
    classes = mission_classes()
    if known.outline_errors is not None:
        classes = with_outline(classes, known.outline_m, known.outline_errors)
    squeezer = BayesSqueezer(
        classes, float(known.outline_m[-1, 1]), HEIGHTS, mission.rng(32), odds=_odds(mission),
        readings=known.readings, yaw_rad=known.wide_rad,
    )  # fmt: skip
    settings = ClassifySettings(
        confidence=CONFIDENCE,
        min_squeezes=1 if mission.known_bottle is not None else MIN_SQUEEZES,
        squeezes=MAX_SQUEEZES,
        squeeze=SqueezeSettings(object_m=_foot_m(known), open_m=_open_m(known)),
    )
    felt = () if known.readings else known.firm_curves
    found = classify_by_squeezing(hand, squeezer, settings, felt)
    if known.squash < 1.0:
        likely = {name: p for name, p in found.belief.items() if name not in NO_ROUND}
        found = replace(
            found, belief={n: OVAL_RIGHT * p + (1.0 - OVAL_RIGHT) * (1.0 - p) for n, p in likely.items()}
        )
    known.curves += found.curves[len(felt) :]
    known.belief = replace(known.belief, classes=found.belief)
    mission.record_cost(hand.arm.pose()[0] - begin_s, len(found.curves) - len(felt))
    return found, squeezer.history()


def _odds(mission: Mission) -> dict[str, float]:
    """Probability of the recognised class against all other known ones."""
    one = mission.known_bottle
    if mission.known.squash < 1.0:  # seen
        return NO_ROUND
    if one is None:
        return {}
    probability = min(one.probability * mission.known_bottle_probability, CONFIDENCE)
    return {one.class_name: (CLASSES - 1) * probability / (1.0 - probability)}


def _keep_the_bottle(mission: Mission, probability: float, contents: ContentsFinding) -> None:
    known, before = mission.known, mission.known_bottle
    assert mission.memory is not None
    if before is not None and before.alike:
        return  # which of them it is, is not known
    sigma_m: Any = known.outline_sigma_m if before is None else before.sigma_m
    if known.outline_errors is not None:
        sigma_m = known.outline_m[:, 0] * np.sqrt(np.diag(known.outline_errors))
    one = RememberedContainer(
        before.id if before is not None else "", known.class_name, probability, known.outline_m,
        sigma_m, contents.lid if contents.confident else UNKNOWN, known.fill, known.wall_m,
    )  # fmt: skip
    mission.memory.store_bottle(one)


def _contents_claims(found: Classification, contents: ContentsFinding, bottle: TableBottle) -> list[Claim]:
    assert contents.mass_kg is not None
    lid = "closed" if bottle.closed else "open"
    lid_claim = Claim("lid", "bottle", contents.lid, lid, probability=contents.belief[contents.lid])
    return [
        *[lid_claim] * contents.confident,
        *_squeeze_claims(found, contents.mass_kg, bottle),
        Claim("fill", "bottle", contents.fill[0], bottle.fill, sigma=contents.fill[1]),
    ]


def _squeeze_claims(found: Classification, mass_kg: tuple[float, float], bottle: TableBottle) -> list[Claim]:
    named = Claim("class", "bottle", found.best, bottle.name, probability=found.belief[found.best])
    mass = Claim("mass", "bottle", mass_kg[0], bottle.container.mass_kg, sigma=mass_kg[1])
    return [*[named] * found.ending.success, mass]


def _weigh_the_oval(mission: Mission, found: Classification, called: str, figure: Figure) -> ChapterResult:
    """Lift an oval container a little where it was squeezed; lid and filling are identified of round ones alone."""
    known, bottle, hand = mission.known, place_bottle(mission), hand_of_mission(mission)[1]
    radius_m, height_m = known.outline_m.T
    full_kg = (
        FILLINGS["liquid"].kg_per_m3 * known.squash * math.pi * float(np.trapezoid(radius_m**2, height_m))
    )
    begin_s, firmest = hand.arm.pose()[0], max(found.curves, key=lambda curve: float(curve.force_N[-1]))
    picture = Illustration(figure, "Probability of the classes, and the last squeeze")
    heaviest_kg = (1.0 + 3.0 * FILLINGS["liquid"].sigma) * full_kg
    mass = weigh(hand, heaviest_kg, firmest, _foot_m(known), _open_m(known))
    mission.record_cost(hand.arm.pose()[0] - begin_s)
    if mass is None:
        return failed(f"{called}, but it could not be weighed", picture)
    (known.mass_kg, known.mass_sigma_kg), known.fill = mass, min(mass[0] / full_kg, 1.0)
    why = f"{called} (probability {found.belief[found.best]:.2f}), weighs {1e3 * mass[0]:.0f} g; its lid and filling stay unknown"
    return done(why, *_squeeze_claims(found, mass, bottle), picture)


def _foot_m(known: Known) -> tuple[float, float, float]:
    """Centre of the bottle's bottom in the base of the arm."""
    x, y, _ = PLACE.apply(np.array([*known.bottle_at_m, 0.0]))
    return float(x), float(y), 0.0


def _open_m(known: Known) -> float:
    """Opening for the widest part of the outline, including the errors of outline and position."""
    reach_m = float(known.outline_m[:, 0].max()) + 3.0 * known.outline_sigma_m + CLEAR_M
    return min(2.0 * reach_m, MAX_OPEN_M)


def _report_classes(mission: Mission, found: Classification) -> str:
    """Log lines of the squeezes; returns the three most probable classes."""
    for curve in found.curves:
        mission.log(
            f"  squeezed at {1e3 * curve.place.height_m:.0f} mm: {curve.stiffness_N_per_m / 1e3:.2f} N/mm, "
            f"{2e3 * curve.surface_m:.1f} mm wide"
        )
    ranked = sorted(found.belief.items(), key=lambda item: -item[1])
    classes = ", ".join(f"{name} {probability:.2f}" for name, probability in ranked[:3])
    mission.log(f"  classes: {classes}")
    return classes


def grasp_the_bottle(mission: Mission) -> ChapterResult:
    """Plan on the stiffness of the measured outline, corrected by all squeezes; grasp and lift.

    Parameters
    ----------
    mission
        Mission with outline, class, squeezes and contents.
    """
    robot, hand = hand_of_mission(mission)
    plan, scale = _planned(mission.known)
    if not plan.grasps:
        return failed(f"no grasp: {plan.reason} ({1e3 * mission.known.mass_kg:.0f} g)")
    best = plan.grasps[0]
    lift = _lift_plan(best, float(best.first_m[2]) / scale, mission.known)
    mission.log(
        f"  {1e3 * mission.known.mass_kg:.0f} g need {best.needed_N:.1f} N at {1e3 * lift.place.height_m:.0f} mm; {best.force_N:.1f} N "
        f"are expected to deform the wall by {1e3 * best.deformation_m:.2f} ± {1e3 * best.deformation_sigma_m:.2f} mm there, and to hold with a probability of {best.success:.3f}"
    )
    begin_s = hand.arm.pose()[0]
    held = grasp_and_lift(hand, lift)
    mission.record_cost(hand.arm.pose()[0] - begin_s)
    finger, wrist, truth = next(iter(robot.camera)), next(iter(robot.load_camera)), hand_truth(mission)
    deformed_mm, truly_mm = 1e3 * held.deformation_m, 1e3 * truth["deformation_m"]
    # The gripper may end with another force than the planned one: expected is what this force does.
    scale_mm, angle = 1e3 * held.force_N / best.force_N, lift.place.angle_rad - mission.known.wide_rad
    # The outline is drawn in the plane of the fingers.
    squashed = math.hypot(math.cos(angle), mission.known.squash * math.sin(angle))
    parts = (
        Measure("mass [kg]", mission.known.mass_kg, place_bottle(mission).container.mass_kg),
        Measure("force of each finger, needed at least [N]", best.needed_N),
        Measure("probability that it holds", best.success, held.ending.success),
        Measure("force of each finger, measured [N]", held.force_N, truth["force_N"]),
        Measure(
            "deformation of one side, expected at this force [mm]", scale_mm * best.deformation_m, truly_mm
        ),
        Measure("its standard deviation [mm]", scale_mm * best.deformation_sigma_m),
        Measure("deformation of one side, measured [mm]", deformed_mm, truly_mm),
        Measure("lifted [m]", lift.lift_m if held.ending.success else 0.0, truth["lifted_m"]),
        Illustration(
            grasp_figure(plan, lift, mission.known.outline_m * (squashed, 1.0), held.ending.success),
            "Grasp score and stiffness of the container with the grasp (circles), and the lifted bottle",
        ),
        Illustration(finger.image, "The camera on the finger sees its foam, in the end"),
        Illustration(wrist.image, "The beam from which the hand hangs: it weighs what is lifted"),
    )
    if not held.ending.success:
        return failed(f"{held.ending.outcome}: {held.ending.why}", *parts)
    lifted = truth["lifted_m"] > 0.8 * lift.lift_m and not truth["fallen"]
    return done(f"lifted: {held.ending.why}", Claim("grip", "bottle", True, lifted), *parts)


def _planned(known: Known) -> tuple[GraspPlan, float]:
    """Grasps on the class's model, with heights scaled to the bottle's and the stiffness of its outline."""
    from ..deformation import mesh_container
    from ..grasping import GraspTask, GripperModel, Load, object_load
    from ..grasping.planner import plan_grasps

    model = mesh_container(known.class_model, around=32)
    # Heights are relative: the class's variant has not exactly the height of the bottle.
    scale = model.height_m / float(known.outline_m[-1, 1])
    squeezed = (*known.curves, *known.firm_curves)
    if known.squash < 1.0:
        surface, deviations = map_of_oval(model, known.belief.closed, known.fill)
    else:
        errors = known.outline_errors
        if errors is None or known.belief.transparent < 0.5:  # where it was seen or known
            errors = smooth_errors(known.outline_m, known.outline_sigma_m)
        heights_m, logs = stiffness_samples(
            known.outline_m, errors, known.wall_m, known.belief.closed,
            height_sigma_m=HEIGHT_SIGMA_M, widths_m=[(one.place.height_m, one.surface_m) for one in squeezed],
        )  # fmt: skip
        surface, deviations = map_of_outline(
            model.mesh.vertices_m, model.surface_faces, scale * heights_m, logs
        )
    surface = correct_by_squeezes(
        surface, squeezed, scale=scale, yaw_rad=known.wide_rad, deviations=deviations
    )
    centre_m = object_load(model, known.fill).centre_m
    load = Load(known.mass_kg, centre_m, mass_spread=known.mass_sigma_kg / known.mass_kg)
    plan = plan_grasps(
        model,
        GraspTask(
            closed=known.closed, fill=known.fill, load=load, gripper=GripperModel(position_sigma_m=REPEAT_M)
        ),
        count=3,
        # The map is corrected by the measurements, the class's model in a simulation is not; the fingers monitor the
        # deformation of the wall.
        confirm=False,
        surface=surface,
        # This gripper approaches from the side.
        arm_cost=lambda grasp: math.inf if grasp.rim or grasp.first_m[2] >= TOP * model.height_m else 0.0,
    )
    return plan, scale


def _lift_plan(best: Grasp, height_m: float, known: Known) -> LiftPlan:
    """The planned grasp as executed by the gripper."""
    # The two fingers are interchangeable: the smaller rotation is used.
    angle = math.remainder(known.wide_rad + math.atan2(best.direction[1], best.direction[0]), math.pi)
    # Log-normal, as the stiffness.
    spread = best.deformation_sigma_m / best.deformation_m
    give = min(2.0 * best.deformation_m * math.exp(3.0 * spread) + 0.001, 0.01)
    assert known.finger is not None
    setup = known.finger.setup
    foam, length_m = setup.material, np.ptp(setup.geometry.s_m)
    stiffness = foam.slope(np.zeros(1))[0] * foam.height_m * length_m / foam.width_m
    return LiftPlan(
        Place(height_m, angle), best.force_N, give, _foot_m(known), open_m=_open_m(known),
        finger_N_per_m=float(stiffness), arm_m_s=LIFT_M_S,
    )  # fmt: skip
