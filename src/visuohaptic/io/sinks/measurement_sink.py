"""Measurements as topics with standard ROS 2 messages, written to a file or published."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ...core import Camera, Event, ForceProfile, Frame, InputError, Pose, Wrench
from ..ros import ros_messages as ros

if TYPE_CHECKING:
    from ..maps.occupancy_map import OccupancyMap

_CONTACT_NUMBERS = ("s_start_m", "s_end_m", "force_N", "force_sigma_N")


class MeasurementSink(ABC):
    """Converts measurements to topics and messages, and passes them to :meth:`write`."""

    frame: str  #: name of the sensor's coordinate frame

    @abstractmethod
    def write(self, topic: str, datatype: str, t_s: float, message: dict[str, Any]) -> None:
        """Write the fields of one standard message.

        Parameters
        ----------
        topic
            Name such as ``/foam/wrench``.
        datatype
            Name such as ``geometry_msgs/msg/WrenchStamped``.
        t_s
            Time of the measurement, seconds since the epoch.
        message
            Fields of the message.
        """

    def write_force(self, profile: ForceProfile, name: str = "foam") -> None:
        """Force, validity, contact contour and profile of a laminar sensor.

        Parameters
        ----------
        profile
            Measurement of the sensor.
        name
            Name of the sensor, the first part of its topics.
        """
        values: dict[str, Any] = {
            "force_N": float(profile.force_N),
            "force_sigma_N": float(profile.force_sigma_N),
            **{name: float(value) for name, value in asdict(profile.budget).items()},
            "contacts": len(profile.contacts),
        }
        for place, contact in enumerate(profile.contacts):
            numbers = {name: float(getattr(contact, name)) for name in _CONTACT_NUMBERS}
            entry = {**numbers, "valid": bool(contact.valid), "reason": str(contact.reason)}
            values[f"contact{place}"] = json.dumps(entry)
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
        """Force and moment with validity and covariance.

        Parameters
        ----------
        wrench
            Force [N] and moment [Nm] with their covariance.
        name
            Name of the sensor, the first part of its topics.
        """
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
        """An event as JSON text; an unknown position is omitted.

        Parameters
        ----------
        event
            The event.
        name
            Name of the sensor, the first part of its topics.
        """
        data: dict[str, Any] = {"kind": str(event.kind), "t_s": event.t_s}
        if np.isfinite(event.s_m):
            data["s_m"] = event.s_m
        self.write(f"/{name}/event", "std_msgs/msg/String", event.t_s, {"data": json.dumps(data)})

    def write_frame(
        self, frame: Frame, name: str = "camera", *, compressed: bool = True, quality: int | None = None
    ) -> None:
        """An image: PNG, JPEG or raw.

        Parameters
        ----------
        frame
            The image with its time.
        name
            Name of the camera, the first part of its topics and its coordinate frame.
        compressed
            Whether to encode as PNG or JPEG.
        quality
            JPEG quality 1..100; ``None`` for PNG.
        """
        if compressed:
            message = ros.compressed_image(frame.t_s, frame.image, name, quality)
            self.write(f"/{name}/image/compressed", "sensor_msgs/msg/CompressedImage", frame.t_s, message)
        else:
            message = ros.image(frame.t_s, frame.image, name)
            self.write(f"/{name}/image", "sensor_msgs/msg/Image", frame.t_s, message)

    def write_camera(self, camera: Camera, t_s: float, name: str = "camera") -> None:
        """The camera model, in the namespace of its images by ROS convention.

        Parameters
        ----------
        camera
            Camera model.
        t_s
            Time of the image, seconds since the epoch.
        name
            Name of the camera, as for its images.
        """
        # ``/camera/image`` and ``/camera/camera_info`` are in one namespace; so is image/compressed.
        self.write(
            f"/{name}/camera_info", "sensor_msgs/msg/CameraInfo", t_s, ros.camera_info(t_s, camera, name)
        )

    def write_pose(
        self,
        T_frame_body: Pose,
        t_s: float,
        topic: str = "/pose",
        *,
        frame: str = "map",
        covariance: Float[np.ndarray, "6 6"] | None = None,
    ) -> None:
        """A pose, with its covariance if known.

        Parameters
        ----------
        T_frame_body
            Pose [m].
        t_s
            Time of the pose, seconds since the epoch.
        topic
            Name of the topic.
        frame
            Name of the target frame of the pose.
        covariance
            Of (x, y, z, rotation about x, y, z), shape (6, 6) [m, rad].

        Raises
        ------
        InputError
            The covariance has the wrong shape.
        """
        head, body = ros.header(t_s, frame), ros.pose(T_frame_body)
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

    def write_map(self, grid: OccupancyMap, t_s: float) -> None:
        """An occupancy map, on ``/map`` in the frame ``map``.

        Parameters
        ----------
        grid
            The map.
        t_s
            Time of the map, seconds since the epoch.
        """
        self.write("/map", "nav_msgs/msg/OccupancyGrid", t_s, grid.to_message(t_s, "map"))
