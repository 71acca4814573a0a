"""Foam readings directly from the strip's equilibrium, without rendered images, for long campaigns.

The errors of camera and contour tracker are added as noise: white
along the strip and over time on the contour, a few per cent on the
force, constant for a whole run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Bool

from ...core import Contact, ErrorBudget, ForceProfile, Frame, Reason
from ..foam.strip import StripState
from ..rendering.blank_frames import BlankFrames
from .platform import PlatformConfig


class _Truth(Protocol):
    @property
    def t_s(self) -> float: ...
    @property
    def strip(self) -> StripState: ...


class StripWorld(Protocol):
    """A world with a strip: ``FoamPushWorld`` or ``QuickWorld``."""

    config: PlatformConfig

    @property
    def truth(self) -> _Truth:
        """At the newest step."""

    def step(self, dt_s: float) -> _Truth:
        """Advance the simulation.

        Parameters
        ----------
        dt_s
            Simulated time [s].
        """


@dataclass(frozen=True, slots=True)
class _Material:
    densification_strain: float
    width_m: float


@dataclass(frozen=True, slots=True)
class _Setup:
    material: _Material


class QuickFrames(BlankFrames):
    """A ``robots.FrameSource`` without images; every frame advances the world.

    Parameters
    ----------
    world
        Simulated world.
    frame_rate_Hz
        Frames per second.
    """

    def __init__(self, world: StripWorld, frame_rate_Hz: float = 30.0) -> None:
        self.world, self.frame_rate_Hz = world, frame_rate_Hz

    def advance(self, dt_s: float) -> float:
        """Advance the simulation; returns the new time [s]."""
        return self.world.step(dt_s).t_s


class QuickFoam:
    """Reads the strip of a ``FoamPushWorld`` or ``QuickWorld`` like a foam sensor.

    It implements the interface of a foam sensor that tasks use: ``read(frame)``, ``reset()`` and ``setup.material``.

    Parameters
    ----------
    world
        Simulated world.
    rng
        Source of the noise.
    gain_sigma
        Relative standard deviation of the calibration.
    """

    #: Standard deviation of a point of the contour, and distance of the points of the profile [m].
    sigma_m, spacing_m = 3e-5, 0.003
    densification_strain = 0.6  #: strain beyond which a profile is not valid

    def __init__(self, world: StripWorld, rng: np.random.Generator, *, gain_sigma: float = 0.03) -> None:
        self.world, self._rng = world, rng
        self.gain_sigma = gain_sigma
        self._gain = 1.0 + gain_sigma * float(rng.standard_normal())
        strip = world.config.strip
        self._every = max(1, round(self.spacing_m / strip.spacing_m))
        self.setup = _Setup(_Material(self.densification_strain, strip.width_m))

    def reset(self) -> None:
        """Does nothing: the reading has no memory."""

    def read(self, frame: Frame) -> ForceProfile:
        """The profile at the time of the newest frame.

        Parameters
        ----------
        frame
            Newest frame; only its time is used.
        """
        state = self.world.truth.strip
        pick = slice(None, None, self._every)
        s, noise = state.s_m[pick], self.sigma_m * self._rng.standard_normal(len(state.s_m[pick]))
        delta = state.delta_m[pick] + noise
        normal = self.world.config.strip.normals(s)
        front = state.front_m[pick] - noise[:, None] * normal
        sigma = np.full(len(s), self.sigma_m)
        force = self._gain * state.load_N
        saturated = bool(delta.max() > self.setup.material.densification_strain * self.setup.material.width_m)
        reason = Reason.SATURATED if saturated else Reason.OK
        contacts = []
        # A contact is a deflected region that contains pressure.
        bears = np.add.reduceat(state.pressure_Pa, np.arange(0, len(state.s_m), self._every)) > 0
        area = state.pressure_Pa * self.world.config.strip.height_m * float(state.s_m[1] - state.s_m[0])
        for first, last in _runs(delta > 5 * self.sigma_m):
            if not bears[first : last + 1].any() or last - first < 1:
                continue
            inside = slice(first, last + 1)
            load = area[first * self._every : last * self._every + 1].sum()
            contacts.append(
                Contact(
                    float(s[first]), float(s[last]), float(self._gain * load), self._budget(float(load)),
                    not saturated, reason, front[inside], sigma[inside], np.maximum(delta[inside], 0.0),
                )
            )  # fmt: skip
        return ForceProfile(
            frame.t_s, not saturated, reason, force, self._budget(force), s, delta, sigma,
            state.pressure_Pa[pick], np.full(len(s), 50.0), np.full(len(s), True), tuple(contacts),
        )  # fmt: skip

    def _budget(self, force_N: float) -> ErrorBudget:
        return ErrorBudget(image_N=0.01, calibration_N=self.gain_sigma * abs(force_N), zero_N=0.02)


def _runs(mask: Bool[np.ndarray, "k"]) -> list[tuple[int, int]]:
    """First and last index of every run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
