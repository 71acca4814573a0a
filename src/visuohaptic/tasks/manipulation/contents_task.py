"""Find out what a container holds: squeeze firmly where the contents differ most, weigh, and squeeze again."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...core.errors import InputError
from ...core.measurement import GRAVITY_M_S2
from ...recognition.touch.contents import (
    DEEPEST_M,
    FILLINGS,
    FORCES_N,
    ContentsModel,
    ContentsPosterior,
    SqueezeSamples,
)
from ...recognition.touch.haptic_model import UNKNOWN
from .grasp import LiftPlan, grasp_and_lift
from .hand import Hand, Place
from .squeeze_task import SqueezeCurve, SqueezeOutcome, SqueezeSettings, squeeze

__all__ = ["ContentsFinding", "identify_contents", "weigh"]

#: A lid is claimed from this probability on; at most this many squeezes, each level read by this many frames.
CONFIDENCE, MAX_SQUEEZES, HOLD_FRAMES = 0.98, 6, 12
#: Levels of force that a curve of large deformation needs.
MIN_LEVELS = 4
#: Friction of the fingers' foam on a wall.
FOAM_FRICTION = 0.6
#: It is weighed a little above the table [m], this many times as firmly as its heaviest contents would need.
WEIGH_M, WEIGH_MARGIN = 0.01, 2.0
#: Slowly up: where the wall narrows, fingers that run ahead of the object lose it [m/s].
LIFT_M_S = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class ContentsFinding:
    """What squeezes and weight say of the contents."""

    posterior: ContentsPosterior
    curves: list[SqueezeCurve]  #: of large deformation
    mass_kg: tuple[float, float] | None  #: and its standard deviation; ``None``: not lifted

    @property
    def belief(self) -> dict[str, float]:
        """Posterior probability of ``open``, ``closed`` and ``UNKNOWN``."""
        return self.posterior.belief()

    @property
    def lid(self) -> str:
        """The most probable of :attr:`belief`."""
        belief = self.belief
        return max(belief, key=lambda name: belief[name])

    @property
    def fill(self) -> tuple[float, float]:
        """Mean and standard deviation of the fraction that is filled, given the lid where that is sure."""
        return self.posterior.fill_of(self.lid if self.sure else None)

    @property
    def sure(self) -> bool:
        """Whether a lid is claimed: an open container feels alike whatever is in it, so never unweighed."""
        return self.lid != UNKNOWN and self.mass_kg is not None and self.belief[self.lid] >= CONFIDENCE

    @property
    def why(self) -> str:
        """One clause."""
        weight = "could not be weighed" if self.mass_kg is None else f"weighs {1e3 * self.mass_kg[0]:.0f} g"
        found = (
            f"{self.lid} (probability {self.belief[self.lid]:.2f}, "
            f"{len(self.curves)} firm squeeze{'s' * (len(self.curves) != 1)})"
        )
        if self.lid == UNKNOWN:
            return f"its contents are not known to the model: {found}, {weight}"
        return f"{found}, {100 * self.fill[0]:.0f} ± {100 * self.fill[1]:.0f} % full, {weight}"


def identify_contents(
    hand: Hand, model: ContentsModel, object_m: tuple[float, float, float], open_m: float = 0.11
) -> ContentsFinding:
    """Squeeze firmly where the lids differ most, weigh, and squeeze elsewhere while it is not decided.

    Parameters
    ----------
    hand
        Arm, gripper and sensor; without ``weigh`` nothing is claimed.
    model
        Force and mass in every state.
    object_m
        Middle of the object's bottom in the base of the arm [m].
    open_m
        Opening of the gripper on the way to a place [m].

    Raises
    ------
    InputError
        No place gave a curve of large deformation.
    """
    settings = SqueezeSettings(
        object_m=object_m, forces_N=FORCES_N, deformation_m=DEEPEST_M, open_m=open_m, hold_frames=HOLD_FRAMES
    )
    # After the heights the same again from the side: wall and noise are others there.
    heights = model.heights_m()
    places = [Place(z, angle) for angle in (0.0, 0.5 * math.pi) for z in heights]
    curves: list[SqueezeCurve] = []
    why, found = "", ContentsFinding(model.posterior([]), [], None)
    for place in places[:MAX_SQUEEZES]:
        felt = squeeze(hand, [place], settings)
        why = f"{felt.ending.outcome}: {felt.ending.why}"
        if felt.ending.outcome == SqueezeOutcome.SENSOR_FAILED:
            break
        curves += [curve for curve in felt.curves if len(curve.force_N) >= MIN_LEVELS]
        if curves:
            mass = found.mass_kg or weigh(hand, model, curves[-1], object_m, open_m)
            samples = [SqueezeSamples(c.place.height_m, c.deformation_m, c.force_N) for c in curves]
            found = ContentsFinding(model.posterior(samples, mass), curves, mass)
            if found.sure or mass is None:
                break
    if not curves:
        raise InputError("squeeze", f"{why}; no curve of large deformation")
    return found


def weigh(
    hand: Hand,
    model: ContentsModel,
    curve: SqueezeCurve,
    object_m: tuple[float, float, float],
    open_m: float = 0.11,
) -> tuple[float, float] | None:
    """Lift an object by a finger's width where it was squeezed, and put it back.

    Parameters
    ----------
    hand
        Arm, gripper and sensors.
    model
        Full of the heaviest filling, it determines the force of the grasp.
    curve
        The squeeze at the place of the grasp.
    object_m
        Middle of the object's bottom in the base of the arm [m].
    open_m
        Opening of the gripper on the way to the place [m].

    Returns
    -------
    tuple or None
        Mass and its standard deviation [kg]; ``None`` when the object was not lifted.
    """
    heaviest = max(mass + 3.0 * sigma for mass, sigma in (model.mass_kg(1.0, name) for name in FILLINGS))
    needed = WEIGH_MARGIN * heaviest * GRAVITY_M_S2 / (2.0 * FOAM_FRICTION)
    plan = LiftPlan(
        curve.place, min(needed, float(curve.force_N[-1])), DEEPEST_M + 1e-3, object_m,
        lift_m=WEIGH_M, open_m=open_m, arm_m_s=LIFT_M_S, put_back=True,
    )  # fmt: skip
    mass = grasp_and_lift(hand, plan).mass_kg
    # What is not felt above the noise of the load was not lifted: the fingers have slipped.
    return None if mass is None or mass[0] < 3.0 * mass[1] else mass
