"""Views of a plane with exact sub-pixel truth, for the figures of the planar tracker.

A photograph is interpolated by a cubic spline; the template and every frame
are samples of this continuous function, so that the true homography is known exactly. The
tracker is not used here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["PlaneView", "corner_error", "corner_homography"]


def corner_homography(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Homography through four pairs of points, by solving the 8 x 8 system."""
    rows, right = [], []
    for (x, y), (u, v) in zip(source, target, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
        right += [u, v]
    return np.append(np.linalg.solve(np.array(rows), np.array(right)), 1.0).reshape(3, 3)


def corner_error(found: np.ndarray, true: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Differences (4, 2) [px] of the corners under two homographies."""

    def mapped(h: np.ndarray) -> np.ndarray:
        p = np.column_stack([corners, np.ones(len(corners))]) @ h.T
        return p[:, :2] / p[:, 2:]

    return mapped(found) - mapped(true)


@dataclass
class PlaneView:
    """A photograph as a continuous function, with a square template cut from it."""

    photo: np.ndarray  #: float64 (rows, columns)
    side: int  #: of the template [px]
    origin: tuple[float, float]  #: its first pixel in the photograph (column, row)

    def __post_init__(self) -> None:
        from scipy.ndimage import spline_filter

        self.coefficients = spline_filter(self.photo, order=3, mode="mirror")

    @classmethod
    def named(cls, name: str, side: int, blur: float = 0.8) -> PlaneView:
        """``astronaut`` (mixed texture) or ``gravel`` (fine texture), blurred a little."""
        from scipy.ndimage import gaussian_filter
        from skimage import color, data

        photo = getattr(data, name)()
        grey = color.rgb2gray(photo) * 255.0 if photo.ndim == 3 else photo.astype(np.float64)
        grey = gaussian_filter(grey, blur)
        start = (grey.shape[1] - side) // 2, (grey.shape[0] - side) // 2
        return cls(grey, side, start)

    @property
    def corners(self) -> np.ndarray:
        """Centres of the template's corner pixels, clockwise."""
        end = self.side - 1.0
        return np.array([[0, 0], [end, 0], [end, end], [0, end]])

    def _sample(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        from scipy.ndimage import map_coordinates

        return map_coordinates(
            self.coefficients,
            [y + self.origin[1], x + self.origin[0]],
            order=3,
            mode="mirror",
            prefilter=False,
        )

    @property
    def template(self) -> np.ndarray:
        """The template, uint8."""
        y, x = np.mgrid[: self.side, : self.side].astype(np.float64)
        return np.clip(np.round(self._sample(x, y)), 0, 255).astype(np.uint8)

    def continuous(self, homography: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """Image of an ideal camera: (height, width), no noise, not rounded."""
        y, x = np.mgrid[: size[0], : size[1]].astype(np.float64)
        p = np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
        q = np.linalg.inv(homography) @ p
        return self._sample(q[0] / q[2], q[1] / q[2]).reshape(size)

    def frame(
        self, homography: np.ndarray, size: tuple[int, int], noise: float, rng: np.random.Generator
    ) -> np.ndarray:
        """A frame with normal noise of the pixels, uint8."""
        image = self.continuous(homography, size)
        if noise > 0:
            image = image + rng.normal(0, noise, size)
        return np.clip(np.round(image), 0, 255).astype(np.uint8)

    def bound(self, homography: np.ndarray, noise: float) -> np.ndarray:
        """Cramer-Rao bound: covariance (8, 8) of the corners [px^2], template known, noise independent.

        Information is summed over the image pixels inside the template. Derivatives of the
        ideal image with respect to each corner coordinate are central differences over 0.02 px.
        """
        true = corner_error(homography, np.diag([0, 0, 1.0]), self.corners)
        low = np.floor(true.min(axis=0)).astype(int)
        high = np.ceil(true.max(axis=0)).astype(int)
        size = (high[1] - low[1] + 1, high[0] - low[0] + 1)
        y, x = np.mgrid[: size[0], : size[1]].astype(np.float64)
        p = np.stack([x.ravel() + low[0], y.ravel() + low[1], np.ones(x.size)])
        base = np.linalg.inv(homography) @ p
        base = base[:2] / base[2]
        inside = ((base >= 0) & (base <= self.side - 1)).all(axis=0)
        p = p[:, inside]
        columns = []
        for k in range(8):
            sides = []
            for sign in (-1, 1):
                moved = true.copy()
                moved[k // 2, k % 2] += 0.01 * sign
                q = np.linalg.inv(corner_homography(self.corners, moved)) @ p
                sides.append(self._sample(q[0] / q[2], q[1] / q[2]))
            columns.append((sides[1] - sides[0]) / 0.02)
        jacobian = np.column_stack(columns)
        return noise**2 * np.linalg.inv(jacobian.T @ jacobian)
