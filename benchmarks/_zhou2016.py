"""Reader of the CMU pushes (Zhou 2016): an aluminium triangle on known supports, seen by motion capture."""

from __future__ import annotations

import gzip
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

__all__ = ["RealPush", "read_pushes", "support_points"]

#: Outline of the triangle in its motion-capture frame (m), whose corner is the right angle.
TRIANGLE_M = np.array([[0.0, 0.0], [0.15, 0.0], [0.0, 0.15]])


@dataclass(frozen=True, slots=True, eq=False)
class RealPush:
    """One push of about 16 mm; poses are those of the outline's frame."""

    before_m: Float[np.ndarray, "3"]  #: x, y, yaw
    after_m: Float[np.ndarray, "3"]
    tip_m: Float[np.ndarray, "k 2"]  #: of the pusher
    force_N: Float[np.ndarray, "j 2"]  #: of the sensor, its own axes and offset


def read_pushes(path: Path) -> tuple[RealPush, ...]:
    """All pushes of one log."""
    with gzip.open(path, "rt") as file:
        words = file.read().split()
    at = 1
    pushes = []
    for _ in range(int(words[0])):
        poses = np.array(words[at : at + 14], dtype=float).reshape(2, 7)
        at += 14
        count = int(words[at])
        force = np.array(words[at + 1 : at + 1 + 3 * count], dtype=float).reshape(count, 3)
        at += 1 + 3 * count
        count = int(words[at])
        tip = np.array(words[at + 1 : at + 1 + 8 * count], dtype=float).reshape(count, 8)
        at += 1 + 8 * count
        pushes.append(RealPush(_plane(poses[0]), _plane(poses[1]), 1e-3 * tip[:, 1:3], force[:, 1:3]))
    return tuple(pushes)


def support_points(name: str) -> Float[np.ndarray, "n 2"] | None:
    """Support points (m) from the file's name, x of all and then y of all in mm; ``None`` for a flat bottom."""
    numbers = []
    for word in name.removeprefix("wood_").split("_"):
        if not word.isdigit():
            break
        numbers.append(1e-3 * float(word))
    if len(numbers) < 6:
        return None
    half = len(numbers) // 2
    return np.column_stack([numbers[:half], numbers[half:]])


def _plane(pose: Float[np.ndarray, "7"]) -> Float[np.ndarray, "3"]:
    """x, y [m], yaw of a pose in mm with a quaternion (w, x, y, z)."""
    w, x, y, z = pose[3:]
    return np.array(
        [1e-3 * pose[0], 1e-3 * pose[1], math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))]
    )
