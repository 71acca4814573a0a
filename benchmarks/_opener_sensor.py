"""The beam sensor on the opener, simulated through its images: built, calibrated with weights, zeroed, read.

The task gets the wrench only from camera images of the bending rod: templates are
rendered, tracked, and converted with the compliance of a calibration. The true rod deviates from its
data sheet; the calibration has to estimate the difference.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Float32

from visuohaptic.core.camera.frame import Frame
from visuohaptic.core.camera.model import Camera
from visuohaptic.core.errors import InputError
from visuohaptic.core.measurement import Reason, Wrench
from visuohaptic.rigs import VirtualBeam
from visuohaptic.sensing.beam.calibration import BeamCalibration, calibrate_beam
from visuohaptic.sensing.beam.mechanics import Beam
from visuohaptic.sensing.beam.records import LoadRecord
from visuohaptic.sensing.beam.sensor import BeamSetup
from visuohaptic.sensing.beam.tracked import TrackedBeam
from visuohaptic.simulation.beam.rod import ElasticRod
from visuohaptic.simulation.beam.rod_rig import RodRig
from visuohaptic.simulation.rendering.effects import CameraEffects
from visuohaptic.simulation.tabletop.crown_cap import ROTATION_TOOL_SENSOR, CrownCapCell, OpenerBeam
from visuohaptic.tasks.manipulation.crown_cap import tool_wrench

__all__ = ["OpenerSensor"]

#: Largest weight on each axis of the sensor in the calibration [N, Nm]: within the travel of the springs.
WEIGHTS = (15.0, 15.0, 40.0, 0.5, 2.0, 1.5)
#: Images of each weight; during the first ones the tracker re-detects the rod.
HELD_FRAMES, FOUND_FRAMES = 4, 2
#: Errors of a rod and its springs: length [m], and relative.
LENGTH_SIGMA_M, DIAMETER_SIGMA, YOUNGS_SIGMA, SPRING_SIGMA = 2e-4, 0.003, 0.01, 0.05
#: Below this wrench the image at rest is used, with new noise [N, Nm].
NOTHING = 1e-4
ZERO_FRAMES = 20


class OpenerSensor:
    """One sensor; it may open many bottles.

    Parameters
    ----------
    seed
        Of what differs from the data sheet, and of the noise of the calibration's images.
    camera
        Bolted to the base of the sensor, 0.3 m above the rod; by default that of Sec. 3.6.1.
    kind
        What is stuck to the rod: AprilTags or images.
    """

    def __init__(
        self, seed: int = 0, *, camera: Camera | None = None, kind: Literal["tags", "pictures"] = "tags"
    ) -> None:
        rng = np.random.default_rng(seed)
        sheet = OpenerBeam()
        wrong = rng.standard_normal(5)
        #: the true rod
        self.rod = OpenerBeam(
            length_m=sheet.length_m + LENGTH_SIGMA_M * float(wrong[0]),
            diameter_m=sheet.diameter_m * (1.0 + DIAMETER_SIGMA * float(wrong[1])),
            youngs_Pa=sheet.youngs_Pa * (1.0 + YOUNGS_SIGMA * float(wrong[2])),
            spring_N_per_m=sheet.spring_N_per_m * (1.0 + SPRING_SIGMA * float(wrong[3])),
            spring_Nm_per_rad=sheet.spring_Nm_per_rad * (1.0 + SPRING_SIGMA * float(wrong[4])),
        )
        self._virtual = VirtualBeam(
            RodRig(rod=_elastic(self.rod)),
            camera or Camera.simple(1600, 896, 1800.0),
            CameraEffects(blur_px=0.8, noise_sigma=3.0, vignetting=0.15, gradient_x=0.1),
            kind,
            view="steady",
            beam=Beam(
                length_m=sheet.length_m,
                diameter_m=sheet.diameter_m,
                youngs_Pa=sheet.youngs_Pa,
                poisson=sheet.poisson,
                spring_N_per_m=sheet.spring_N_per_m,
                spring_Nm_per_rad=sheet.spring_Nm_per_rad,
            ),
        )
        self._renderer, self._templates = self._virtual.renderer(), self._virtual.templates()
        self._rest = self._renderer.exact(self._virtual.rig.rod.bend(np.zeros(3)))
        rig = self._virtual.rig
        self.setup = BeamSetup(
            {name: xi for name, (xi, _) in rig.mounts.items()},
            rig.T_sensor_reference.inverse(),
            self._virtual.beam,
            reference=rig.reference,
            view="steady",
        )
        self.calibration = self._calibrate(rng)
        self.setup = replace(self.setup, correction=self.calibration.correction)

    def reader(self, cell: CrownCapCell, rng: np.random.Generator) -> Callable[[Frame], Wrench]:
        """A function that reads the wrench from the frames of a cell, axes of the tool; zeroed before the first.

        Parameters
        ----------
        cell, rng
            As of :meth:`.CapSensor.reader`; the noise is the camera's.
        """
        sensor = self._zeroed(rng)
        to_sensor = np.kron(np.eye(2), ROTATION_TOOL_SENSOR.T)

        def feel(frame: Frame) -> Wrench:
            try:
                exact = self._exact(to_sensor @ cell.wrench_tool)
            except InputError:  # no equilibrium of the rod for this load
                nothing = np.full(3, np.nan)
                return Wrench(
                    frame.t_s, False, Reason.SATURATED, nothing, nothing.copy(), np.full((6, 6), np.nan), "tool"
                )  # fmt: skip
            seen = self._picture(exact, frame.t_s, frame.index, rng)
            return tool_wrench(sensor.read(seen).reading.wrench, ROTATION_TOOL_SENSOR)

        return feel

    def _exact(self, wrench: Float[np.ndarray, "6"]) -> Float32[np.ndarray, "rows columns"]:
        """Image of the rod under a wrench at its tip, axes of the sensor; before light and noise."""
        if np.abs(wrench).max() <= NOTHING:
            return self._rest
        return self._renderer.exact(self._virtual.rig.rod.bend(wrench[:3], wrench[3:]))

    def _picture(
        self, exact: Float32[np.ndarray, "rows columns"], t_s: float, index: int, rng: np.random.Generator
    ) -> Frame:
        effects = self._renderer.effects
        image = effects.developed(exact[..., None], np.full(len(exact), t_s), rng)[..., 0]
        return Frame(image, t_s, index)

    def _zeroed(self, rng: np.random.Generator) -> TrackedBeam:
        """A tracker that has seen the sensor at rest in the second before the time 0."""
        sensor = TrackedBeam(self.setup, self._templates, self._virtual.camera)
        sensor.zero(
            self._picture(self._rest, (index - ZERO_FRAMES) / 30.0 - 0.1, index, rng)
            for index in range(ZERO_FRAMES)
        )
        return sensor

    def _calibrate(self, rng: np.random.Generator) -> BeamCalibration:
        """Loads on each axis, in both directions, half and full, with unloaded images in between."""
        loads = [np.zeros(6)]
        for axis, most in enumerate(WEIGHTS):
            for fraction in (-1.0, -0.5, 0.5, 1.0):
                loads.append(np.zeros(6))
                loads[-1][axis] = fraction * most
        loads.append(np.zeros(6))
        sensor = self._zeroed(rng)
        applied, observed = [], []
        for row, load in enumerate(loads):
            read = []
            exact = self._exact(load)
            for held in range(HELD_FRAMES):
                index = row * HELD_FRAMES + held
                wrench = sensor.read(self._picture(exact, index / 30.0, index, rng)).reading.wrench
                if held >= FOUND_FRAMES and wrench.valid:
                    read.append([*wrench.force_N, *wrench.moment_Nm])
            if read:
                applied.append(load)
                observed.append(np.mean(read, axis=0))
        rows = np.arange(1, len(applied) + 1)
        record = LoadRecord(np.array(applied), np.array(observed), "wrench", rows, "weights")
        return calibrate_beam(record, self._virtual.beam)


def _elastic(rod: OpenerBeam) -> ElasticRod:
    return ElasticRod(
        rod.length_m, rod.diameter_m, rod.youngs_Pa, rod.poisson, rod.spring_N_per_m, rod.spring_Nm_per_rad
    )
