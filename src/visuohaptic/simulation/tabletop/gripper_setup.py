"""Foam, drive, view and objects of the simulated gripper, and its ground truth at one time (Alt 2016, Sec. 3.6.4)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core import POSITIVE, InputError, Ranged
from ..foam import FoamStripGeometry, Outline, SensorRig, StripLaw
from ..rendering import CameraEffects, Look, Occluder, Surface
from ..rendering._finger_tag import FingerTag

#: Rubber foam (EPDM): slope about 0.4 MPa per unit strain, a 7 cm bottle reaches 100 N.
RUBBER_FOAM = StripLaw(mu_Pa=(200e3, 5e3), alpha=(3.0, -2.0))
#: The rod on the finger: cross section 1.5 x 1 cm.
ROD = FoamStripGeometry(length_m=0.1, width_m=0.015, height_m=0.01, spacing_m=0.001)
#: Camera above the gripper, slightly outside the grasping range.
GRIPPER_RIG = SensorRig(look_ahead_m=0.022)
#: Width of the stripe on the rod [m].
STRIPE_M = 0.003
_TAG = FingerTag()
_BLUE = Surface(150.0, 8.0, "cardboard", (170.0, 140.0, 110.0))


def gripper_look(*, stripe: bool = True) -> Look:
    """Black rubber on a finger of bare metal, with a green stripe along the front.

    Parameters
    ----------
    stripe
        Whether the foam has a stripe.
    """
    return Look(
        foam=Surface(38.0, 2.0, "foam", (36.0, 38.0, 40.0)),
        body=Surface(150.0, 3.0, "metal", (152.0, 150.0, 147.0)),
        floor=Surface(112.0, 10.0, "planks", (74.0, 108.0, 138.0)),
        stripe=Surface(120.0, 2.0, "plain", (70.0, 170.0, 55.0)) if stripe else None,
        stripe_width_m=STRIPE_M,
        body_margin_m=0.005,
        face_contrast=0.35,
        shadow=0.4,
        colour=stripe,
    )


@dataclass(frozen=True, slots=True)
class GripperDrive(Ranged):
    """Opening and drive of the gripper; both fingers move symmetrically."""

    open_m: float = field(default=0.1, metadata=POSITIVE)  #: maximum opening, between the fronts of both rods
    acceleration_m_s2: float = field(default=0.5, metadata=POSITIVE)  #: of each finger
    max_force_N: float = field(default=120.0, metadata=POSITIVE)  #: the drive stops by itself at this force


@dataclass(frozen=True, slots=True, eq=False)
class FingerView(Ranged):
    """The camera of the gripper and the visible surfaces of the finger."""

    rig: SensorRig = GRIPPER_RIG
    look: Look = field(default_factory=gripper_look)
    effects: CameraEffects = field(default_factory=lambda: CameraEffects(1.0, 3.0))
    tag: FingerTag | None = _TAG  #: AprilTag on the finger
    occluders: tuple[Occluder, ...] = ()  #: objects in front of the scene
    frame_rate_Hz: float = field(default=30.0, metadata=POSITIVE)


@dataclass(frozen=True, slots=True, eq=False)
class GraspObject:
    """An object between the fingers: an outline on a spring that both fingers load."""

    outline: Outline  #: cross section, frame R
    #: Force per displacement of its surface at one finger; infinite for a rigid object.
    stiffness_N_per_m: float = math.inf
    top_m: float = 0.05  #: height of its top above the foam's top
    surface: Surface = _BLUE

    def __post_init__(self) -> None:
        if not self.stiffness_N_per_m > 0:
            raise InputError(
                "GraspObject", f"found {self.stiffness_N_per_m}, expected > 0", field="stiffness_N_per_m"
            )


@dataclass(frozen=True, slots=True, eq=False)
class GripperTruth:
    """State at one time."""

    t_s: float
    position_m: float  #: of the finger along x of R
    speed_m_s: float
    force_N: float  #: of the foam on all objects along x
    object_force_N: Float[np.ndarray, "objects"]  #: on every object
    shift_m: Float[np.ndarray, "objects"]  #: displacement of every object's surface
    front_m: Float[np.ndarray, "k 2"]  #: front contour, frame F
    stripe_m: Float[np.ndarray, "k 2"]  #: inner edge of the stripe, frame F

    @property
    def front_rest_m(self) -> Float[np.ndarray, "k 2"]:
        """Front contour in the fixed frame R."""
        return self.front_m + np.array([self.position_m, 0.0])
