"""Measurements to MCAP with standard ROS 2 messages only, so that any ROS tool opens the file."""

from __future__ import annotations

import json
import logging
import os
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING, Any, Self

import numpy as np
from jaxtyping import Float

from ..camera import Camera, Frame, Pose
from ..errors import InputError, MissingExtraError
from ..objects import Event, ForceProfile, Wrench
from . import ros_messages as ros
from ._ros_definitions import definition

if TYPE_CHECKING:
    from .occupancy_map import OccupancyMap

__all__ = ["MeasurementWriter"]

_log = logging.getLogger(__name__)


class MeasurementWriter:
    """Writes an MCAP file as it is measured.

    While it is written the file is called ``NAME.mcap.part``; it gets its name
    when it is closed. Every message is with the operating system when its
    ``write_...`` returns: after a crash the ``.part`` file still holds all of
    them, and :class:`McapSource`, ``visuohaptic recording info`` and
    ``mcap recover`` read it.

    Parameters
    ----------
    path
        File to write; an older one is replaced when this one is closed.
    frame
        Name of the sensor's frame of coordinates.
    chunk_bytes
        Messages are collected up to this size before they are compressed and
        written. 0 writes each at once; 64 kB takes about a third of the space
        for force profiles but may lose the last chunk in a crash.

    Notes
    -----
    Topics and types, below the sensor's ``name``:

    ========================== =================================================
    ``/NAME/wrench``           ``geometry_msgs/WrenchStamped``, NaN when not valid
    ``/NAME/diagnostics``      ``diagnostic_msgs/DiagnosticArray``: validity, reason, sigmas
    ``/NAME/contact``          ``sensor_msgs/PointCloud2``: contact contour
    ``/NAME/profile``          ``sensor_msgs/PointCloud2``: whole strip
    ``/NAME/event``            ``std_msgs/String``, JSON: kind, t_s, s_m
    ========================== =================================================

    Examples
    --------
    >>> with MeasurementWriter("run.mcap") as writer:  # doctest: +SKIP
    ...     writer.write_force(profile)
    """

    def __init__(self, path: Path | str, *, frame: str = "sensor", chunk_bytes: int = 0) -> None:
        try:
            from mcap_ros2.writer import Writer
        except ImportError as error:
            raise MissingExtraError("mcap-ros2-support", "recording", "writing MCAP") from error
        if chunk_bytes < 0:
            raise InputError("chunk_bytes", f"found {chunk_bytes}, expected >= 0")
        self.path = Path(path)
        self.part = self.path.with_name(self.path.name + ".part")  #: name until it is closed
        self.frame = frame
        if not self.path.parent.is_dir():
            raise InputError(path, "its folder does not exist", remedy=f"create {self.path.parent}")
        if self.path.is_dir():
            raise InputError(path, "is a folder, expected a file name")
        if self.part.exists():
            kept = self._free_name()
            self.part.rename(kept)
            _log.warning("%s is left of a run that did not end; kept as %s", self.part, kept)
        try:
            self._stream: IO[bytes] = self.part.open("xb")
        except OSError as error:
            raise InputError(path, f"cannot be written ({error.strerror})") from error
        self._writer: Any = Writer(self._stream, chunk_size=chunk_bytes)
        self._schemas: dict[str, Any] = {}
        self._counts: dict[str, int] = {}
        self._open = True

    def _free_name(self) -> Path:
        number = 1
        while (kept := self.path.with_name(f"{self.path.stem}.recovered{number}.mcap")).exists():
            number += 1
        return kept

    def write(self, topic: str, datatype: str, t_s: float, message: dict[str, Any]) -> None:
        """Write the fields of any standard message that this library knows."""
        if not self._open:
            raise InputError(self.path, "is closed")
        if datatype not in self._schemas:
            self._schemas[datatype] = self._writer.register_msgdef(datatype, definition(datatype))
        count = self._counts.get(topic, 0)
        self._writer.write_message(
            topic, self._schemas[datatype], message, log_time=ros.stamp_ns(t_s), sequence=count
        )
        self._stream.flush()
        self._counts[topic] = count + 1

    def write_force(self, profile: ForceProfile, name: str = "foam") -> None:
        """Force, validity, contact contour and profile of a laminar sensor."""
        budget = profile.budget
        values: dict[str, Any] = {
            "force_N": float(profile.force_N),
            "force_sigma_N": float(profile.force_sigma_N),
            "image_N": float(budget.image_N),
            "calibration_N": float(budget.calibration_N),
            "model_N": float(budget.model_N),
            "zero_N": float(budget.zero_N),
            "contacts": len(profile.contacts),
        }
        for place, contact in enumerate(profile.contacts):
            values[f"contact{place}"] = json.dumps(
                {
                    "s_start_m": float(contact.s_start_m),
                    "s_end_m": float(contact.s_end_m),
                    "force_N": float(contact.force_N),
                    "force_sigma_N": float(contact.force_sigma_N),
                    "valid": bool(contact.valid),
                    "reason": str(contact.reason),
                }
            )
        t_s, frame = profile.t_s, self.frame
        self.write(
            f"/{name}/wrench", "geometry_msgs/msg/WrenchStamped", t_s, ros.force_wrench(profile, frame)
        )
        self._diagnose(name, t_s, frame, profile.valid, profile.reason, values)
        self.write(f"/{name}/profile", "sensor_msgs/msg/PointCloud2", t_s, ros.profile_cloud(profile, frame))
        if profile.contacts:
            self.write(
                f"/{name}/contact", "sensor_msgs/msg/PointCloud2", t_s, ros.contact_cloud(profile, frame)
            )

    def write_wrench(self, wrench: Wrench, name: str = "beam") -> None:
        """Force and moment with validity and covariance."""
        names = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
        numbers = np.concatenate([wrench.force_N, wrench.moment_Nm])
        values: dict[str, Any] = {key: float(value) for key, value in zip(names, numbers, strict=True)}
        values["covariance"] = json.dumps(np.asarray(wrench.covariance).tolist())
        self.write(f"/{name}/wrench", "geometry_msgs/msg/WrenchStamped", wrench.t_s, ros.wrench(wrench))
        self._diagnose(name, wrench.t_s, wrench.frame, wrench.valid, wrench.reason, values)

    def _diagnose(
        self, name: str, t_s: float, frame: str, valid: bool, reason: str, values: dict[str, Any]
    ) -> None:
        message = ros.diagnostics(t_s, frame, name, valid, reason, values)
        self.write(f"/{name}/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", t_s, message)

    def write_event(self, event: Event, name: str = "foam") -> None:
        """An event as JSON text; a place that is unknown is left out."""
        data: dict[str, Any] = {"kind": str(event.kind), "t_s": event.t_s}
        if np.isfinite(event.s_m):
            data["s_m"] = event.s_m
        self.write(f"/{name}/event", "std_msgs/msg/String", event.t_s, {"data": json.dumps(data)})

    def write_frame(
        self, frame: Frame, name: str = "camera", *, compressed: bool = True, quality: int | None = None
    ) -> None:
        """An image: PNG (``quality=None``), JPEG of a quality 1..100, or raw (``compressed=False``)."""
        if compressed:
            message = ros.compressed_image(frame.t_s, frame.image, name, quality)
            self.write(f"/{name}/image/compressed", "sensor_msgs/msg/CompressedImage", frame.t_s, message)
        else:
            message = ros.image(frame.t_s, frame.image, name)
            self.write(f"/{name}/image", "sensor_msgs/msg/Image", frame.t_s, message)

    def write_camera(self, camera: Camera, t_s: float, name: str = "camera") -> None:
        """The camera's model, beside its images by ROS's convention."""
        # ``/camera/image`` and ``/camera/camera_info`` are in one namespace; so is image/compressed.
        self.write(
            f"/{name}/camera_info", "sensor_msgs/msg/CameraInfo", t_s, ros.camera_info(t_s, camera, name)
        )

    def write_pose(
        self,
        pose_frame_body: Pose,
        t_s: float,
        topic: str = "/pose",
        *,
        frame: str = "map",
        covariance: Float[np.ndarray, "6 6"] | None = None,
    ) -> None:
        """A pose, with the covariance of (x, y, z, rotation about x, y, z) [m, rad] where it is known."""
        head, body = ros.header(t_s, frame), ros.pose(pose_frame_body)
        if covariance is None:
            self.write(topic, "geometry_msgs/msg/PoseStamped", t_s, {"header": head, "pose": body})
            return
        if np.shape(covariance) != (6, 6):
            raise InputError("covariance", f"found shape {np.shape(covariance)}, expected (6, 6)")
        flat = [float(value) for value in np.asarray(covariance).ravel()]
        self.write(
            topic,
            "geometry_msgs/msg/PoseWithCovarianceStamped",
            t_s,
            {"header": head, "pose": {"pose": body, "covariance": flat}},
        )

    def write_map(self, grid: OccupancyMap, t_s: float, topic: str = "/map", *, frame: str = "map") -> None:
        """An occupancy map."""
        self.write(topic, "nav_msgs/msg/OccupancyGrid", t_s, grid.to_message(t_s, frame))

    def close(self) -> None:
        """Write the index, and give the file its name; harmless when repeated."""
        if not self._open:
            return
        self._open = False
        self._writer.finish()
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()
        self.part.replace(self.path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # What was measured before a failure is worth as much as after it.
        self.close()
