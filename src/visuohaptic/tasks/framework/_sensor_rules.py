"""Rules of the robot contract for sensors: localizer, depth camera, finger sensor."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np

from ...core import DepthSource, FingerTouch, Frame, FrameSource, Localizer, MapPose, MobileBase, wrap_angle

#: Test commands of a base: speed [m/s], turn rate [rad/s], and their duration [s].
SPEED_m_s, TURN_rad_s, HOLD_s = 0.05, 0.25, 2.0
#: Accepted ratio of measured to commanded motion: a ramp of a quarter of the time loses an eighth of the distance.
MIN_RATIO, MAX_RATIO = 0.5, 1.5
#: Maximum age of a measurement; motion is stopped after this time without a new one [s].
FRESH_s = 0.2
#: Plausible maxima, beyond which a value has another unit: depth in a room [m], force [N] and position [m] of an unloaded finger.
MAX_DEPTH_m, MAX_IDLE_N, MAX_SURFACE_m = 50.0, 2.0, 0.5
#: Number of images that are checked.
IMAGES = 5


class TouchReader(Protocol):
    """Finger sensor: computes the touch from a frame."""

    def __call__(self, frame: Frame) -> FingerTouch:
        """Touch in a frame.

        Parameters
        ----------
        frame
            Frame of the camera that looks at the finger.
        """


def rule(promise: str, kept: object, found: str) -> tuple[str, str]:
    """Result of one rule: the rule, and the finding if it is broken (empty if kept).

    Parameters
    ----------
    promise
        Text of the rule.
    kept
        Whether it is kept.
    found
        What was measured.
    """
    return promise, "" if kept else f"found {found}"


def _fresh_rule(time_s: Callable[[], float], wait: Callable[[float], None]) -> tuple[str, str]:
    """Check that readings are recent enough for stopping in time.

    Parameters
    ----------
    time_s
        Reads the time of the newest measurement [s].
    wait
        Waits for a duration [s].
    """
    steps = []
    for _ in range(5):
        before = time_s()
        wait(FRESH_s)
        steps.append(time_s() - before)
    stale = [step for step in steps if not step > 0.0]
    found = f"{len(stale)} of {len(steps)} readings no newer than {FRESH_s:g} s before"
    return rule(f"it is measured again within {FRESH_s:g} s", not stale, found)


def clock_rules(
    time_s: Callable[[], float], wait: Callable[[float], None], waited_s: float
) -> Iterator[tuple[str, str]]:
    """Check unit and freshness of a clock: 0.5 to 1.5 of the elapsed time, and no stale readings.

    Parameters
    ----------
    time_s
        Reads the time of the newest measurement [s].
    wait
        Waits for a duration [s].
    waited_s
        Duration over which the clock is compared [s].
    """
    before = time_s()
    wait(waited_s)
    passed = time_s() - before
    found = f"{passed:.4g} s in its times while {waited_s:.4g} s passed"
    yield rule("time advances, in seconds", MIN_RATIO * waited_s <= passed <= MAX_RATIO * waited_s, found)
    yield _fresh_rule(time_s, wait)


def camera_rules(camera: FrameSource) -> Iterator[tuple[str, str]]:
    """Check types, times and sizes of frames.

    Parameters
    ----------
    camera
        Camera under test.
    """
    frames: list[Frame] = []
    for frame in camera:
        frames.append(frame)
        if len(frames) == IMAGES or not isinstance(frame, Frame):
            break
    yield rule("it has frames", frames, "none")
    kinds = {type(frame).__name__ for frame in frames if not isinstance(frame, Frame)}
    yield rule("they are of type Frame", not kinds, ", ".join(kinds))
    yield _ascending([frame.t_s for frame in frames])
    numbers = [frame.index for frame in frames]
    yield rule("their indices ascend", (np.diff(numbers) > 0).all(), f"{numbers}")
    sizes = {frame.image.shape for frame in frames}
    yield rule("they have the same size", len(sizes) == 1, f"{sorted(sizes)}")
    model = camera.camera
    if model is not None:
        rows, columns = frames[0].image.shape[:2]
        size = (model.width, model.height)
        found = f"{size} for images of {columns} x {rows}"
        yield rule("the camera's model is of that size", size == (columns, rows), found)


def _ascending(times_s: list[float]) -> tuple[str, str]:
    steps = np.diff(times_s)
    found = f"steps of {steps.round(6).tolist()} s"
    return rule("their times ascend, in seconds", ((steps > 0) & (steps < 10.0)).all(), found)


def localizer_rules(
    localizer: Localizer, base: MobileBase | None, wait: Callable[[float], None], moves: Callable[[], bool]
) -> Iterator[tuple[str, str]]:
    """Check type, units, time, and agreement with the base.

    Parameters
    ----------
    localizer
        Localizer under test.
    base
        Base that moves it; without one only readings are checked.
    wait
        Waits for a duration [s].
    moves
        Whether to move the base, asked once all readings are checked.
    """
    start = localizer.locate()
    yield rule("locate() is a MapPose", isinstance(start, MapPose), type(start).__name__)
    numbers = (start.t_s, start.x_m, start.y_m, start.heading_rad)
    yield rule("its numbers are finite", np.isfinite(numbers).all(), f"{start}")
    yield _fresh_rule(lambda: localizer.locate().t_s, wait)
    if base is None or not moves():
        return
    start, before = localizer.locate(), base.state()
    base.drive(SPEED_m_s, TURN_rad_s)
    wait(HOLD_s)
    base.stop()
    wait(1.0)
    end, after = localizer.locate(), base.state()
    step_m = math.hypot(end.x_m - start.x_m, end.y_m - start.y_m)
    driven_m = math.hypot(after.x_m - before.x_m, after.y_m - before.y_m)
    # 10 cm and half a radian reveal wrong units, axes or signs, despite differences between odometry and map.
    found = f"{step_m:.4g} m, the base reports {driven_m:.4g} m"
    yield rule("it moves with the base, in metres", abs(step_m - driven_m) < 0.05, found)
    turns = [wrap_angle(b.heading_rad - a.heading_rad) for a, b in ((start, end), (before, after))]
    found = f"{turns[0]:.4g} rad, the base reports {turns[1]:.4g} rad"
    yield rule("it turns with the base, in radians", abs(turns[0] - turns[1]) < 0.2, found)
    course = wrap_angle(
        math.atan2(end.y_m - start.y_m, end.x_m - start.x_m) - 0.5 * (start.heading_rad + end.heading_rad)
    )
    yield rule(
        "it moves where its heading points", abs(course) < 0.5, f"a course {course:.3g} rad from its heading"
    )


def depth_rules(depth: DepthSource, wait: Callable[[float], None]) -> Iterator[tuple[str, str]]:
    """Check shape, units and time of depth images.

    Parameters
    ----------
    depth
        Depth camera under test.
    wait
        Waits for a duration [s].
    """
    images = []
    for _ in range(IMAGES):
        images.append(depth.read())
        wait(FRESH_s)
    size = (depth.camera.height, depth.camera.width)
    shapes = {np.shape(image.depth_m) for image in images}
    yield rule("its images are of the camera's size", shapes == {size}, f"{sorted(shapes)}, expected {size}")
    values = np.concatenate([np.ravel(np.asarray(image.depth_m, dtype=float)) for image in images])
    values = values[~np.isnan(values)]
    yield rule("it measures depths", len(values), "NaN alone")
    wrong = values[(values <= 0.0) | (values > MAX_DEPTH_m)]
    found = f"{next(iter(wrong), 0.0):.4g}, expected more than 0 and at most {MAX_DEPTH_m:g}"
    yield rule("its depths are in metres, NaN where not measured", not len(wrong), found)
    yield _ascending([image.t_s for image in images])


def touch_rules(feel: TouchReader, camera: FrameSource | None) -> Iterator[tuple[str, str]]:
    """Check the readings of an unloaded finger.

    Parameters
    ----------
    feel
        Finger sensor under test.
    camera
        Camera that looks at the finger.
    """
    yield rule("there is a camera that looks at it", camera is not None, "no part 'camera'")
    assert camera is not None
    touches = []
    for frame in camera:
        touches.append(feel(frame))
        if len(touches) == IMAGES:
            break
    for name in ("valid", "force_N", "surface_m"):
        missing = [type(touch).__name__ for touch in touches if not hasattr(touch, name)]
        yield rule(f"what it feels has {name}", not missing, f"{next(iter(missing), None)} without")
    forces = [float(touch.force_N) for touch in touches if touch.valid]
    yield rule("it is valid on a finger that touches nothing", forces, f"{len(touches)} invalid")
    wrong = [force for force in forces if not abs(force) < MAX_IDLE_N]
    yield rule("it feels no force there, in newtons", not wrong, f"{next(iter(wrong), 0.0):.4g} N")
    far = [float(touch.surface_m) for touch in touches if abs(touch.surface_m) >= MAX_SURFACE_m]
    yield rule("its surface is in metres, NaN without touch", not far, f"{next(iter(far), 0.0):.4g} m")
