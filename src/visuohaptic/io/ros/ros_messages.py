"""Measurements, poses, cameras, maps and images as the fields of standard ROS 2 messages.

Messages are plain dictionaries in the layout of their ROS definition, the
input of the CDR writer. Timestamps come from ``t_s``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from ...core import Camera, Contact, ForceProfile, InputError, Pose, Wrench
from ...core.files import encode_image

Message = dict[str, Any]

#: ``sensor_msgs/PointField`` code of each type.
_POINT_TYPES = {"float32": 7, "float64": 8}


def stamp_ns(t_s: float) -> int:
    """Time in nanoseconds; exact to the resolution of a float64 (0.2 us today, seconds since 1970).

    Parameters
    ----------
    t_s
        Seconds since the epoch.
    """
    if not (math.isfinite(t_s) and 0 <= t_s < 2**31):
        raise InputError("t_s", f"found {t_s}, expected 0 to {2**31} s, the range of a ROS stamp")
    whole = math.floor(t_s)
    return whole * 1_000_000_000 + round((t_s - whole) * 1e9)


def stamp(t_s: float) -> Message:
    """``builtin_interfaces/Time``, or ``Duration``.

    Parameters
    ----------
    t_s
        Seconds since the epoch, or length of the duration.
    """
    seconds, nanoseconds = divmod(stamp_ns(t_s), 1_000_000_000)
    return {"sec": seconds, "nanosec": nanoseconds}


def stamp_s(message: Any, log_time_ns: int) -> float:
    """Time of a decoded message with a header [s]; its recording time if the stamp is zero.

    Parameters
    ----------
    message
        Decoded message.
    log_time_ns
        Recording time [ns].
    """
    found = message.header.stamp
    return 1e-9 * log_time_ns if found.sec == found.nanosec == 0 else found.sec + 1e-9 * found.nanosec


def header(t_s: float, frame: str) -> Message:
    """``std_msgs/Header``.

    Parameters
    ----------
    t_s
        Time of the measurement, seconds since the epoch.
    frame
        Name of the coordinate frame.
    """
    return {"stamp": stamp(t_s), "frame_id": frame}


def _vector(values: Sequence[float] | np.ndarray) -> Message:
    return {axis: float(value) for axis, value in zip("xyz", values, strict=True)}


def wrench(measured: Wrench) -> Message:
    """``geometry_msgs/WrenchStamped``; NaN if the measurement is invalid.

    The message has no validity field, and a reader may ignore the diagnostics.

    Parameters
    ----------
    measured
        Force [N] and moment [Nm], in their frame.
    """
    trust = 1.0 if measured.valid else math.nan
    force_N, moment_Nm = np.asarray(measured.force_N) * trust, np.asarray(measured.moment_Nm) * trust
    return _wrench(measured.t_s, measured.frame, force_N, moment_Nm)


def _wrench(t_s: float, frame: str, force_N: Any, moment_Nm: Any) -> Message:
    acting = {"force": _vector(force_N), "torque": _vector(moment_Nm)}
    return {"header": header(t_s, frame), "wrench": acting}


def force_wrench(profile: ForceProfile, frame: str) -> Message:
    """``geometry_msgs/WrenchStamped`` of a laminar sensor.

    The force acts on the sensor along -x of its frame (x points away from the
    robot); by convention for contact sensors, the message contains its
    magnitude along +x, the force on the object. NaN if invalid.

    Parameters
    ----------
    profile
        Measurement of the sensor.
    frame
        Name of the sensor's coordinate frame.
    """
    force = profile.force_N if profile.valid else math.nan
    return _wrench(profile.t_s, frame, (force, 0.0, 0.0), np.zeros(3))


def diagnostics(
    t_s: float, frame: str, name: str, valid: bool, reason: str, values: Mapping[str, Any]
) -> Message:
    """``diagnostic_msgs/DiagnosticArray``: validity, its reason and all numbers, even if invalid.

    Parameters
    ----------
    t_s
        Time of the measurement, seconds since the epoch.
    frame
        Name of the sensor's coordinate frame.
    name
        Name of the sensor.
    valid
        Whether the measurement is valid.
    reason
        Why it is invalid.
    values
        Numbers and strings by name, with the unit in the name.
    """
    level = 0 if valid else (3 if reason == "stale" else 1)
    status = {
        "level": level,
        "name": name,
        "message": str(reason),
        "hardware_id": frame,
        "values": [{"key": key, "value": _text(value)} for key, value in values.items()],
    }
    return {"header": header(t_s, frame), "status": [status]}


def _text(value: Any) -> str:
    return repr(float(value)) if isinstance(value, float | np.floating) else str(value)


def cloud(t_s: float, frame: str, fields: Sequence[tuple[str, str, np.ndarray]]) -> Message:
    """``sensor_msgs/PointCloud2`` with one row.

    Parameters
    ----------
    t_s
        Timestamp, seconds since the epoch.
    frame
        Name of the coordinate frame.
    fields
        For each column: name, ``float32`` or ``float64``, and one value per point.
    """
    layout = np.dtype([(name, "<" + np.dtype(kind).str[1:]) for name, kind, _ in fields])
    count = len(fields[0][2])
    data = np.zeros(count, dtype=layout)
    for name, _, values in fields:
        data[name] = values
    return {
        "header": header(t_s, frame),
        "height": 1,
        "width": count,
        "fields": [
            {
                "name": name,
                "offset": int(layout.fields[name][1]) if layout.fields else 0,
                "datatype": _POINT_TYPES[kind],
                "count": 1,
            }
            for name, kind, _ in fields
        ],
        "is_bigendian": False,
        "point_step": layout.itemsize,
        "row_step": layout.itemsize * count,
        "data": data.tobytes(),
        "is_dense": all(bool(np.isfinite(values).all()) for _, _, values in fields),
    }


def _contact_pressure_Pa(profile: ForceProfile, contact: Contact) -> Float[np.ndarray, "k"]:
    """Pressure at the points of a contact, taken from the profile at the same positions along the strip."""
    count = len(contact.delta_m)
    slack = 1e-9 + 1e-6 * abs(contact.s_end_m - contact.s_start_m)
    inside = (profile.s_m >= contact.s_start_m - slack) & (profile.s_m <= contact.s_end_m + slack)
    if int(inside.sum()) == count:
        return np.asarray(profile.pressure_Pa)[inside]
    if not len(profile.s_m):
        return np.full(count, np.nan)
    places = np.linspace(contact.s_start_m, contact.s_end_m, count)
    return np.interp(places, profile.s_m, profile.pressure_Pa)


def contact_cloud(profile: ForceProfile, frame: str) -> Message:
    """``sensor_msgs/PointCloud2`` of all contact points: x, y, z, delta, pressure, sigma, contact.

    Lengths in m, pressure in Pa; ``contact`` is the index of the region, from 0.

    Parameters
    ----------
    profile, frame
        As in :func:`force_wrench`.
    """
    contacts = profile.contacts
    points = np.concatenate([np.zeros((0, 2)), *(np.reshape(c.points_foam_m, (-1, 2)) for c in contacts)])
    pressure = [_contact_pressure_Pa(profile, contact) for contact in contacts]
    numbers = [np.full(len(contact.delta_m), place) for place, contact in enumerate(contacts)]

    def joined(parts: list[np.ndarray]) -> np.ndarray:
        return np.concatenate([np.zeros(0), *parts])

    return cloud(
        profile.t_s,
        frame,
        [
            ("x", "float32", points[:, 0]),
            ("y", "float32", points[:, 1]),
            ("z", "float32", np.zeros(len(points))),
            ("delta", "float32", joined([contact.delta_m for contact in contacts])),
            ("pressure", "float32", joined(pressure)),
            ("sigma", "float32", joined([contact.point_sigma_m for contact in contacts])),
            ("contact", "float32", joined(numbers)),
        ],
    )


def profile_cloud(profile: ForceProfile, frame: str) -> Message:
    """``sensor_msgs/PointCloud2`` of the whole strip in full precision.

    x = deflection, y = position along the strip, z = 0 for display; then delta,
    delta_sigma [m], pressure, pressure_sigma [Pa] and valid (0 or 1).

    Parameters
    ----------
    profile, frame
        As in :func:`force_wrench`.
    """
    return cloud(
        profile.t_s,
        frame,
        [
            ("x", "float32", -np.asarray(profile.delta_m)),
            ("y", "float32", profile.s_m),
            ("z", "float32", np.zeros(len(profile.s_m))),
            ("s", "float64", profile.s_m),
            ("delta", "float64", profile.delta_m),
            ("delta_sigma", "float64", profile.delta_sigma_m),
            ("pressure", "float64", profile.pressure_Pa),
            ("pressure_sigma", "float64", profile.pressure_sigma_Pa),
            ("valid", "float64", np.asarray(profile.point_valid, dtype=np.float64)),
        ],
    )


def pose(target_source: Pose) -> Message:
    """``geometry_msgs/Pose``.

    Parameters
    ----------
    target_source
        Rigid transformation ``T_target_source`` [m].
    """
    quaternion = target_source.quaternion_xyzw
    return {
        "position": _vector(target_source.translation_m),
        "orientation": {axis: float(value) for axis, value in zip("xyzw", quaternion, strict=True)},
    }


def camera_info(t_s: float, camera: Camera, frame: str) -> Message:
    """``sensor_msgs/CameraInfo``; it has no field for the row delay.

    Parameters
    ----------
    t_s
        Time of the image, seconds since the epoch.
    camera
        Camera model.
    frame
        Name of the camera's coordinate frame.
    """
    distortion = camera.distortion if camera.distortion.size else np.zeros(5)
    if distortion.size == 4:
        distortion = np.append(distortion, 0.0)
    projection = np.hstack([camera.matrix, np.zeros((3, 1))])
    return {
        "header": header(t_s, frame),
        "height": camera.height,
        "width": camera.width,
        "distortion_model": "rational_polynomial" if distortion.size == 8 else "plumb_bob",
        "d": [float(value) for value in distortion],
        "k": [float(value) for value in camera.matrix.ravel()],
        "r": [float(value) for value in np.eye(3).ravel()],
        "p": [float(value) for value in projection.ravel()],
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }


def image(t_s: float, pixels: UInt8[np.ndarray, "rows columns *colour"], frame: str) -> Message:
    """``sensor_msgs/Image``, ``mono8`` or ``bgr8``.

    Parameters
    ----------
    t_s
        Time of the image, seconds since the epoch.
    pixels
        Grey or BGR image, shape (rows, columns[, 3]).
    frame
        Name of the camera's coordinate frame.
    """
    return {
        "header": header(t_s, frame),
        "height": pixels.shape[0],
        "width": pixels.shape[1],
        "encoding": "mono8" if pixels.ndim == 2 else "bgr8",
        "is_bigendian": 0,
        "step": pixels.shape[1] * (1 if pixels.ndim == 2 else 3),
        "data": np.ascontiguousarray(pixels).tobytes(),
    }


def compressed_image(
    t_s: float, pixels: UInt8[np.ndarray, "rows columns *colour"], frame: str, quality: int | None
) -> Message:
    """``sensor_msgs/CompressedImage``: JPEG with quality 1..100, or lossless PNG for ``None``.

    Parameters
    ----------
    t_s, pixels, frame
        As in :func:`image`.
    quality
        JPEG quality; ``None`` for PNG.
    """

    kind = "png" if quality is None else "jpeg"
    data = encode_image(pixels, kind.replace("jpeg", "jpg"), quality=quality, where="frame")
    base = "mono8" if pixels.ndim == 2 else "bgr8"
    return {"header": header(t_s, frame), "format": f"{base}; {kind} compressed {base}", "data": data}
