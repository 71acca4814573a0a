"""Odometry that is held by the walls it has touched: they are straight, and touched again they are where they were.

Wheels and gyroscope drift by a degree and some centimetres on the way around a room (Alt 2016, Sec. 3.6.3
adds other cues for larger rooms). A wide contact with a wall tells its direction much better. Every such
contact is compared with the directions that were met before, and those square to them: a small difference is
the drift of the heading. A line that lies within centimetres of an earlier one is the same wall: the
difference is the drift across it. Nothing here sees a wrong scale of the odometry.

Between two walls the heading drifts evenly, as far as anybody knows: :func:`held_by_walls` gives what is touched
there its part, once the second wall shows how much it was.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ....core.geometry import rotation_2d
from ....core.objects import PrimitiveKind
from ....navigation.mapping.haptic_map import HapticContact

__all__ = ["StraightWalls", "held_by_walls"]

#: Contacts at least so wide tell a direction [m].
WIDE_M = 0.15
#: Within this an earlier wall is touched again, if that far along it nothing else was found [m].
SAME_M, REACH_M = 0.08, 1.5

Pose2 = tuple[float, float, float]


def held_by_walls(
    contacts: Sequence[HapticContact], times_s: Sequence[float], square_rad: float
) -> list[HapticContact]:
    """The contacts of one tour where they are by what all of them say of the walls.

    Parameters
    ----------
    contacts, times_s
        In the order in which they were made.
    square_rad
        Directions that differ by less, up to a right angle, are the same.
    """
    forth, known_s, drift_rad = StraightWalls(square_rad), [], []
    for contact, t_s in zip(contacts, times_s, strict=True):
        forth.corrected(contact)
        if _face_rad(contact) is not None:
            known_s.append(t_s)
            drift_rad.append(forth.drift_rad)
    between = np.interp(times_s, known_s, drift_rad) if known_s else np.zeros(len(contacts))
    walls = StraightWalls(square_rad)
    return [
        walls.corrected(contact, drift_rad=float(drift))
        for contact, drift in zip(contacts, between, strict=True)
    ]


class StraightWalls:
    """Corrects the pose of every contact by those before.

    Parameters
    ----------
    square_rad
        Directions that differ by less, up to a right angle, are the same.
    """

    def __init__(self, square_rad: float) -> None:
        self.square_rad = square_rad
        self._directions: list[float] = []
        self._walls: list[tuple[Float[np.ndarray, "2"], float, float]] = []  #: normal, distance, place along
        self.drift_rad = 0.0  #: of the heading, by the last wall
        self._last: tuple[Pose2, Pose2] | None = None  #: by odometry and corrected, of the contact before

    def corrected(self, contact: HapticContact, *, drift_rad: float | None = None) -> HapticContact:
        """The same contact where it is by what is known of the walls, or with a drift that is known better.

        Parameters
        ----------
        contact
            Where odometry places it.
        drift_rad
            Drift of the heading there, when it is known better than by the walls before [rad].
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
        """Take the difference to a known direction as the heading's drift; a new direction is kept."""
        now = direction_rad - self.drift_rad
        for known in self._directions:
            off = math.remainder(now - known, 0.5 * math.pi)
            if abs(off) < self.square_rad:
                self.drift_rad += off
                return
        self._directions.append(now)

    def _moved(self, odometry: Pose2, drift_rad: float) -> Pose2:
        """On from the last corrected pose by what odometry says, turned by the drift on the way."""
        heading = odometry[2] - self.drift_rad
        if self._last is None:
            return odometry[0], odometry[1], heading
        (x0, y0, _), (x1, y1, _) = self._last
        c, s = math.cos(drift_rad), math.sin(drift_rad)
        dx, dy = odometry[0] - x0, odometry[1] - y0
        return x1 + c * dx + s * dy, y1 - s * dx + c * dy, heading

    def _against_walls(self, pose: Pose2, contact: HapticContact, direction_rad: float) -> Pose2:
        """Shift across a wall that was touched before; a new one is kept."""
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
                # Followed piece by piece: the next one is near this one.
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
