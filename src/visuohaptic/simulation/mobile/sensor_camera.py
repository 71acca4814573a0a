"""The camera above the foam of a simulated platform: every frame advances the simulation."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Protocol

import numpy as np
from jaxtyping import UInt8

from ...core import POSITIVE, Camera, Closing, Frame, check_numbers
from ..rendering.scene import FoamScene
from .push_world import FoamPushWorld


class Renderer(Protocol):
    """Renders a scene as the camera's image."""

    @property
    def camera(self) -> Camera | None:
        """The camera's model."""

    def render(
        self, scene: FoamScene, *, rng: np.random.Generator
    ) -> UInt8[np.ndarray, "rows columns *colour"]:
        """Image of a scene, with noise from ``rng``.

        Parameters
        ----------
        scene
            Scene at one time.
        rng
            Source of the noise.
        """


class SimulatedSensorCamera(Closing):
    """A ``robots.FrameSource`` whose frames are views of the world; every frame advances the simulation.

    ``world.truth`` is the ground truth of the newest frame, at the same
    time.

    Parameters
    ----------
    world
        Shared with the user that drives the platform.
    renderer
        Any object with ``camera`` and ``render(scene, rng=...)``.
    duration_s
        Duration of the source; endless by default.
    frame_rate_Hz
        Frames per simulated second.
    seed
        Seed of the image noise.
    """

    def __init__(
        self,
        world: FoamPushWorld,
        renderer: Renderer,
        *,
        duration_s: float = math.inf,
        frame_rate_Hz: float = 30.0,
        seed: int = 0,
    ) -> None:
        check_numbers("SimulatedSensorCamera", POSITIVE, frame_rate_Hz=frame_rate_Hz)
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
        """Number of frames; ``None`` if endless."""
        return self._count

    def __iter__(self) -> Iterator[Frame]:
        """Advance the world by a frame period, then render."""
        index = 0
        while not self._closed and (self._count is None or index < self._count):
            truth = self.world.step(self._period_s)
            image = self.renderer.render(self.world.scene(), rng=self._rng)
            yield Frame(image, truth.t_s, index)
            index += 1

    def close(self) -> None:
        """End the source."""
        self._closed = True
