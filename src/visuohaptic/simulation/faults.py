"""Fault injection: wrappers of the robot protocols, and wrong maps; reproducible by their generator.

The data that a task gets through these wrappers may be wrong; the state of the simulated
world is not affected. Slip in the hand and falling objects are switches of
the worlds themselves (:class:`~visuohaptic.simulation.tabletop.kitchen.KitchenTable`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
from jaxtyping import Int8

from ..core import POSITIVE, Camera, Closing, Frame, FrameSource, InputError, Ranged, at_least, within


class FaultKind(StrEnum):
    """Kinds of faults."""

    DROPPED_FRAMES = "dropped_frames"
    LATE_FRAMES = "late_frames"
    DUPLICATE_FRAMES = "duplicate_frames"
    CAMERA_BUMP = "camera_bump"
    LIGHTING = "lighting"
    SLIP = "slip"
    OBJECT_FALLS = "object_falls"
    WRONG_MAP = "wrong_map"
    LOST_POSE = "lost_pose"


@dataclass(frozen=True, slots=True)
class FrameFaults(Ranged):
    """Faults of camera frames; all off by default."""

    drop: float = field(default=0.0, metadata=within(0, 1))  #: fraction that is lost
    duplicate: float = field(default=0.0, metadata=within(0, 1))  #: fraction that is duplicated
    late: float = field(default=0.0, metadata=within(0, 1))  #: fraction that arrives after later frames
    late_frames: int = field(default=3, metadata=at_least(1))  #: by how many frames
    bump_at_s: float = math.inf  #: time of a bump that displaces the camera, after the first frame's time
    bump_px: tuple[float, float] = (12.0, -7.0)
    bump_rad: float = 0.02
    light_at_s: float = math.inf  #: time of a change of light
    light_s: float = field(default=0.5, metadata=POSITIVE)  #: duration of that change
    light_gain: float = 0.45
    light_offset: float = 5.0
    end_at_s: float = math.inf  #: time at which the cable is disconnected


def frame_faults(kind: FaultKind, at_s: float = 2.0) -> FrameFaults:
    """Camera faults of one kind; none for kinds that do not concern the camera.

    Parameters
    ----------
    kind
        Kind of fault.
    at_s
        Time of the fault [s].
    """
    return {
        FaultKind.DROPPED_FRAMES: FrameFaults(drop=0.2),
        FaultKind.LATE_FRAMES: FrameFaults(late=0.2),
        FaultKind.DUPLICATE_FRAMES: FrameFaults(duplicate=0.2),
        FaultKind.CAMERA_BUMP: FrameFaults(bump_at_s=at_s),
        FaultKind.LIGHTING: FrameFaults(light_at_s=at_s),
    }.get(kind, FrameFaults())


class FaultyFrames(Closing):
    """A ``robots.FrameSource`` that drops, repeats, delays and corrupts the frames of another one.

    Parameters
    ----------
    source
        Camera without faults.
    faults
        Faults and their times.
    rng
        Source of randomness.
    """

    def __init__(self, source: FrameSource, faults: FrameFaults, rng: np.random.Generator) -> None:
        self.source, self.faults, self._rng = source, faults, rng
        self._start_s = math.nan

    @property
    def camera(self) -> Camera | None:
        """The model assumed by all users; a bump does not change it."""
        return self.source.camera

    @property
    def frame_count(self) -> int | None:
        """Number of frames of the source; the number that arrives is unknown."""
        return self.source.frame_count

    def __iter__(self) -> Iterator[Frame]:
        held: list[tuple[int, Frame]] = []  #: late frames, and number of frames to deliver before each
        for frame in self.source:
            if math.isnan(self._start_s):
                self._start_s = frame.t_s
            if frame.t_s - self._start_s >= self.faults.end_at_s:
                return
            # One random number per fault and frame: enabling a fault does not change the others.
            dropped, twice, late = self._rng.random(3) < (
                self.faults.drop,
                self.faults.duplicate,
                self.faults.late,
            )
            held = [(left - 1, old) for left, old in held]
            yield from (old for left, old in held if left <= 0)
            held = [(left, old) for left, old in held if left > 0]
            if dropped:
                continue
            spoilt = self._spoilt(frame)
            if late:
                held.append((self.faults.late_frames + 1, spoilt))
                continue
            yield spoilt
            if twice:
                yield spoilt
        yield from (old for _, old in held)

    def close(self) -> None:
        """Release the source."""
        self.source.close()

    def _spoilt(self, frame: Frame) -> Frame:
        f, age = self.faults, frame.t_s - self._start_s
        image = frame.image
        if age >= f.bump_at_s:
            import cv2

            rows, columns = image.shape[:2]
            matrix = cv2.getRotationMatrix2D((0.5 * columns, 0.5 * rows), math.degrees(f.bump_rad), 1.0)
            matrix[:, 2] += f.bump_px
            image = cv2.warpAffine(image, matrix, (columns, rows), borderMode=cv2.BORDER_REPLICATE)
        if age >= f.light_at_s:
            fraction = min(1.0, (age - f.light_at_s) / f.light_s)
            gain, offset = 1.0 + fraction * (f.light_gain - 1.0), fraction * f.light_offset
            image = np.clip(np.rint(gain * image.astype(np.float32) + offset), 0, 255).astype(image.dtype)
        return frame if image is frame.image else replace(frame, image=image)


def wrong_map(
    cells: Int8[np.ndarray, "rows columns"],
    rng: np.random.Generator,
    *,
    shift_cells: int = 4,
    blocks: int = 3,
) -> Int8[np.ndarray, "rows columns"]:
    """A map that is wrong: shifted, with obstacles that do not exist and without obstacles that do.

    Parameters
    ----------
    cells
        -1 unknown, 0 free, 100 occupied.
    rng
        Source of randomness.
    shift_cells
        Shift in a random direction; new cells at the border are unknown.
    blocks
        Number of squares of 8 cells that are turned from free to occupied, and vice versa.
    """
    cells = np.asarray(cells)
    if cells.ndim != 2 or cells.size == 0:
        raise InputError("wrong_map", f"found shape {cells.shape}, expected rows x columns")
    angle = rng.uniform(0.0, 2.0 * math.pi)
    down, right = round(shift_cells * math.sin(angle)), round(shift_cells * math.cos(angle))
    wrong = np.full_like(cells, -1)
    rows, columns = cells.shape
    y, x = (
        np.arange(max(0, down), min(rows, rows + down)),
        np.arange(max(0, right), min(columns, columns + right)),
    )
    wrong[np.ix_(y, x)] = cells[np.ix_(y - down, x - right)]
    for value, replaced in ((100, 0), (0, 100)):
        places = np.argwhere(wrong == replaced)
        for row, column in places[rng.integers(0, len(places), blocks)] if len(places) else ():
            part = wrong[row : row + 8, column : column + 8]
            part[part == replaced] = value
    return wrong
