"""The surface of an object in contact with the foam: its pose, and its points in the image (Alt 2016, Sec. 3.5)."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from ...core import Contact, InputError, Pose, Primitive, PrimitiveKind

#: Width of a contact at which its line has the same weight as the assumption that the face is perpendicular to the push [m].
NARROW_M = 0.04


def contact_face(contact: Contact, primitive: Primitive | None = None) -> Pose:
    """Plane of the object's surface: ``pose_foam_face`` with x along the contact, y up, z towards the robot.

    From the fitted primitive, or without one from a line through the points with the largest compression.
    A round object is represented by its tangent, a corner by its tip.

    Parameters
    ----------
    contact
        Region of a force profile.
    primitive
        Shape fitted to it, frame F.
    """
    point, along = _contact_line(contact, primitive)
    along = along / np.linalg.norm(along)
    if along[1] > 0:
        along = -along  # x along the contact to the right: then its normal points to the robot
    rotation = np.array([[along[0], 0.0, along[1]], [along[1], 0.0, -along[0]], [0.0, 1.0, 0.0]])
    return Pose(rotation, np.array([point[0], point[1], 0.0]))


def _contact_line(contact: Contact, primitive: Primitive | None) -> tuple[np.ndarray, np.ndarray]:
    across = np.array([0.0, 1.0])
    if primitive is not None:
        p = primitive.parameters
        if primitive.kind == PrimitiveKind.CIRCLE:
            return p[:2] - np.array([p[2], 0.0]), across
        if primitive.kind == PrimitiveKind.SEGMENT:
            return 0.5 * (p[:2] + p[2:]), p[2:] - p[:2]
        if primitive.kind == PrimitiveKind.LINE:
            return p[:2], np.array([math.cos(p[2]), math.sin(p[2])])
        return p[:2], across
    pressed = contact.delta_m > 0.6 * float(np.max(contact.delta_m, initial=0.0))
    points = contact.points_foam_m[pressed]
    if len(points) == 0:
        raise InputError("contact_face", "found a contact without points, expected at least one")
    middle = points.mean(axis=0)
    span = float(np.ptp(points[:, 1]))
    if span < 0.01:
        return middle, across
    slope = float(np.polyfit(points[:, 1] - middle[1], points[:, 0] - middle[0], 1)[0])
    # A narrow contact shows the foam's flanks and the object's edge, not its face: the perpendicular face is then likelier.
    trust = span**2 / (span**2 + NARROW_M**2)
    return middle, np.array([trust * slope, 1.0])


def face_curvature(primitive: Primitive | None) -> float:
    """Curvature of the face's section with the floor [1/m]; 0 unless the contact is round.

    Parameters
    ----------
    primitive
        Shape fitted to the contact, frame F.
    """
    if primitive is None or primitive.kind is not PrimitiveKind.CIRCLE:
        return 0.0
    return 1.0 / max(float(primitive.parameters[2]), 0.01)


def cast_to_face(
    eye_m: Float[np.ndarray, "3"],
    rays: Float[np.ndarray, "n 3"],
    motion: Pose,
    face: Pose,
    curvature_per_m: float = 0.0,
) -> Float[np.ndarray, "n 3"]:
    """Points of a body in its initial pose, where rays hit its surface after a motion; NaN if they miss.

    Parameters
    ----------
    eye_m, rays
        The camera's centre and directions, frame F.
    motion
        Motion of the body: rotation about the face's origin, then shift.
    face
        Initial ``pose_foam_face``: x along the contact, y up, z towards the robot.
    curvature_per_m
        Curvature of an upright cylinder that touches the face's plane at its origin; 0 = plane.
    """
    pivot = face.translation_m
    frame = motion.rotation @ face.rotation
    eye = (eye_m - pivot - motion.translation_m) @ frame
    ray = rays @ frame
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = -eye[2] / ray[:, 2]
        for _ in range(6 if curvature_per_m else 0):
            x = eye[0] + depth * ray[:, 0]
            # Sagitta of the circle; beyond the quarter circle it is not visible.
            sag = curvature_per_m * x**2 / (1.0 + np.sqrt(1.0 - (curvature_per_m * x) ** 2))
            depth = (-sag - eye[2]) / ray[:, 2]
    points = (eye + depth[:, None] * ray) @ face.rotation.T + pivot
    points[~((depth > 0) & (depth < 2.0))] = np.nan
    return np.asarray(points)
