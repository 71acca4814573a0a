"""An arm whose probe is the rod of a beam sensor: what it touches bends the rod, and a camera sees it bend."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32, UInt8

from ..core.camera.model import Camera
from ..core.camera.pose import Pose
from ..simulation.tabletop.probe_cell import ProbeCell
from .virtual_beam import VirtualBeam

__all__ = ["T_TIP_SENSOR", "VirtualProbe", "probe_beam"]

#: The rod hangs upright from its clamp: X of the sensor points along it, down to the tip.
T_TIP_SENSOR = Pose(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), np.zeros(3))


def probe_beam() -> VirtualBeam:
    """A beam sensor with a small camera that is bolted to the clamp.

    At half the pixels across a force is off by three times as much, and a pixel less is a template lost now and
    then. The rod is soft: at 3 cm/s and ten frames a second a contact grows by 0.27 N a frame.
    """
    return VirtualBeam(camera=Camera.simple(640, 360, 720.0), view="steady", frame_rate_Hz=10.0)


@dataclass
class VirtualProbe(ProbeCell):
    """A ``ProbeCell`` whose frames show the rod; its spring is that of the rod across its axis."""

    frame_rate_Hz: float = 10.0
    virtual: VirtualBeam = field(default_factory=probe_beam)

    def __post_init__(self) -> None:
        self.frame_rate_Hz = self.virtual.frame_rate_Hz
        # Large deflections make it stiffer by 0.2 % at half a newton.
        half_N = np.array([0.0, 0.5, 0.0])
        self.stiffness_N_per_m = 0.5 / float(self.virtual.rig.rod.bend(half_N).points_m[-1, 1])
        self._renderer = self.virtual.renderer()
        self._at_rest: Float32[np.ndarray, "rows columns"] | None = None

    @property
    def camera(self) -> Camera:
        """The camera at the clamp."""
        return self.virtual.camera

    def image(self, t_s: float) -> UInt8[np.ndarray, "rows columns"]:
        """The rod as it is bent now.

        Parameters
        ----------
        t_s
            The world's time [s].
        """
        force_N = (self.arm.true_pose() @ T_TIP_SENSOR).rotation.T @ self.load_N()
        # Most of the time nothing is touched: that view is drawn once, its noise is that of each frame.
        if force_N.any():
            exact = self._exact(force_N)
        else:
            exact = self._at_rest = self._exact(force_N) if self._at_rest is None else self._at_rest
        return self.virtual.effects.developed(exact[..., None], np.full(self.camera.height, t_s), self.rng)[
            ..., 0
        ]

    def _exact(self, force_N: np.ndarray) -> Float32[np.ndarray, "rows columns"]:
        return self._renderer.exact(self.virtual.rig.rod.bend(force_N), self.virtual.rig.T_camera_sensor)
