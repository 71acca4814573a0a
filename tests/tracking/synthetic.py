"""An image maker that shares nothing with the tracker: exact erf edges, pixels by supersampling.

A scene is a height function ``edge(s)`` in a rotated frame: ``s`` along the contour,
``t`` across; dark for t < edge(s). The optical blur is exact for the distance to a
locally straight edge; each pixel is the mean of ``sub`` x ``sub`` points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr


@dataclass(frozen=True)
class Scene:
    """Edge t = edge(s) in a frame at ``centre`` turned by ``angle``."""

    edge: Callable[[np.ndarray], np.ndarray]
    rows: int = 120
    columns: int = 400
    centre: tuple[float, float] = (200.0, 60.0)
    angle: float = 0.0
    low: float = 60.0
    high: float = 140.0
    blur: float = 1.0

    def axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Unit vectors along s and along t in the image (x, y)."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        return np.array([c, s]), np.array([-s, c])

    def distance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Distance to the edge [px], right to second order near it."""
        along, across = self.axes()
        dx, dy = x - self.centre[0], y - self.centre[1]
        s, t = dx * along[0] + dy * along[1], dx * across[0] + dy * across[1]
        foot = s
        for _ in range(4):  # nearest point of the edge by Newton's method
            h = 1e-3
            slope = (self.edge(foot + h) - self.edge(foot - h)) / (2 * h)
            foot = foot + ((s - foot) + slope * (t - self.edge(foot))) / (1 + slope**2)
        away = np.hypot(s - foot, t - self.edge(foot))
        return np.copysign(away, t - self.edge(s))

    def exact(self, sub: int = 5) -> np.ndarray:
        """Noise-free grey levels (rows, columns)."""
        y, x = np.mgrid[: self.rows, : self.columns].astype(float)
        total = np.zeros_like(x)
        offsets = (np.arange(sub) + 0.5) / sub - 0.5
        for oy in offsets:
            for ox in offsets:
                total += ndtr(self.distance(x + ox, y + oy) / self.blur)
        return self.low + (self.high - self.low) * total / sub**2

    def lines(self, count: int, *, spacing: float = 17.0, half_width: float = 8.5, reach: float = 25.0):
        """Constraint lines along t, and the true positions on them."""
        from visuohaptic.tracking.contours import ConstraintLines

        along, across = self.axes()
        s = (np.arange(count) - (count - 1) / 2) * spacing
        origin = np.array(self.centre) + s[:, None] * along - reach * across
        lines = ConstraintLines(
            origin, np.tile(across, (count, 1)), np.zeros(count), np.full(count, 2 * reach), half_width
        )
        return lines, self.edge(s) + reach


def camera(exact: np.ndarray, noise: float, rng: np.random.Generator) -> np.ndarray:
    """Noise and rounding to 8 bit."""
    return np.clip(np.rint(exact + noise * rng.standard_normal(exact.shape)), 0, 255).astype(np.uint8)


def bound_px(blur: float, contrast: float, noise: float, width: float = 17.0) -> float:
    """Cramer-Rao bound with all nuisance parameters known, blur of the optics alone."""
    return noise / contrast * np.sqrt(2 * np.sqrt(np.pi) * blur / width)
