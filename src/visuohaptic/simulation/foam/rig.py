"""The camera above the strip, as on the platform of Alt 2016, Sec. 3.3: pose and intrinsics."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from ...core import Camera, Pose, save_yaml


@dataclass(frozen=True, slots=True)
class SensorRig:
    """A camera that looks from behind and above onto the top of the strip; figure 3.3.

    The defaults are those of figure 3.4: 0.3 m away, 70 degrees to the sensor plane, f = 1800 px.
    """

    distance_m: float = 0.3  #: d, from the camera to the centre of the strip
    angle_rad: float = math.radians(70.0)  #: gamma, between the line of sight and the sensor plane
    focal_px: float = 1800.0
    width_px: int = 1600
    height_px: int = 896
    look_ahead_m: float = 0.03  #: the optical axis meets the sensor plane this far ahead of the strip
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    row_delay_s: float = 0.0

    @property
    def camera(self) -> Camera:
        """The camera's model."""
        return _placed(self)[0]

    @property
    def T_camera_foam(self) -> Pose:
        """Maps coordinates of the sensor frame F to the camera."""
        return _placed(self)[1]

    def half_size(self) -> SensorRig:
        """The same view with half the resolution, for quick runs: rendering takes a quarter of the time."""
        return replace(
            self,
            focal_px=0.5 * self.focal_px,
            width_px=self.width_px // 2,
            height_px=self.height_px // 2,
            row_delay_s=2 * self.row_delay_s,
        )

    def write(
        self,
        folder: Path | str,
        *,
        foam: str = "foam.yaml",
        length_m: float = 0.25,
        radius_m: float | None = None,
        **more: object,
    ) -> Path:
        """Write ``camera.yaml`` and ``sensor.yaml`` of a strip seen by this camera.

        Parameters
        ----------
        folder
            Existing folder.
        foam
            Name of the material file, relative to the folder.
        length_m
            Length of the strip [m].
        radius_m
            Radius of a bent strip [m]; straight by default.
        more
            Further fields of ``sensor.yaml``.
        """
        folder = Path(folder)
        self.camera.save(folder / "camera.yaml")
        strip: dict[str, float] = {"length_m": length_m}
        if radius_m is not None:
            strip["radius_m"] = radius_m
        save_yaml(
            folder / "sensor.yaml",
            {
                "kind": "foam",
                "camera": "camera.yaml",
                "foam": foam,
                "strip": strip,
                "T_camera_foam": self.T_camera_foam.fields,
                **more,
            },
        )
        return folder / "sensor.yaml"


@lru_cache(maxsize=16)
def _placed(rig: SensorRig) -> tuple[Camera, Pose]:
    """Camera and pose: the same objects for every frame, by which the renderer knows what it has computed of them."""
    camera = Camera.simple(
        rig.width_px,
        rig.height_px,
        rig.focal_px,
        distortion=np.array(rig.distortion),
        row_delay_s=rig.row_delay_s,
        transfer_function="linear",
    )
    eye = np.array([-math.cos(rig.angle_rad), 0.0, math.sin(rig.angle_rad)]) * rig.distance_m
    return camera, camera.pose_of_view(eye, [rig.look_ahead_m, 0.0, 0.0]).inverse()
