"""One exploring push: approach, stop, wait, back off; and the camera that watches it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from types import TracebackType
from typing import Protocol, Self

import numpy as np
from jaxtyping import UInt8

from ..camera import Camera, Frame
from ..errors import InputError
from ..robots import MobileBase
from .scene import FoamScene
from .world import PushTruth, PushWorld

__all__ = ["PushPhase", "PushScript", "Renderer", "SimulatedSensorCamera", "true_stop"]


class Renderer(Protocol):
    """Turns a scene into the camera's image."""

    @property
    def camera(self) -> Camera | None:
        """The camera's model."""

    def render(
        self, scene: FoamScene, rng: np.random.Generator | None = None
    ) -> UInt8[np.ndarray, "rows columns *colour"]:
        """Image of a scene, with noise from ``rng``."""


class SimulatedSensorCamera:
    """A ``robots.FrameSource`` whose frames are views of the world; every frame lets time pass.

    The truth that belongs to the newest frame is ``world.truth``; both have the
    same time.

    Parameters
    ----------
    world
        Shared with whoever drives the platform.
    renderer
        Any object with ``camera`` and ``render(scene, rng=...)``.
    duration_s
        Ends the source; endless without.
    frame_rate_Hz
        Frames per simulated second.
    seed
        Of the image noise.
    """

    def __init__(
        self,
        world: PushWorld,
        renderer: Renderer,
        *,
        duration_s: float = math.inf,
        frame_rate_Hz: float = 30.0,
        seed: int = 0,
    ) -> None:
        if not frame_rate_Hz > 0:
            raise InputError("SimulatedSensorCamera", f"found {frame_rate_Hz} Hz, expected more than 0")
        self.world, self.renderer = world, renderer
        self._count = None if math.isinf(duration_s) else max(0, round(duration_s * frame_rate_Hz))
        self._period_s = 1.0 / frame_rate_Hz
        self._rng = np.random.default_rng(seed)
        self._closed = False

    @property
    def camera(self) -> Camera | None:
        """The renderer's camera."""
        return self.renderer.camera

    @property
    def frame_count(self) -> int | None:
        """How many frames there will be; ``None`` without an end."""
        return self._count

    def __iter__(self) -> Iterator[Frame]:
        """Step the world by a frame period, then look."""
        index = 0
        while not self._closed and (self._count is None or index < self._count):
            truth = self.world.step(self._period_s)
            image = self.renderer.render(self.world.scene(), rng=self._rng)
            yield Frame(image, truth.t_s, index)
            index += 1

    def close(self) -> None:
        """End the source."""
        self._closed = True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class PushPhase(StrEnum):
    """Phases of a push (Alt 2016, Sec. 4.1): before contact and (a), (b) are APPROACH; (c) is WAIT."""

    APPROACH = "approach"
    WAIT = "wait"
    BACK = "back"
    DONE = "done"


@dataclass(slots=True)
class PushScript:
    """Drives a base through one push; call :meth:`update` once per frame.

    The stop conditions of Alt 2016, Sec. 3.6.2 are the caller's: ``stop`` is
    asked every frame and returns the reason, or nothing to go on.
    """

    base: MobileBase
    stop: Callable[[], str]
    speed_m_s: float = 0.05
    wait_s: float = 1.0
    back_off_m: float = 0.05
    longest_m: float = 1.0  #: gives up after this way without a reason to stop
    phase: PushPhase = PushPhase.APPROACH
    reason: str = ""  #: why the platform stopped
    stopped_t_s: float = math.nan  #: when it was told to
    _start: tuple[float, float] | None = None

    def update(self) -> PushPhase:
        """Look at the base and the stop conditions, drive on; returns the phase."""
        state = self.base.state()
        if self._start is None:
            self._start = (state.x_m, state.y_m)
        gone = math.hypot(state.x_m - self._start[0], state.y_m - self._start[1])
        if self.phase is PushPhase.APPROACH:
            self.reason = self.stop() or ("longest way" if gone > self.longest_m else "")
            if self.reason:
                self.base.stop()
                self.phase, self.stopped_t_s = PushPhase.WAIT, state.t_s
            else:
                self.base.drive(self.speed_m_s, 0.0)
        elif self.phase is PushPhase.WAIT and state.t_s - self.stopped_t_s >= self.wait_s:
            self.phase, self._start = PushPhase.BACK, (state.x_m, state.y_m)
            self.base.drive(-self.speed_m_s, 0.0)
        elif self.phase is PushPhase.BACK and gone >= self.back_off_m:
            self.base.stop()
            self.phase = PushPhase.DONE
        return self.phase


def true_stop(
    world: PushWorld,
    *,
    largest_strain: float = 0.5,
    largest_force_N: float = 20.0,
    longest_m: float | None = None,
) -> Callable[[], str]:
    """The three conditions of Sec. 3.6.2 on the truth: for tests and for runs without a sensor.

    Densification, the platform's pushing capability, or a way since the first
    contact longer than the sensor is wide.
    """
    strip = world.config.strip
    way = longest_m if longest_m is not None else strip.length_m
    first: list[tuple[float, float]] = []

    def stop() -> str:
        truth: PushTruth = world.truth
        if truth.load_N > 0 and not first:
            first.append(truth.platform_pose[:2])
        if truth.strip.delta_m.max() > largest_strain * strip.width_m:
            return "densification"
        if truth.load_N > largest_force_N:
            return "force"
        x, y, _ = truth.platform_pose
        if first and math.hypot(x - first[0][0], y - first[0][1]) > way:
            return "way"
        return ""

    return stop
