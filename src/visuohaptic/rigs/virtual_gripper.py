"""A gripper's foam sensor in the virtual world: pressed, calibrated, stripe learnt, zeroed, as one would a real one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..core.camera.plane import PlaneView
from ..sensing.foam.finger import FingerSensor
from ..sensing.foam.strip.config import FoamSensorConfig
from ..sensing.foam.strip.stripe_view import train_stripe
from ..simulation.foam.rig import SensorRig
from ..simulation.foam.strip_geometry import FoamStripGeometry
from ..simulation.foam.strip_law import StripLaw
from ..simulation.rendering._finger_tag import FingerTag
from ..simulation.rendering.appearance import Occluder
from ..simulation.rendering.effects import CameraEffects
from ..simulation.tabletop.gripper import VirtualGripper
from ..simulation.tabletop.gripper_setup import (
    GRIPPER_RIG,
    ROD,
    RUBBER_FOAM,
    STRIPE_M,
    FingerView,
    GraspObject,
    gripper_look,
)
from .virtual_sensor import calibrate_by_press

__all__ = ["GripperSensor"]


@dataclass
class GripperSensor:
    """What it takes to simulate a gripper's foam sensor, and the files that describe it."""

    geometry: FoamStripGeometry = ROD
    law: StripLaw = RUBBER_FOAM
    rig: SensorRig = GRIPPER_RIG
    tag: FingerTag = field(default_factory=FingerTag)
    stripe: bool = True
    effects: CameraEffects = field(default_factory=lambda: CameraEffects(1.0, 3.0, vignetting=0.2))
    press_sigma_N: float = 0.15  #: noise of the press's force sensor
    spacing_m: float = 0.002  #: of the contour's points

    def gripper(
        self,
        *objects: GraspObject,
        rng: np.random.Generator,
        occluders: Sequence[Occluder] = (),
        tag: bool = True,
    ) -> VirtualGripper:
        """The gripper with this sensor.

        Parameters
        ----------
        objects, rng
            As of :class:`.VirtualGripper`.
        occluders
            Objects in front of the scene.
        tag
            Whether the finger carries its AprilTag.
        """
        view = FingerView(
            self.rig,
            gripper_look(stripe=self.stripe),
            self.effects,
            self.tag if tag else None,
            tuple(occluders),
        )
        return VirtualGripper(objects, rng=rng, view=view, geometry=self.geometry, law=self.law)

    def write(self, folder: Path | str, rng: np.random.Generator, **config: Any) -> Path:
        """Press the foam, calibrate it and write all files but the zero reference; returns ``sensor.yaml``.

        Parameters
        ----------
        folder, rng, config
            As of :meth:`.VirtualSensor.build`.
        """
        folder, rod = Path(folder), self.geometry
        calibrate_by_press(folder, rod, self.law, self.press_sigma_N, rng)
        pose = self.tag.T_foam_tag
        sections: dict[str, Any] = {
            "tracking": {"base_is": "brighter", "foam_is": "darker"},
            "finger": {
                "tag_id": self.tag.tag_id,
                "tag_size_m": self.tag.size_m,
                "T_foam_tag": {
                    "translation_m": [float(value) for value in pose.translation_m],
                    "quaternion_xyzw": [float(value) for value in pose.quaternion_xyzw],
                },
            },
        }
        if self.stripe:
            sections["stripe"] = {"model": "stripe.npz", "width_m": STRIPE_M}
        strip = {"length_m": rod.length_m, "spacing_m": self.spacing_m}
        path = self.rig.write(folder, length_m=rod.length_m, **(sections | {"strip": strip} | config))
        if self.stripe:
            setup = FoamSensorConfig.load(path)
            plane = PlaneView(setup.camera, setup.T_camera_foam)
            image = self.gripper(rng=rng).frame().image
            train_stripe(setup, image, plane, rng=rng).save(folder / "stripe.npz")
        return path

    def build(
        self, folder: Path | str, rng: np.random.Generator, *, zero_frames: int = 20, **config: Any
    ) -> FingerSensor:
        """Write all files and return the zeroed sensor.

        Parameters
        ----------
        folder, rng, zero_frames, config
            As of :meth:`.VirtualSensor.build`.
        """
        sensor = FingerSensor.load(self.write(folder, rng, **config))
        frames = self.gripper(rng=rng)
        zero = sensor.zero((frames.frame() for _ in range(zero_frames)), limit=zero_frames)
        zero.save(sensor.setup.zero_path)
        return sensor
