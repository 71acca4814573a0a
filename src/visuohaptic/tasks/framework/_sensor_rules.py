"""Rules of the contract for what a robot senses: localizer, depth camera, finger sensor."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np

from ...core.camera.frame import Frame
from ...core.geometry import wrap_angle
from ...core.robots import DepthSource, FingerTouch, FrameSource, Localizer, MapPose, MobileBase

__all__ = [
    "FRESH_s",
    "Feeling",
    "camera_rules",
    "depth_rules",
    "fresh_rule",
    "localizer_rules",
    "touch_rules",
]

#: A state is measured anew within this time: motion is stopped where it is not [s].
FRESH_s = 0.2
#: Depths and forces beyond these are in another unit: a room [m], a finger that touches nothing [N], [m].
MAX_DEPTH_m, MAX_IDLE_N, MAX_SURFACE_m = 50.0, 2.0, 0.5
#: Images that are looked at.
IMAGES = 5


class Feeling(Protocol):
    """A finger's sensor: what it feels of a frame."""

    def __call__(self, frame: Frame) -> FingerTouch:
        """Of a frame.

        Parameters
        ----------
        frame
            Of the camera that looks at the finger.
        """


def fresh_rule(time_s: Callable[[], float], wait: Callable[[float], None]) -> tuple[str, str]:
    """Whether what is read is as new as stopping in time needs.

    Parameters
    ----------
    time_s
        Reads the time of the newest measurement [s].
    wait
        Lets seconds pass.
    """
    steps = []
    for _ in range(5):
        before = time_s()
        wait(FRESH_s)
        steps.append(time_s() - before)
    stale = [step for step in steps if not step > 0.0]
    problem = f"found {len(stale)} of {len(steps)} readings no newer than {FRESH_s:g} s before"
    return f"it is measured anew within {FRESH_s:g} s", problem if stale else ""


def camera_rules(camera: FrameSource) -> Iterator[tuple[str, str]]:
    """Types, times and sizes of frames.

    Parameters
    ----------
    camera
        Tried.
    """
    frames: list[Frame] = []
    for frame in camera:
        frames.append(frame)
        if len(frames) == IMAGES or not isinstance(frame, Frame):
            break
    yield "it has frames", "" if frames else "found none"
    kinds = {type(frame).__name__ for frame in frames if not isinstance(frame, Frame)}
    yield "they are of type Frame", f"found {kinds.pop()}" if kinds else ""
    times = np.diff([frame.t_s for frame in frames])
    yield (
        "their times ascend, in seconds",
        "" if ((times > 0) & (times < 10.0)).all() else f"found steps of {times.round(6).tolist()} s",
    )
    numbers = [frame.index for frame in frames]
    yield "their indices ascend", "" if (np.diff(numbers) > 0).all() else f"found {numbers}"
    sizes = {frame.image.shape for frame in frames}
    yield "they are of one size", "" if len(sizes) == 1 else f"found {sorted(sizes)}"
    model = camera.camera
    if model is not None:
        rows, columns = frames[0].image.shape[:2]
        size = (model.width, model.height)
        yield (
            "the camera's model is of that size",
            "" if size == (columns, rows) else f"found {size} for images of {columns} x {rows}",
        )


