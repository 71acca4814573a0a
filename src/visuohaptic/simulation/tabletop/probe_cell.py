"""An arm with a point probe next to a bottle, with contact forces."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core.camera.pose import Pose
from ..rendering.blank_frames import BlankFrames
from .arm import SimulatedArm
from .bottles import Bottle


@dataclass
class ProbeCell(BlankFrames):
    """A ``robots.FrameSource`` that advances the arm with every frame; the bottle stands at a pose in the base."""

    arm: SimulatedArm
    bottle: Bottle
    rng: np.random.Generator
    T_base_bottle: Pose = field(default_factory=Pose.identity)
    stiffness_N_per_m: float = 2000.0  #: of probe and wall together
    force_sigma_N: float = 0.03
    frame_rate_Hz: float = 30.0
    duration_s: float = math.inf

    def advance(self, dt_s: float) -> float:
        """Advance the simulation; returns the new time [s]."""
        self.arm.advance(dt_s)
        return self.arm.t_s

    def load_N(self) -> Float[np.ndarray, "3"]:
        """True force on the probe in the base [N]: outwards, proportional to its penetration of the wall."""
        x, y, z = self.T_base_bottle.inverse().apply(self.arm.true_pose().translation_m)
        radius = math.hypot(x, y)
        wall = float(np.asarray(self.bottle.radius_m(np.array(math.atan2(y, x)), np.array(z))))
        if not 0.0 <= z <= self.bottle.height_m or radius >= wall:
            return np.zeros(3)
        outward = np.array([x, y, 0.0]) / max(radius, 1e-9)
        return self.T_base_bottle.rotation @ outward * self.stiffness_N_per_m * (wall - radius)

    def force(self) -> Float[np.ndarray, "3"]:
        """Force on the probe in the base [N], with noise: reading of a sensor that is not rendered."""
        return self.load_N() + self.force_sigma_N * self.rng.standard_normal(3)
