"""A complete simulated foam sensor: pressed, calibrated, mounted and zeroed like a real one."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..core.camera.frame import Frame
from ..sensing.foam import FoamSensor, calibrate_foam, read_strain_stress
from ..simulation.foam import FoamStripGeometry, SensorRig, calibration_press
from ..simulation.foam.strip_law import SOFT_FOAM, StripLaw, write_calibration_csv
from ..simulation.rendering import CameraEffects, FoamScene, Look, SceneRenderer

#: Imperfections of the camera in demos and benchmarks: a typical webcam in indoor light.
WEBCAM = CameraEffects(blur_px=1.0, noise_sigma=3.0, vignetting=0.2, gradient_x=0.1)


def rest_scene(geometry: FoamStripGeometry) -> FoamScene:
    """The strip without any object.

    Parameters
    ----------
    geometry
        Foam strip.
    """
    s = geometry.positions_m()
    back = geometry.back_m(s)
    return FoamScene(0.0, back, back + geometry.width_m * geometry.normals(s))


def calibrate_by_press(
    folder: Path,
    geometry: FoamStripGeometry,
    law: StripLaw,
    press_sigma_N: float,
    rng: np.random.Generator,
) -> None:
    """Write ``strain_stress.csv`` from a simulated press, and calibrate ``foam.yaml`` from it.

    Parameters
    ----------
    folder
        Existing folder that receives both files.
    geometry, law
        The foam strip and its material.
    press_sigma_N
        Standard deviation of the press's force sensor [N].
    rng
        Noise source.
    """
    rows = calibration_press(
        geometry=FoamStripGeometry(geometry.length_m, geometry.width_m, geometry.height_m, spacing_m=0.002),
        law=law,
        reference_sigma_N=press_sigma_N,
        rng=rng,
    )
    write_calibration_csv(folder / "strain_stress.csv", rows)
    calibration = calibrate_foam(
        read_strain_stress(folder / "strain_stress.csv"),
        width_m=geometry.width_m,
        height_m=geometry.height_m,
    )
    calibration.material.save(folder / "foam.yaml")


@dataclass
class VirtualSensor:
    """Parameters for the simulation of a foam sensor, and its files.

    ``build`` writes ``strain_stress.csv`` from a simulated press, calibrates it to
    ``foam.yaml``, writes ``camera.yaml`` and ``sensor.yaml``, and takes the zero
    reference from rendered frames: the estimator receives nothing else.
    """

    geometry: FoamStripGeometry = field(default_factory=lambda: FoamStripGeometry(spacing_m=0.001))
    law: StripLaw = SOFT_FOAM
    rig: SensorRig = field(default_factory=SensorRig)
    look: Look = field(default_factory=Look.photo)
    effects: CameraEffects = WEBCAM
    press_sigma_N: float = 0.05  #: noise of the press's force sensor
    frame_rate_Hz: float = 30.0

    def build(
        self,
        folder: Path | str,
        rng: np.random.Generator,
        *,
        zero_frames: int = 30,
        **config: Any,
    ) -> FoamSensor:
        """Write all files to a folder and return the zeroed sensor.

        Parameters
        ----------
        folder
            Existing folder that receives the files.
        rng
            Noise source of press and camera.
        zero_frames
            Number of frames of the zero reference.
        config
            Additional sections of ``sensor.yaml``.
        """
        folder = Path(folder)
        calibrate_by_press(folder, self.geometry, self.law, self.press_sigma_N, rng)
        bent = np.isfinite(self.geometry.radius_m)
        path = self.rig.write(
            folder,
            length_m=self.geometry.length_m,
            radius_m=self.geometry.radius_m if bent else None,
            **config,
        )
        sensor = FoamSensor.load(path)
        zero = sensor.zero(self.rest_frames(rng, zero_frames), limit=zero_frames)
        zero.save(sensor.setup.zero_path)
        return sensor

    def renderer(self) -> SceneRenderer:
        """Renderer of the camera above this strip."""
        return SceneRenderer(self.rig.camera, self.rig.T_camera_foam, self.look, self.effects)

    def rest_frames(self, rng: np.random.Generator, count: int) -> list[Frame]:
        """Frames of the untouched strip that end just before time zero.

        Parameters
        ----------
        rng
            Noise source.
        count
            Number of frames.
        """
        images = self.renderer().repeated(rest_scene(self.geometry), count, rng=rng)
        return [Frame(image, i / self.frame_rate_Hz, i) for i, image in enumerate(images, -count)]
