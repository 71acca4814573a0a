"""Identify the contents of a container: squeeze firmly at the most informative height, weigh, and squeeze again if needed."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...core.errors import InputError
from ...core.measurement import GRAVITY_M_S2
from ...recognition.touch.contents import (
    FILLINGS,
    FORCES_N,
    MAX_DEFORMATION_M,
    ContentsModel,
    ContentsPosterior,
    SqueezeSamples,
)
from ...recognition.touch.haptic_model import UNKNOWN
from .grasp import LiftPlan, grasp_and_lift
from .hand import Hand, Place
from .squeeze_task import SqueezeCurve, SqueezeOutcome, SqueezeSettings, squeeze

#: Minimum probability of a claimed lid state; maximum number of squeezes; number of frames read at each level.
CONFIDENCE, MAX_SQUEEZES, HOLD_FRAMES = 0.98, 6, 12
#: Minimum number of force levels of a large-deformation curve.
MIN_LEVELS = 4
#: Coefficient of friction between the foam of the fingers and a wall.
FOAM_FRICTION = 0.6
#: Height above the table at which the object is weighed [m], and safety factor of the grasp force for its heaviest contents.
WEIGH_M, WEIGH_MARGIN = 0.01, 2.0
#: Speed of the lift, slow because fingers that run ahead of the object slip where the wall narrows [m/s].
LIFT_M_S = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class ContentsFinding:
    """Contents estimated from squeezes and weight."""

    posterior: ContentsPosterior
    curves: list[SqueezeCurve]  #: large-deformation curves
    mass_kg: tuple[float, float] | None  #: mass and its standard deviation [kg]; ``None``: not lifted

    @property
    def belief(self) -> dict[str, float]:
        """Posterior probability of ``open``, ``closed`` and ``UNKNOWN``."""
        return self.posterior.belief()

    @property
    def lid(self) -> str:
        """The most probable lid state of :attr:`belief`."""
        belief = self.belief
        return max(belief, key=lambda name: belief[name])

    @property
    def fill(self) -> tuple[float, float]:
        """Mean and standard deviation of the fill fraction, given the lid state if that is claimed."""
        return self.posterior.fill_of(self.lid if self.confident else None)

    @property
    def confident(self) -> bool:
        """Whether a lid state is claimed: only after weighing, since an open container feels the same whatever it contains."""
        return self.lid != UNKNOWN and self.mass_kg is not None and self.belief[self.lid] >= CONFIDENCE

    @property
    def why(self) -> str:
        """Reason, as one clause."""
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
    """Squeeze firmly where the lid states differ most, weigh, and squeeze elsewhere while undecided.

    Parameters
    ----------
    hand
        Arm, gripper and sensor; without ``weigh`` no lid state is claimed.
    model
        Force and mass in every state.
    object_m
        Centre of the bottom of the object in the base frame of the arm [m].
    open_m
        Opening of the gripper on the way to a place [m].

    Raises
    ------
    InputError
        No place yielded a large-deformation curve.
    """
    settings = SqueezeSettings(
        object_m=object_m,
        forces_N=FORCES_N,
        deformation_m=MAX_DEFORMATION_M,
        open_m=open_m,
        hold_frames=HOLD_FRAMES,
    )
    heights = model.heights_m()
    # A height that is there again is squeezed from the side.
    places = [Place(z, 0.5 * math.pi * (z in heights[:k])) for k, z in enumerate(heights)]
    heaviest_kg = max(mass + 3.0 * sigma for mass, sigma in (model.mass_kg(1.0, name) for name in FILLINGS))
    curves: list[SqueezeCurve] = []
    why, found = "", ContentsFinding(model.posterior([]), [], None)
    for place in places[:MAX_SQUEEZES]:
        felt = squeeze(hand, [place], settings)
        why = f"{felt.ending.outcome}: {felt.ending.why}"
        if felt.ending.outcome == SqueezeOutcome.SENSOR_FAILED:
            break
        curves += [curve for curve in felt.curves if len(curve.force_N) >= MIN_LEVELS]
        if curves:
            mass = found.mass_kg or weigh(hand, heaviest_kg, curves[-1], object_m, open_m)
            samples = [SqueezeSamples(c.place.height_m, c.deformation_m, c.force_N) for c in curves]
            found = ContentsFinding(model.posterior(samples, mass), curves, mass)
            if found.confident or hand.weigh is None:
                break
    if not curves:
        raise InputError("squeeze", f"{why}; no curve of large deformation")
    return found


def weigh(
    hand: Hand,
    heaviest_kg: float,
    curve: SqueezeCurve,
    object_m: tuple[float, float, float],
    open_m: float = 0.11,
) -> tuple[float, float] | None:
    """Lift an object a little where it was squeezed, and put it back.

    Parameters
    ----------
    hand
        Arm, gripper and sensors.
    heaviest_kg
        Upper bound of the mass, with the heaviest filling; it determines the force of the grasp [kg].
    curve
        The squeeze at the place of the grasp.
    object_m
        Centre of the bottom of the object in the base frame of the arm [m].
    open_m
        Opening of the gripper on the way to the place [m].

    Returns
    -------
    tuple or None
        Mass and its standard deviation [kg]; ``None`` if the object was not lifted.
    """
    needed = WEIGH_MARGIN * heaviest_kg * GRAVITY_M_S2 / (2.0 * FOAM_FRICTION)
    plan = LiftPlan(
        curve.place, min(needed, float(curve.force_N[-1])), MAX_DEFORMATION_M + 1e-3, object_m,
        lift_m=WEIGH_M, open_m=open_m, arm_m_s=LIFT_M_S, put_back=True,
    )  # fmt: skip
    mass = grasp_and_lift(hand, plan).mass_kg
    # A mass below the noise of the load sensor was not lifted: the fingers slipped.
    return None if mass is None or mass[0] < 3.0 * mass[1] else mass