def localizer_rules(
    localizer: Localizer, base: MobileBase | None, wait: Callable[[float], None], motion: bool
) -> Iterator[tuple[str, str]]:
    """Type, units, time, and agreement with the base.

    Parameters
    ----------
    localizer
        Tried.
    base
        That drives it; without one, only readings are looked at.
    wait
        Lets seconds pass.
    motion
        Move it.
    """
    start = localizer.locate()
    yield "locate() is a MapPose", "" if isinstance(start, MapPose) else f"found {type(start).__name__}"
    numbers = (start.t_s, start.x_m, start.y_m, start.heading_rad)
    yield "its numbers are finite", "" if np.isfinite(numbers).all() else f"found {start}"
    yield fresh_rule(lambda: localizer.locate().t_s, wait)
    if base is None or not motion:
        return
    start, before = localizer.locate(), base.state()
    base.drive(0.05, 0.25)
    wait(2.0)
    base.stop()
    wait(1.0)
    end, after = localizer.locate(), base.state()
    way_m = math.hypot(end.x_m - start.x_m, end.y_m - start.y_m)
    driven_m = math.hypot(after.x_m - before.x_m, after.y_m - before.y_m)
    # Of 10 cm and half a radian: no other unit, axis or sense, whatever odometry and map differ by.
    near = abs(way_m - driven_m) < 0.05
    yield (
        "it moves with the base, in metres",
        "" if near else f"found {way_m:.4g} m, the base says {driven_m:.4g} m",
    )
    turns = [wrap_angle(b.heading_rad - a.heading_rad) for a, b in ((start, end), (before, after))]
    near = abs(turns[0] - turns[1]) < 0.2
    yield (
        "it turns with the base, in radians",
        "" if near else f"found {turns[0]:.4g} rad, the base says {turns[1]:.4g} rad",
    )
    course = wrap_angle(
        math.atan2(end.y_m - start.y_m, end.x_m - start.x_m) - 0.5 * (start.heading_rad + end.heading_rad)
    )
    yield (
        "it moves where its heading points",
        "" if abs(course) < 0.5 else f"found a way {course:.3g} rad beside its heading",
    )


def depth_rules(depth: DepthSource, wait: Callable[[float], None]) -> Iterator[tuple[str, str]]:
    """Shape, units, time.

    Parameters
    ----------
    depth
        Tried.
    wait
        Lets seconds pass.
    """
    images = []
    for _ in range(IMAGES):
        images.append(depth.read())
        wait(FRESH_s)
    size = (depth.camera.height, depth.camera.width)
    shapes = {np.shape(image.depth_m) for image in images}
    yield (
        "its images are of the camera's size",
        "" if shapes == {size} else f"found {sorted(shapes)}, expected {size}",
    )
    values = np.concatenate([np.ravel(np.asarray(image.depth_m, dtype=float)) for image in images])
    values = values[~np.isnan(values)]
    yield "it measures something", "" if len(values) else "found NaN alone"
    wrong = values[(values <= 0.0) | (values > MAX_DEPTH_m)]
    yield (
        "its depths are in metres, NaN where not measured",
        f"found {wrong[0]:.4g}, expected more than 0 and at most {MAX_DEPTH_m:g}" if len(wrong) else "",
    )
    steps = np.diff([image.t_s for image in images])
    yield (
        "their times ascend, in seconds",
        "" if ((steps > 0) & (steps < 10.0)).all() else f"found steps of {steps.round(6).tolist()} s",
    )


def touch_rules(feel: Feeling, camera: FrameSource | None) -> Iterator[tuple[str, str]]:
    """What a finger feels that touches nothing.

    Parameters
    ----------
    feel
        Tried.
    camera
        Looks at the finger.
    """
    yield "there is a camera that looks at it", "found no part 'camera'" if camera is None else ""
    assert camera is not None
    touches = []
    for frame in camera:
        touches.append(feel(frame))
        if len(touches) == IMAGES:
            break
    for name in ("valid", "force_N", "surface_m"):
        missing = [touch for touch in touches if not hasattr(touch, name)]
        yield f"what it feels has {name}", f"found {type(missing[0]).__name__} without" if missing else ""
    forces = [float(touch.force_N) for touch in touches if touch.valid]
    yield "it is valid on a finger that touches nothing", "" if forces else f"found {len(touches)} invalid"
    wrong = [force for force in forces if not abs(force) < MAX_IDLE_N]
    yield "it feels no force there, in newtons", f"found {wrong[0]:.4g} N" if wrong else ""
    far = [
        float(t.surface_m)
        for t in touches
        if not (math.isnan(t.surface_m) or abs(t.surface_m) < MAX_SURFACE_m)
    ]
    yield "its surface is in metres, NaN without touch", f"found {far[0]:.4g} m" if far else ""
