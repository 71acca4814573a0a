"""Markers for RViz: arrows for forces, points, lines and texts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.measurement import ForceProfile
from ..io.ros.ros_messages import header

_ARROW, LINES, POINTS, _TEXT = 0, 5, 8, 9
_ADD, _DELETE_ALL = 0, 3
_COLOUR = (0.85, 0.37, 0.01, 1.0)


def _marker(t_s: float, frame: str, name: str, number: int, action: int) -> dict[str, Any]:
    return {
        "header": header(t_s, frame),
        "ns": name,
        "id": number,
        "type": _ARROW,
        "action": action,
        "pose": {
            "position": {"x": 0.0, "y": 0.0, "z": 0.0},
            "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        },
        "scale": {"x": 0.0, "y": 0.0, "z": 0.0},
        "color": dict(zip("rgba", _COLOUR, strict=True)),
        "lifetime": {"sec": 0, "nanosec": 0},
        "frame_locked": False,
        "points": [],
        "colors": [],
        "texture_resource": "",
        "texture": {"header": header(0.0, ""), "format": "", "data": b""},
        "uv_coordinates": [],
        "text": "",
        "mesh_resource": "",
        "mesh_file": {"filename": "", "data": b""},
        "mesh_use_embedded_materials": False,
    }


def arrow(
    t_s: float,
    frame: str,
    name: str,
    number: int,
    points_m: Float[np.ndarray, "2 3"] | Sequence[Sequence[float]],
    *,
    width_m: float = 0.004,
) -> dict[str, Any]:
    """``visualization_msgs/Marker``: an arrow between two points in ``frame``.

    Parameters
    ----------
    t_s
        Timestamp [s].
    frame
        Coordinate frame of the points.
    name
        Namespace of the marker.
    number
        Marker id in the namespace.
    points_m
        Tail and head [m].
    width_m
        Diameter of the shaft [m].
    """
    marker = _marker(t_s, frame, name, number, _ADD)
    marker["scale"] = {"x": width_m, "y": 2.0 * width_m, "z": 0.0}
    marker["points"] = [dict(zip("xyz", map(float, point), strict=True)) for point in points_m]
    return marker


def points_marker(
    t_s: float, frame: str, name: str, kind: int, points_m: Sequence[Sequence[float]], *, size_m: float
) -> dict[str, Any]:
    """``visualization_msgs/Marker``: points, or lines between consecutive pairs of points.

    Parameters
    ----------
    t_s, frame, name
        As in :func:`arrow`.
    kind
        :data:`POINTS` or :data:`LINES`.
    points_m
        x, y, z of each point [m].
    size_m
        Width of a point or line [m].
    """
    marker = arrow(t_s, frame, name, 0, points_m)
    marker["type"], marker["scale"] = kind, {"x": size_m, "y": size_m, "z": 0.0}
    return marker


def clear_marker(t_s: float, frame: str, name: str) -> dict[str, Any]:
    """``visualization_msgs/Marker`` that removes all earlier ones of its topic.

    Parameters
    ----------
    t_s, frame, name
        As in :func:`arrow`.
    """
    return _marker(t_s, frame, name, 0, _DELETE_ALL)


def text_marker(
    t_s: float, frame: str, name: str, number: int, place_m: Float[np.ndarray, "3"], text: str
) -> dict[str, Any]:
    """``visualization_msgs/Marker``: a text, 3 cm high, that faces the viewer.

    Parameters
    ----------
    t_s, frame, name, number
        As in :func:`arrow`.
    place_m
        Centre of the text [m].
    text
        Text to show.
    """
    marker = _marker(t_s, frame, name, number, _ADD)
    marker["type"], marker["text"], marker["scale"]["z"] = _TEXT, text, 0.03
    marker["pose"]["position"] = dict(zip("xyz", map(float, place_m), strict=True))
    return marker


def contact_markers(
    profile: ForceProfile, frame: str, name: str = "foam", *, scale_m_per_N: float = 0.02
) -> dict[str, Any]:
    """``visualization_msgs/MarkerArray``: an arrow for the force of each valid contact.

    It ends at the contact on the foam and points along -x of frame F, like the force on the sensor.

    Parameters
    ----------
    profile
        Measurement of one camera frame.
    frame
        ROS name of frame F.
    name
        Namespace of the markers.
    scale_m_per_N
        Length of an arrow per force [m/N].
    """
    markers = [clear_marker(profile.t_s, frame, name)]
    for number, contact in enumerate(profile.contacts):
        if contact.valid and len(contact.points_foam_m):
            x, y = np.asarray(contact.points_foam_m)[np.argmax(contact.delta_m)]
            start = [x + scale_m_per_N * contact.force_N, y, 0.0]
            markers.append(arrow(profile.t_s, frame, name, number, [start, [x, y, 0.0]]))
    return {"markers": markers}
