"""Correction of odometry drift by walls: walls are straight, and a wall that is touched again has not moved.

Wheels and gyroscope drift by a degree and some centimetres on the way around a room (Alt 2016, Sec. 3.6.3
adds other cues for larger rooms). A wide contact with a wall measures its direction much more accurately. Every such
contact is compared with earlier directions, and with those perpendicular to them: a small difference is
the drift of the heading. A line within centimetres of an earlier one is the same wall: the
difference is the drift perpendicular to it. The scale of the odometry is not observable here.

Between two walls the drift of the heading is assumed uniform: :func:`correct_by_walls` distributes it over the contacts
in between, once the second wall shows its total.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ....core import PrimitiveKind, rotation_2d
from ....navigation.mapping.haptic_map import HapticContact

#: Minimum width of a contact that measures a direction [m].
WIDE_M = 0.15
#: Maximum distance from an earlier wall, and along it from an earlier contact, for a match of the same wall [m].
SAME_M, REACH_M = 0.08, 1.5

Pose2 = tuple[float, float, float]


def correct_by_walls(
    contacts: Sequence[HapticContact], times_s: Sequence[float], square_rad: float
) -> list[HapticContact]:
    """Positions of the contacts of one tour, corrected by all wall directions.

    Parameters
    ----------
    contacts, times_s
        Contacts and their times [s], in chronological order.
    square_rad
        Directions that differ by less, modulo a right angle, are matched [rad].
    """
    forth, known_s, drift_rad = WallDriftCorrection(square_rad), [], []
    for contact, t_s in zip(contacts, times_s, strict=True):
        forth.corrected(contact)
        if _face_rad(contact) is not None:
            known_s.append(t_s)
            drift_rad.append(forth.drift_rad)
    between = np.interp(times_s, known_s, drift_rad) if known_s else np.zeros(len(contacts))
    walls = WallDriftCorrection(square_rad)
    return [
        walls.corrected(contact, drift_rad=float(drift))
        for contact, drift in zip(contacts, between, strict=True)
    ]


class WallDriftCorrection:
    """Corrects the pose of each contact by the previous ones.

    Parameters
    ----------
    square_rad
        Directions that differ by less, modulo a right angle, are matched [rad].
    """

    def __init__(self, square_rad: float) -> None:
        self.square_rad = square_rad
        self._directions: list[float] = []
        self._walls: list[tuple[Float[np.ndarray, "2"], float, float]] = []  #: normal, distance, place along
        self.drift_rad = 0.0  #: of the heading, at the last wall
        self._last: tuple[Pose2, Pose2] | None = None  #: odometry and corrected pose of the previous contact

    def corrected(self, contact: HapticContact, *, drift_rad: float | None = None) -> HapticContact:
        """The contact at its corrected pose, from the walls or from a given heading drift.

        Parameters
        ----------
        contact
            Contact at its odometry pose.
        drift_rad
            Drift of the heading there, if known better than from the previous walls [rad].
        """
        odometry = contact.T_map_foam
        before_rad = self.drift_rad
        face = _face_rad(contact)
        if drift_rad is not None:
            self.drift_rad = drift_rad
        elif face is not None:
            self._compare_direction(odometry[2] + face)
        pose = self._moved(odometry, 0.5 * (before_rad + self.drift_rad))
        if face is not None:
            pose = self._against_walls(pose, contact, pose[2] + face)
        self._last = odometry, pose
        return replace(contact, T_map_foam=pose)

    def _compare_direction(self, direction_rad: float) -> None:
        """Update the heading drift from the difference to a known direction; store a new direction."""
        now = direction_rad - self.drift_rad
        for known in self._directions:
            off = math.remainder(now - known, 0.5 * math.pi)
            if abs(off) < self.square_rad:
                self.drift_rad += off
                return
        self._directions.append(now)

    def _moved(self, odometry: Pose2, drift_rad: float) -> Pose2:
        """Propagate the last corrected pose by the odometry, rotated by the heading drift."""
        heading = odometry[2] - self.drift_rad
        if self._last is None:
            return odometry[0], odometry[1], heading
        (x0, y0, _), (x1, y1, _) = self._last
        c, s = math.cos(drift_rad), math.sin(drift_rad)
        dx, dy = odometry[0] - x0, odometry[1] - y0
        return x1 + c * dx + s * dy, y1 - s * dx + c * dy, heading

    def _against_walls(self, pose: Pose2, contact: HapticContact, direction_rad: float) -> Pose2:
        """Shift the pose perpendicular to a wall touched before; store a new wall."""
        place = np.array(pose[:2])
        turn = rotation_2d(pose[2]).T
        normal = np.array([math.sin(direction_rad), -math.cos(direction_rad)])
        normal = normal if normal @ turn[0] > 0 else -normal  # away from the platform
        along = np.array([-normal[1], normal[0]])
        distance = float((contact.primitive.parameters[:2] @ turn + place) @ normal)
        at = float((contact.points_foam_m.mean(axis=0) @ turn + place) @ along)
        for wall, known, near in self._walls:
            parallel = float(normal @ wall) > math.cos(self.square_rad)
            if parallel and abs(known - distance) < SAME_M and abs(near - at) < REACH_M:
                # A wall that is followed: the next contact is near this one.
                self._walls.append((wall, known, at))
                shift = (known - distance) * normal
                return pose[0] + float(shift[0]), pose[1] + float(shift[1]), pose[2]
        self._walls.append((normal, distance, at))
        return pose


def _face_rad(contact: HapticContact) -> float | None:
    """Direction of a wide straight face in frame F; ``None`` for anything else."""
    kind = contact.primitive.kind
    if kind is not PrimitiveKind.LINE or contact.movable or contact.diameter_m < WIDE_M:
        return None
    return float(contact.primitive.parameters[2])
