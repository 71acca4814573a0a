"""Selection of squeezes by expected information gain, and correction of a stiffness map by squeezes (Alt 2016, Sec. 6.3)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core.objects import StiffnessMap
from ...recognition import HapticModel, touch_gains, update_belief
from ...recognition.data.readings import CurveCoefficients, TouchNoise, TouchReading, fit_curve
from ...recognition.touch.refinement import correct_map
from .hand import Place
from .squeeze_task import SqueezeCurve

#: Standard deviation of the mean of the readings at one force level: force [N] and surface position [m] of the finger.
NOISE = TouchNoise(0.05, 5e-5)
#: Number of levels at both ends of an object that are not squeezed: an error of the object's height has most effect there.
END_LEVELS = 3
#: Minimum relative standard deviation of a stiffness.
MIN_STIFFNESS_SIGMA = 0.05


@dataclass
class BayesSqueezer:
    """A :class:`~visuohaptic.tasks.manipulation.classify.SqueezeClassifier` for an object of measured height.

    Parameters
    ----------
    model
        Distribution of the features of each class by level.
    height_m
        Height of the object [m].
    levels
        Number of levels into which the model divides a height.
    rng
        Random generator for the samples of the expected gain.
    samples
        Number of posterior samples for the gain of a touch.
    odds
        Prior odds factors of the classes, as from visual recognition; 1 for a class that is
        not listed.
    yaw_rad
        Direction of the axis x of the model in the base of the arm [rad].
    """

    model: HapticModel
    height_m: float
    levels: int
    rng: np.random.Generator
    samples: int = 32
    odds: Mapping[str, float] = field(default_factory=dict)
    yaw_rad: float = 0.0
    readings: list[TouchReading] = field(default_factory=list)
    _missed: set[tuple[int, str]] = field(default_factory=set)  #: requested, but not felt

    def next_place(self) -> Place | None:
        """The squeeze with the largest expected information gain per time; ``None`` if none is left."""
        gains = touch_gains(self.model, tuple(self.readings), samples=self.samples, rng=self.rng)
        gains = {
            touch: value
            for touch, value in gains.items()
            if END_LEVELS <= touch[0] <= self.levels - END_LEVELS and touch not in self._missed
        }
        if not gains:
            return None
        level, axis = max(gains, key=lambda touch: gains[touch][0] / gains[touch][1])
        self._missed.add((level, axis))
        angle_rad = math.remainder(self.yaw_rad + (0.0 if axis == "x" else 0.5 * math.pi), math.pi)
        return Place((level - 0.5) / self.levels * self.height_m, angle_rad)

    def update(self, curve: SqueezeCurve) -> None:
        """Update the posterior with a squeeze; both sides of a pinch are one reading.

        Parameters
        ----------
        curve
            Force against deformation at the middle of a level, along one of both axes.
        """
        level = round(curve.place.height_m / self.height_m * self.levels + 0.5)
        axis = "x" if abs(math.cos(curve.place.angle_rad - self.yaw_rad)) > 0.5 else "y"
        self._missed.discard((level, axis))
        self.readings.append(
            TouchReading(level, axis, (curve_fit(curve), None), 2.0 * curve.surface_m, self.height_m)
        )

    def belief(self) -> Mapping[str, float]:
        """Posterior probability of every class and of the unknown class."""
        return self._belief(len(self.readings))

    def history(self) -> list[Mapping[str, float]]:
        """Posterior after each squeeze."""
        return [self._belief(count) for count in range(1, len(self.readings) + 1)]

    def _belief(self, count: int) -> Mapping[str, float]:
        found = update_belief(self.model, tuple(self.readings[:count])).as_mapping()
        weights = {name: value * self.odds.get(name, 1.0) for name, value in found.items()}
        total = sum(weights.values())
        return {name: weight / total for name, weight in weights.items()}


def curve_fit(curve: SqueezeCurve) -> CurveCoefficients:
    """Coefficients of force over deformation, with the noise of the finger.

    Parameters
    ----------
    curve
        Squeeze at several force levels.
    """
    return fit_curve(np.maximum(curve.deformation_m, 0.0), curve.force_N, NOISE, from_contact=True)


def correct_by_squeezes(
    surface: StiffnessMap,
    curves: Sequence[SqueezeCurve],
    *,
    scale: float = 1.0,
    yaw_rad: float = 0.0,
    deviations: Float[np.ndarray, "s v"] | None = None,
) -> StiffnessMap:
    """Correct the stiffness map of a class or of an outline by squeezes of one object.

    Parameters
    ----------
    surface
        Map before the squeezes.
    curves
        Squeezes; those without a positive stiffness are ignored.
    scale
        Ratio of the height on the map to the height on the object.
    yaw_rad
        Direction of the map's axis x in the base of the arm [rad].
    deviations
        As of :func:`~visuohaptic.recognition.touch.correct_map`, for the outline of a round body.
    """
    points, measured, sigma = [], [], []
    for curve in curves:
        z, stiffness, radius = curve.place.height_m, curve.stiffness_N_per_m, curve.surface_m
        if not (np.isfinite(stiffness) and stiffness > 0):
            continue
        angle = curve.place.angle_rad - yaw_rad
        points.append([radius * math.cos(angle), radius * math.sin(angle), scale * z])
        measured.append(stiffness)
        sigma.append(max(MIN_STIFFNESS_SIGMA, curve_fit(curve).i_relative_sigma))
    return correct_map(surface, np.array(points), np.array(measured), np.array(sigma), deviations)
