"""The gripper squeezes the completed bottle: what it is, in which state, and how to grasp it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..recognition.data.readings import CurveCoefficients, TouchNoise, TouchReading, fit_curve
from ..recognition.touch.bayes import touch_gains
from ..recognition.touch.belief import update_belief
from ..recognition.touch.contents import (
    DEEPEST_M,
    FORCES_N,
    ContentsModel,
    ContentsState,
    SqueezeSamples,
    wall_from_stiffness,
)
from ..recognition.touch.haptic_model import UNKNOWN, HapticModel, ModelSettings, fit_model
from ..simulation.faults import FaultKind
from ..simulation.tabletop.kitchen import KitchenTable
from ..tasks.manipulation.classify import ClassifySettings, classify_by_squeezing
from ..tasks.manipulation.grasp import GRAVITY_M_S2, GraspPlan, grasp_and_lift
from ..tasks.manipulation.hand import Hand, Place
from ..tasks.manipulation.squeeze_task import SqueezeCurve, SqueezeOutcome, SqueezeSettings, squeeze
from .bottle import GROUPS, HEIGHTS, PLACE, STATES, profile_of, training_objects
from .probe_chapters import set_the_table
from .story import ChapterResult, Measure, Mission, Picture, done, failed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..deformation.shapes.container import ContainerDescription

__all__ = ["grasp_the_bottle", "recognise_the_bottle"]

#: Of the mean of a level's readings: the finger's force and surface.
NOISE = TouchNoise(0.05, 5e-5)
#: At a single place an unusual bottle can be as stiff and as wide as another class.
CONFIDENCE, MIN_SQUEEZES, SQUEEZES = 0.98, 2, 8
#: Heights are parts of the completed outline, whose top is known to a few millimetres [m].
HEIGHT_SIGMA_M = 0.003
#: A state is claimed when it is so sure; at so many places it is asked for, each level read by so many frames.
STATE_CONFIDENCE, FIRM, STATE_FRAMES = 0.98, 6, 12
#: An empty bottle needs tenths of a newton, which a finger that ends two tenths of a millimetre off the
#: planned height has lost: it is held by this at least, where the wall bears it [N].
MIN_GRIP_N = 2.5
#: Above this share of the height the fingers may miss the rim: the height is known to millimetres only.
TOP = 0.85
#: Slowly up: where the wall narrows, fingers that run ahead of the bottle lose it [m/s].
LIFT_M_S = 0.02
#: Friction of the fingers' foam on a wall.
FOAM_FRICTION = 0.6
#: It is weighed a little above the table [m], twice as firmly as its heaviest contents would need.
WEIGH_M, WEIGH_MARGIN = 0.01, 2.0


@dataclass
class BayesSqueezer:
    """The Bayesian planner as the task asks for it, for an object whose height was measured."""

    model: HapticModel
    height_m: float
    rng: np.random.Generator
    samples: int = 32
    readings: list[TouchReading] = field(default_factory=list)
    _asked: tuple[int, str] = (HEIGHTS // 2, "x")

    def next_place(self) -> Place | None:
        """The touch that tells most for its time."""
        gains = touch_gains(self.model, tuple(self.readings), samples=self.samples, rng=self.rng)
        # The ends of an object are where a height that is off by millimetres matters most.
        gains = {touch: value for touch, value in gains.items() if 3 <= touch[0] <= HEIGHTS - 3}
        if not gains:
            return None
        self._asked = max(gains, key=lambda touch: gains[touch][0] / gains[touch][1])
        level, axis = self._asked
        return Place((level - 0.5) / HEIGHTS * self.height_m, 0.0 if axis == "x" else 0.5 * math.pi)

    def update(self, curve: SqueezeCurve) -> None:
        """Take what was felt there; both sides of a pinch are one reading."""
        fit = reading_of(curve)
        level, axis = self._asked
        self.readings.append(TouchReading(level, axis, (fit, None), 2.0 * curve.surface_m))

    def belief(self) -> Mapping[str, float]:
        """Of every class, and of none of them."""
        return update_belief(self.model, tuple(self.readings)).as_mapping()


def reading_of(curve: SqueezeCurve) -> CurveCoefficients:
    """Coefficients of a squeeze at several levels."""
    return fit_curve(np.maximum(curve.deformation_m, 0.0), curve.force_N, NOISE)


def the_hand(mission: Mission) -> tuple[KitchenTable, Hand]:
    """Arm and gripper at the table, with the bottle where it truly stands."""
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
    """Squeeze where it tells most until the class is sure, then once more, firmly, for the state."""
    known, bottle = mission.known, set_the_table(mission)
    assert known.outline_m is not None
    assert known.bottle_at_m is not None
    _, hand = the_hand(mission)
    x, y, _ = PLACE.apply(np.array([*known.bottle_at_m, 0.0]))
    height = float(known.outline_m[-1, 1])
    model = fit_model(training_objects(), GROUPS, settings=ModelSettings(pose_m=HEIGHT_SIGMA_M))
    asker = BayesSqueezer(model, height, mission.rng(32))
    settings = ClassifySettings(
        confidence=CONFIDENCE,
        min_squeezes=MIN_SQUEEZES,
        squeezes=SQUEEZES,
        squeeze=SqueezeSettings(object_m=(x, y, 0.0)),
    )
    found = classify_by_squeezing(hand, asker, settings)
    for curve in found.curves:
        mission.say(
            f"  squeezed at {1e3 * curve.place.height_m:.0f} mm: {curve.stiffness_N_per_m / 1e3:.2f} N/mm, "
            f"{2e3 * curve.surface_m:.1f} mm wide"
        )
    classes = ", ".join(f"{name} {fraction:.2f}" for name, fraction in _sorted(found.belief)[:3])
    mission.say(f"  classes: {classes}")
    if not found.ending.success:
        return failed(f"{found.ending.outcome}: {found.ending.why}")
    if found.best == UNKNOWN:
        return failed(f"it is like none of the classes that are known ({classes})")
    known.curves, known.class_name = found.curves, found.best
    known.class_model = _nearest(found.best, known.outline_m)
    if not _is_round(known.class_model):
        return failed(f"it is taken for {found.best}, whose contents can't be told in this way")
    gentle = [(curve.place.height_m, curve.stiffness_N_per_m) for curve in found.curves]
    wall = wall_from_stiffness(known.outline_m, gentle, float(known.class_model.wall[0]))
    told = _state(hand, known.outline_m, (x, y, 0.0), wall)
    known.wall_factor = wall / float(known.class_model.wall[0])
    parts = [
        Measure("class", found.best, bottle.description.name),
        Measure("squeezes that told it", len(found.curves), None),
        Measure("wall [mm]", 1e3 * wall, 1e3 * bottle.wall_m),
        Measure("state", told.best, bottle.state),
        Measure("its probability", told.belief[told.best], None),
        Measure(
            "mass felt [kg]", None if told.mass_kg is None else told.mass_kg[0], bottle.container.mass_kg
        ),
        Picture(
            _belief_figure(found.belief, asker, told.curves[-1]),
            "How sure it is of the class, and the last squeeze that tells the state",
        ),
    ]
    if not told.sure:
        return failed(f"it is a {found.best}, but its state is not told: {told.why}", *parts)
    known.state = told.best
    right = found.best == bottle.description.name and told.best == bottle.state
    why = (
        f"a {found.best} ({found.belief[found.best]:.2f}), {told.why}, {len(found.curves)} gentle ones before"
    )
    return done(why, right, *parts)


def _sorted(belief: Mapping[str, float]) -> list[tuple[str, float]]:
    return sorted(belief.items(), key=lambda item: -item[1])


def _nearest(name: str, outline_m: Float[np.ndarray, "k 2"]) -> ContainerDescription:
    """The variant of the class that is most like the measured outline."""
    from ..deformation.shapes.container import load_container
    from ..deformation.shapes.variants import draw_variants

    base = load_container(GROUPS.get(name, (name,))[0])
    variants = draw_variants(base, 24, 0)
    fraction = np.linspace(0.05, 0.9, 20)

    def off(one: ContainerDescription) -> float:
        profile = profile_of(one, 16)
        theirs = np.interp(fraction, profile[:, 1] / profile[-1, 1], profile[:, 0])
        ours = np.interp(fraction, outline_m[:, 1] / outline_m[-1, 1], outline_m[:, 0])
        return float(np.sum((theirs - ours) ** 2)) + (profile[-1, 1] - outline_m[-1, 1]) ** 2

    return min(variants, key=off)


def _is_round(model: ContainerDescription) -> bool:
    return model.base.shape == "circle"


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """What squeezes and weight say of the contents."""

    belief: Mapping[str, float]
    curves: list[SqueezeCurve]  #: of large deformation
    mass_kg: tuple[float, float] | None  #: and its standard deviation; ``None``: not lifted

    @property
    def best(self) -> str:
        """Most probable, ``UNKNOWN`` among them."""
        return max(self.belief, key=lambda name: self.belief[name])

    @property
    def sure(self) -> bool:
        """Whether a known state is claimed: an open container feels alike whatever is in it, so never unweighed."""
        known = self.best != UNKNOWN and self.mass_kg is not None
        return known and self.belief[self.best] >= STATE_CONFIDENCE

    @property
    def why(self) -> str:
        """One clause."""
        weight = "could not be weighed" if self.mass_kg is None else f"weighs {1e3 * self.mass_kg[0]:.0f} g"
        fraction = f"{self.best} {self.belief[self.best]:.2f} after {len(self.curves)} firm squeezes"
        if self.best == UNKNOWN:
            return f"its contents are not known to the model: {fraction}, {weight}"
        return f"{fraction}, {weight}"


def _state(
    hand: Hand, outline_m: Float[np.ndarray, "k 2"], object_m: tuple[float, float, float], wall_m: float
) -> Told:
    """Squeeze firmly where the states differ most, weigh it, and squeeze elsewhere while it is in doubt."""
    model = ContentsModel(outline_m, wall_m, {name: ContentsState(*one) for name, one in STATES.items()})
    settings = SqueezeSettings(
        object_m=object_m, forces_N=FORCES_N, deformation_m=DEEPEST_M, hold_frames=STATE_FRAMES
    )
    # After the heights the same again from the side: wall and noise are others there.
    heights = model.heights_m()
    places = [Place(z, angle) for angle in (0.0, 0.5 * math.pi) for z in heights]
    curves: list[SqueezeCurve] = []
    why, told = "", Told(model.probabilities([]), [], None)
    for place in places[:FIRM]:
        felt = squeeze(hand, [place], settings)
        why = f"{felt.ending.outcome}: {felt.ending.why}"
        if felt.ending.outcome == SqueezeOutcome.SENSOR_FAILED:
            break
        curves += [curve for curve in felt.curves if len(curve.force_N) >= 4]
        if curves:
            mass = told.mass_kg or _weighed(hand, model, curves[-1], object_m)
            samples = [SqueezeSamples(c.place.height_m, c.deformation_m, c.force_N) for c in curves]
            told = Told(model.probabilities(samples, mass), curves, mass)
            if told.sure or mass is None:
                break
    if not curves:
        raise InputError("squeeze", f"{why}; no curve of large deformation")
    return told


def _weighed(
    hand: Hand, model: ContentsModel, curve: SqueezeCurve, object_m: tuple[float, float, float]
) -> tuple[float, float] | None:
    """Lift it by a finger's width where it was squeezed, and put it back; ``None`` when it does not come along."""
    heaviest = max(mass + 3.0 * sigma for mass, sigma in map(model.mass_kg, model.states))
    wanted = WEIGH_MARGIN * heaviest * GRAVITY_M_S2 / (2.0 * FOAM_FRICTION)
    plan = GraspPlan(
        curve.place, min(wanted, float(curve.force_N[-1])), DEEPEST_M + 1e-3, object_m,
        lift_m=WEIGH_M, arm_m_s=LIFT_M_S, put_back=True,
    )  # fmt: skip
    lifted = grasp_and_lift(hand, plan)
    mass = lifted.mass_kg
    # What is not felt above the noise of the load was not lifted: the fingers have slipped.
    return None if mass is None or mass[0] < 3.0 * mass[1] else mass


