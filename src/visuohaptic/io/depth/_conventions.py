"""Whether the poses of depth images are in the expected convention: only then do two views show the same surface."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Float32

from ...core import Camera, InputError, Pose

Away = Float[np.ndarray, "n"]
View = tuple[Float32[np.ndarray, "rows columns"], Pose]

#: Depth cameras measure to about this fraction of the depth, or better.
_ACCURATE = 0.02
#: A pair of views decides for the convention whose misfit is smaller by this factor.
_CLEARLY = 3.0
#: Pairs that have to decide for another convention, without one against it.
_PAIRS = 3
#: Intervals of the compared views, in frames, and groups of views along the sequence.
_INTERVALS, _GROUPS = (0, 1, 3, 9), 3
#: Number of points of a view along each side: the median of their squares is known to 1.25 / 40 of the scatter.
_POINTS = 40
#: Axes of other conventions, in those of a camera (x right, y down, z forward).
_OPENGL = Pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
_OPTICAL = Pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))


def _w_first(pose: Pose) -> Pose:
    """The pose whose quaternion was read as x y z w, but is w x y z."""
    return Pose.from_quaternion(np.roll(pose.quaternion_xyzw, -1), pose.translation_m)


def _same(pose: Pose) -> Pose:
    return pose


def _as_told(away: Away) -> float:
    return 1.0


#: How else poses or depths may be meant, with the remedy: pose as meant, and factor of the depth by length of the ray to z = 1.
_OTHERS: tuple[tuple[str, str, Callable[[Pose], Pose], Callable[[Away], Away | float]], ...] = (
    ("the poses are world to camera", "invert the poses", Pose.inverse, _as_told),
    ("the quaternions are w x y z", "write them as x y z w", _w_first, _as_told),
    (
        "the poses are world to camera with quaternions w x y z",
        "invert the poses and write quaternions as x y z w",
        lambda pose: _w_first(pose).inverse(),
        _as_told,
    ),
    (
        "the camera's axes are those of OpenGL",
        "turn the poses so that y points down and z forward",
        lambda pose: pose @ _OPENGL,
        _as_told,
    ),
    (
        "the camera's axes are those of a ROS body",
        "use the optical frame: x right, y down, z forward",
        lambda pose: pose @ _OPTICAL,
        _as_told,
    ),
    (
        "the depths are distances from the camera",
        "convert them to depths along its axis",
        _same,
        lambda away: 1.0 / away,
    ),
    ("one unit of depth is a fifth of that", "check depth_scale_m (TUM: 0.0002)", _same, lambda _: 0.2),
    ("one unit of depth is a tenth of that", "check depth_scale_m", _same, lambda _: 0.1),
)


def compared(count: int) -> list[list[int]]:
    """Groups of views to be compared with the first one of each.

    Parameters
    ----------
    count
        Number of views.
    """
    if count <= 2 * _INTERVALS[-1]:  # every view with the next one
        return [[one, one + 1] for one in range(count - 1)]
    starts = np.linspace(0, count - 1 - _INTERVALS[-1], _GROUPS).astype(int)
    return [[int(start) + step for step in _INTERVALS] for start in np.unique(starts)]


def check_conventions(folder: Path, camera: Camera, groups: Iterable[Sequence[View]]) -> None:
    """Reject views that show one surface only if their poses or depths are meant otherwise than expected.

    Every view is projected into the first one of its group. A pair of views decides for another convention if it agrees to
    the accuracy of depth cameras under it, and is three times as far apart as read, or against it if the opposite holds. Without
    motion, or with poses that are wrong in all conventions, no pair decides, and nothing is rejected.

    Parameters
    ----------
    folder
        The sequence, for the message.
    camera
        Camera of all views.
    groups
        Depth [m] and camera-to-world pose of views that may overlap; the later ones are not asked for if the first ones
        agree best as read.

    Raises
    ------
    InputError
        Three pairs or more agree under the same other convention, and none decides against it.
    """
    against: Bool[np.ndarray, "conventions"] = np.zeros(len(_OTHERS), dtype=bool)
    read, others = np.zeros(0), np.zeros((len(_OTHERS), 0))
    for group in groups:
        pairs = [(group[0], other) for other in group[1:]]
        read = np.append(read, [_misfit(camera, *pair, _same, _as_told) for pair in pairs])
        new = [[_misfit(camera, *pair, meant, factor) for pair in pairs] for *_, meant, factor in _OTHERS]
        others = np.column_stack([others, np.array(new).reshape(len(_OTHERS), -1)])
        against = np.any((read < _ACCURATE) & (_CLEARLY * read < others), axis=1)
        if np.all(against | ((read < _ACCURATE) & (read < others)).all(axis=1)) and len(read) >= _PAIRS:
            return  # as read they agree, and better than in any other way
    for (meaning, remedy, *_), other, refuted in zip(_OTHERS, others, against, strict=True):
        in_favour = (other < _ACCURATE) & (_CLEARLY * other < read)
        if in_favour.sum() >= _PAIRS and not refuted:
            best, found = (float(np.median(values[in_favour])) for values in (other, read))
            apart = f"differ by {100 * found:.2g} %" if np.isfinite(found) else "do not overlap"
            raise InputError(
                folder,
                f"its views agree to {100 * best:.2g} % of their depth if {meaning}, but {apart} as read",
                remedy=remedy,
            )


def _misfit(
    camera: Camera,
    one: View,
    other: View,
    meant: Callable[[Pose], Pose],
    factor: Callable[[Away], Away | float],
) -> float:
    """Median distance of the surfaces of two views, as a fraction of the depth; infinite without overlap."""
    rows = np.linspace(0, camera.height - 1, _POINTS).astype(int)
    columns = np.linspace(0, camera.width - 1, _POINTS).astype(int)
    x, y = (values.ravel() for values in np.meshgrid(columns, rows))
    depth_m = other[0][y, x].astype(np.float64)
    known = np.isfinite(depth_m)
    rays = camera.rays(np.column_stack([x, y])[known].astype(np.float64))
    z = factor(np.linalg.norm(rays, axis=1)) * depth_m[known]
    points = (meant(one[1]).inverse() @ meant(other[1])).apply(rays * z[:, None])
    pixels = camera.project(points)
    seen = np.isfinite(pixels).all(axis=1)
    place = np.rint(np.where(seen[:, None], pixels, -1.0)).clip(-1, 1 << 20).astype(int)
    seen &= ((place >= 0) & (place < [camera.width, camera.height])).all(axis=1)
    away = np.linalg.norm(points[seen], axis=1) / points[seen, 2]
    found = factor(away) * one[0][place[seen, 1], place[seen, 0]].astype(np.float64)
    apart = np.full(len(points), np.inf)
    apart[seen] = np.abs(found - points[seen, 2]) / points[seen, 2]
    apart = apart[~np.isnan(apart)]
    return float(np.median(apart)) if len(apart) >= _POINTS else np.inf
