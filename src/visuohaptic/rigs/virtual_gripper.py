"""A simulated foam sensor of a gripper: pressed, calibrated, stripe trained, and zeroed like a real one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8

from ..core import Camera, Frame, PlaneView
from ..sensing.foam import FingerSensor, FoamSensorConfig
from ..sensing.foam.strip.stripe_view import train_stripe
from ..simulation.foam import FoamStrip, FoamStripGeometry, Outline, SensorRig, StripLaw
from ..simulation.foam.press_rig import STEP_M
from ..simulation.rendering import CameraEffects, FoamScene, Occluder, SceneObject
from ..simulation.rendering._finger_tag import FingerTag
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
from ..simulation.tabletop.kitchen import KitchenTable
from .virtual_beam import BeamCamera, VirtualBeam, wrist_beam
from .virtual_sensor import VirtualSensor, calibrate_by_press


@dataclass
class GripperSensor:
    """Parameters for the simulation of a gripper's foam sensor, and its files."""

    geometry: FoamStripGeometry = ROD
    law: StripLaw = RUBBER_FOAM
    rig: SensorRig = GRIPPER_RIG
    tag: FingerTag = field(default_factory=FingerTag)
    stripe: bool = True
    effects: CameraEffects = field(default_factory=lambda: CameraEffects(1.0, 3.0, vignetting=0.2))
    press_sigma_N: float = 0.15  #: noise of the press's force sensor
    spacing_m: float = 0.002  #: spacing of the contour points

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
            As in :class:`.VirtualGripper`.
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
        """Press and calibrate the foam, and write all files except the zero reference; returns ``sensor.yaml``.

        Parameters
        ----------
        folder, rng, config
            As in :meth:`.VirtualSensor.build`.
        """
        folder, rod = Path(folder), self.geometry
        calibrate_by_press(folder, rod, self.law, self.press_sigma_N, rng)
        sections: dict[str, Any] = {
            "tracking": {"base_is": "brighter", "foam_is": "darker"},
            "finger": {
                "tag_id": self.tag.tag_id,
                "tag_size_m": self.tag.size_m,
                "T_foam_tag": self.tag.T_foam_tag.fields,
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
            As in :meth:`.VirtualSensor.build`.
        """
        sensor = FingerSensor.load(self.write(folder, rng, **config))
        frames = self.gripper(rng=rng)
        zero = sensor.zero((frames.frame() for _ in range(zero_frames)), limit=zero_frames)
        zero.save(sensor.setup.zero_path)
        return sensor


#: Appearance of the finger: black foam on bare metal.
TRACKING = {"base_is": "brighter", "foam_is": "darker"}
#: The strip, measured every two millimetres [m].
STRIP = {"length_m": 0.06, "spacing_m": 0.002}
#: Height of the container above the foam, and distance of the table below it [m].
TOP_M, FLOOR_M = 0.05, 0.12


def finger_sensor() -> VirtualSensor:
    """Foam rubber on a finger, with a small camera at a distance of 12 cm: 0.2 mm per pixel.

    A third of its depth supports about 20 N from a wall with the curvature of a bottle, half of it the maximum grasp force of 54 N.
    """
    return VirtualSensor(
        geometry=FoamStripGeometry(length_m=0.06, width_m=0.015, height_m=0.015, spacing_m=0.001),
        law=StripLaw(mu_Pa=(100e3, 2.5e3), alpha=(3.0, -2.0)),
        rig=SensorRig(distance_m=0.12, focal_px=560.0, width_px=400, height_px=224, look_ahead_m=0.012),
        look=gripper_look(stripe=False),
        effects=CameraEffects(1.0, 2.0, vignetting=0.2),
        press_sigma_N=0.15,
    )


@dataclass
class VirtualHand(KitchenTable):
    """A ``KitchenTable`` whose frames show the foam of one finger; the other finger is its mirror image.

    Another camera observes the beam from which the hand hangs: see :meth:`wrist_frame`.
    """

    #: When closing at 12 mm/s, a finger moves 0.3 mm per frame: 1 N if the wall is rigid.
    frame_rate_Hz: float = 20.0
    finger: VirtualSensor = field(default_factory=finger_sensor)
    wrist: VirtualBeam | None = None  #: beam from which it hangs; by default a :func:`.wrist_beam`

    def __post_init__(self) -> None:
        wrist = self.wrist or wrist_beam(self.rng)
        self.wrist_camera, self.wrist_N_per_m = BeamCamera(wrist, self.rng), wrist.rig.rod.spring_N_per_m
        self._strip = FoamStrip(self.finger.geometry, self.finger.law)
        self._back_m = self.finger.geometry.back_m(self._strip.s_m)
        self._front_m = self._strip.inner_m(self.finger.geometry.width_m)
        self._renderer = self.finger.renderer()
        self._stiffness_N_per_m = self._short_m = 0.0
        self._drawn: tuple[np.ndarray, Float32[np.ndarray, "rows columns channels"]] | None = None
        super().__post_init__()

    @property
    def camera(self) -> Camera:
        """The camera on the finger."""
        return self.finger.rig.camera

    def image(self, t_s: float) -> UInt8[np.ndarray, "rows columns"]:
        """The finger's foam and the scene in front of it.

        Parameters
        ----------
        t_s
            Simulation time [s].
        """
        camera, effects = self.camera, self.finger.effects
        if self.arm.t_s >= self.sensor_failure_at_s:
            return np.zeros((camera.height, camera.width), np.uint8)
        wall, radius = self._wall(), self._radius()
        # A static scene is rendered once (to a tenth of a micrometre); every frame has its own noise.
        state = np.round(np.append(self._front_m, [[radius, wall.vertices_m[0, 0]]], axis=0), 7)
        if self._drawn is None or not np.array_equal(self._drawn[0], state):
            bodies = (SceneObject(wall.polygon_m(), TOP_M, 150.0, 8.0),) if radius > 0 else ()
            scene = FoamScene(t_s, self._back_m, self._front_m, bodies, floor_below_m=FLOOR_M)
            self._drawn = state, np.atleast_3d(self._renderer.render_exact(scene))
        return effects.developed(self._drawn[1], np.full(camera.height, t_s), self.rng)[..., 0]

    def wrist_frame(self) -> Frame:
        """Current image of the beam from which the hand hangs."""
        return self.wrist_camera.frame(np.array([self.load_N, 0.0, 0.0]), self.arm.t_s)

    def _wall(self) -> Outline:
        """The deformed container's section in the frame of the finger."""
        short_m = self._radius() - 0.5 * self._opening
        return self._body(short_m, max(self._pinched().bend_at(self._height()), 1e-3))

    def _body(self, short_m: float, bend_m: float) -> Outline:
        """The wall at the finger: a disc of its curvature, with its undeformed surface ``short_m`` behind the foam's front."""
        front_m = self.finger.geometry.width_m
        return Outline.disc((front_m + bend_m - short_m + self.deformation_m, 0.0), bend_m)

    def _balance(self) -> None:
        """Press the foam until the deformations of wall and foam together match the opening of the fingers."""
        self._fall()
        radius = self._radius()
        short = radius - 0.5 * self._opening
        if short <= 0:
            if self._short_m > 0 or self.force_N > 0:
                self._front_m = self._strip.press([]).front_m
            self.force_N = self.deformation_m = self._stiffness_N_per_m = self._short_m = 0.0
            return
        steps = max(1, math.ceil(abs(short - self._short_m) / STEP_M))
        for reached in np.linspace(self._short_m, short, steps + 1)[1:]:
            self._press(float(reached))

    def _press(self, short_m: float) -> None:
        """One step: deform the wall according to the foam's last stiffness, then press the foam.

        The remaining imbalance is left to the next step: pressing the foam too far and releasing it would
        be recorded as unloading.
        """
        foam, height, felt = short_m - self.deformation_m, self._height(), self._pinched()
        before_m = self._short_m - self.deformation_m
        predicted_N = self.force_N + self._stiffness_N_per_m * (foam - before_m)
        low, high, deformed_m = 0.0, short_m, self.deformation_m
        for _ in range(40):
            wall = 0.5 * (low + high)
            rest_N = predicted_N - self._stiffness_N_per_m * (wall - deformed_m)
            low, high = (low, wall) if felt.force_at(height, wall) > rest_N else (wall, high)
        self.deformation_m, self._short_m = 0.5 * (low + high), short_m
        state = self._strip.press([self._body(short_m, felt.bend_at(height))])
        moved_m, change_N = short_m - self.deformation_m - before_m, state.load_N - self.force_N
        bound = self._strip.stiffness_N_per_m()
        slope = change_N / moved_m if abs(moved_m) > 1e-9 else bound
        self._stiffness_N_per_m = float(np.clip(slope, 0.1 * bound, bound))
        self.force_N, self._front_m = state.load_N, state.front_m