def grasp_the_bottle(mission: Mission) -> ChapterResult:
    """Plan on the recognised class's stiffness map, corrected by what was felt; grasp and lift."""
    from ..deformation.maps.confidence_band import object_map
    from ..deformation.nonlinear.contents import Contents
    from ..deformation.shapes.mesher import mesh_container
    from ..grasping.grasp_task import GraspTask
    from ..grasping.planner import plan_grasps
    from ..recognition.touch.refinement import correct_map

    known = mission.known
    assert known.class_model is not None
    assert known.outline_m is not None
    assert known.bottle_at_m is not None
    kitchen, hand = the_hand(mission)
    closed, fill = STATES[known.state]
    thing = mesh_container(known.class_model, around=32)
    surface = object_map(thing, Contents(fill=fill) if closed else None, band=False)
    # Heights are taken in parts: the class's variant is not exactly as high as the bottle.
    scale = thing.height_m / float(known.outline_m[-1, 1])
    points, measured, sigma = [], [], []
    for curve in known.curves:
        z, k = curve.place.height_m, curve.stiffness_N_per_m
        if not (np.isfinite(k) and k > 0):
            continue
        radius = float(np.interp(z, known.outline_m[:, 1], known.outline_m[:, 0]))
        angle = curve.place.angle_rad
        for turn in (0.0, math.pi):
            points.append([radius * math.cos(angle + turn), radius * math.sin(angle + turn), scale * z])
            measured.append(k)
            sigma.append(max(0.05, reading_of(curve).i_relative_sigma))
    surface = correct_map(surface, np.array(points), np.array(measured), np.array(sigma))
    plan = plan_grasps(
        thing,
        GraspTask(closed=closed, fill=fill),
        count=3,
        surface=surface,
        arm_cost=lambda grasp: 0.0 if grasp.first_m[2] < TOP * thing.height_m else math.inf,
    )
    mass = plan.load.mass_kg if plan.load is not None else math.nan
    if not plan.grasps:
        return failed(f"no grasp: {plan.reason} ({1e3 * mass:.0f} g)")
    best = plan.grasps[0]
    height = float(best.first_m[2]) / scale
    angle = math.atan2(best.direction[1], best.direction[0])
    mission.say(
        f"  {1e3 * mass:.0f} g need {best.needed_N:.1f} N at {1e3 * height:.0f} mm; the wall gives way by "
        f"{1e3 * best.deformation_m:.1f} mm there"
    )
    x, y, _ = PLACE.apply(np.array([*known.bottle_at_m, 0.0]))
    # Two fingers are as good either way round: the smaller turn is taken.
    angle = math.remainder(angle, math.pi)
    force = max(best.force_N, min(MIN_GRIP_N, best.deformation_limit_N))
    fraction = force / best.force_N
    bound = 2.0 * fraction * (best.deformation_m + 3.0 * best.deformation_sigma_m) + 0.001
    task = GraspPlan(
        Place(height, angle),
        force,
        deformation_m=min(bound, 0.01),
        object_m=(x, y, 0.0),
        arm_m_s=LIFT_M_S,
    )
    held = grasp_and_lift(hand, task)
    true_mass = kitchen.container.mass_kg
    parts = (
        Measure("mass [kg]", mass, true_mass),
        Measure("force of each finger, needed at least [N]", best.needed_N, None),
        Measure("force of each finger, felt [N]", held.force_N, kitchen.force_N),
        Measure(
            "deformation of one side at the grasp [mm]", 1e3 * held.deformation_m, 1e3 * kitchen.deformation_m
        ),
        Measure("lifted [m]", task.lift_m if held.ending.success else 0.0, kitchen.lifted_m),
        Picture(
            _score_figure(plan),
            "Grasp score on the stiffness map of the recognised class, and the grasp (circles)",
        ),
    )
    if not held.ending.success:
        return failed(f"{held.ending.outcome}: {held.ending.why}", *parts)
    return done(
        f"lifted: {held.ending.why}", kitchen.lifted_m > 0.8 * task.lift_m and not kitchen.fallen, *parts
    )


def _belief_figure(belief: Mapping[str, float], asker: BayesSqueezer, curve: SqueezeCurve) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.6, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    names = list(belief)
    for count in range(1, len(asker.readings) + 1):
        fraction = update_belief(asker.model, tuple(asker.readings[:count])).as_mapping()
        left.plot(
            [fraction[name] for name in names], "o-", label=f"after {count} squeeze{'s' * (count > 1)}", lw=1
        )
    left.set_xticks(range(len(names)), names, rotation=30, ha="right", fontsize=8)
    left.set(ylabel="probability", ylim=(-0.03, 1.03))
    left.legend(fontsize=8)
    right.plot(1e3 * curve.deformation_m, curve.force_N, "o-", color="C1")
    right.set(xlabel="deformation of one side [mm]", ylabel="force of one finger [N]")
    for axes in (left, right):
        axes.grid(alpha=0.3)
    return figure


def _score_figure(plan: object) -> Figure:
    from matplotlib.figure import Figure

    from ..grasping.planner import GraspPlan as Plan

    assert isinstance(plan, Plan)
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
