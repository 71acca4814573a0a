"""State of one alignment: the image around the template, its pyramid, and the estimate."""

# mypy: allow-untyped-calls

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...points.homography import apply_homography
from .esm_template import CURVES, EsmTemplate, Level
from .image_spline import ImageSpline


@dataclass(frozen=True, slots=True)
class EsmSettings:
    """Effort and acceptance thresholds of the tracker."""

    levels: int = 4  #: pyramid levels, each half the size of the previous one
    search_px: float = 40.0  #: maximum motion of the corners [px of the image]
    cut_sigmas: float = 3.0  #: residuals beyond this many standard deviations are down-weighted
    right_px: float = 2.0  #: error of the corners up to which a pose is correct [px of the image]
    min_probability: float = (
        0.99  #: minimum probability that the pose is correct; below it, the template is lost
    )
    ncc_search: float = 0.8  #: correlation below which the translation is searched for
    min_seen: float = (
        0.5  #: minimum fraction of blocks that show the template: no two poses can both exceed it
    )
    tolerance_px: float = 0.06  #: final passes stop when the corners move by less


#: Margin of the image around the search area [px]: the range of interpolation on the coarsest level.
MARGIN_PX = 8.0
#: An offset of this shape means none.
NO_OFFSET = np.zeros((2, 1, 1), dtype=np.float32)


@dataclass(frozen=True, slots=True)
class GaussNewton:
    """Gauss-Newton settings for one level of the pyramid."""

    passes: int  #: maximum number of passes
    fraction: float = 0.0  #: part of the gradient from the warped image (0.5: ESM, 0: none)
    subset: bool = False  #: only the rows that the template marks as informative
    cubic: bool = False  #: use cubic-spline interpolation; on the finest level only
    cut: float = 6.0  #: residuals beyond this many standard deviations are down-weighted
    damping: float = 0.0  #: Levenberg-Marquardt damping, relative to the diagonal
    tolerance: float = 0.02  #: iteration stops when the corners move by less [px of the level]


#: One evaluation of the residuals without a step.
_LOOK = GaussNewton(1, cut=100.0, tolerance=0.0)


class Work:
    """State of one alignment: image region, its pyramid, and the current estimate.

    Parameters
    ----------
    template
        Template to align.
    image
        Grey image, (rows, columns) uint8.
    homography
        Prediction: template pixels to image pixels, (3, 3).
    settings
        Levels, search range and thresholds.
    offset
        Added to the warped position of every template pixel on the finest level, (2, R, C) [px]; None: zero.
    blur
        Variance of the Gaussian blur of the image relative to the template [template px^2]; None: that of a typical
        camera.
    curve
        Curve from light to grey levels, 0 to 1.
    """

    def __init__(
        self,
        template: EsmTemplate,
        image: np.ndarray,
        homography: np.ndarray,
        settings: EsmSettings,
        offset: np.ndarray | None,
        blur: float | None = None,
        curve: float = 0.0,
    ) -> None:
        self.template, self.settings = template, settings
        corners = np.clip(apply_homography(homography, template.corners), -1e6, 1e6)
        self.curve = _nearest_curve(curve)
        self._choose_chain(corners, blur)
        self.homography = homography
        self.light = np.array([1.0, 0.0, 0.0, 0.0, 1.0])
        self.matrix = np.zeros((10, 10))
        self.stats = np.zeros(13)
        #: Samples of the image at the template's pixels, and where they were taken: level and centred homography.
        self._samples = np.empty(2 * self.finest.image.size, np.float32)
        self.sampled: tuple[int, np.ndarray] = -1, np.zeros((3, 3))
        self.offset = offset
        self.margin = -np.inf
        self.clipped = image.dtype == np.uint8
        #: Whether the image region is large enough for the coarsest level.
        self.enough = self._build_pyramid(image, corners)
        if self.enough and offset is not None:
            self.bent = self._bend(offset)

    def _choose_chain(self, corners: np.ndarray, blur: float | None) -> None:
        """Select the template's chain of levels whose pixel size is closest to the image's, and its blur."""
        template = self.template
        # Pixels of the image per pixel of the template: root of the ratio of areas, from the diagonals.
        (ax, ay), (bx, by) = (corners[2] - corners[0]).tolist(), (corners[3] - corners[1]).tolist()
        width, height = (template.corners[2] - template.corners[0]).tolist()
        self.scale = float(np.sqrt(abs(ax * by - ay * bx) / (2.0 * width * height)))
        # Not larger than the image's: if the template is the coarser one, image pixels between its samples
        # are not used.
        halves = np.log2(max(self.scale, 1e-6))
        chain = int(np.floor(-2.0 * halves))
        self.chain = min(max(chain, 0), len(template.chains) - 1)
        self.block = template.blocks[self.chain]
        self.blur = template.first_blur if blur is None else template.blur_index(self.chain, blur)
        self.finest = template.finest(self.chain, self.blur, self.curve)
        self.levels = template.chains[self.chain]
        self.image_base = min(max(round(halves), 0), 4)
        self.count = min(self.settings.levels, len(self.levels))

    def _build_pyramid(self, image: np.ndarray, corners: np.ndarray) -> bool:
        """Image levels around the predicted corners; False if the image border is too close."""
        import cv2

        step, block = 2 ** (self.image_base + self.count - 1), 2**self.image_base
        height, width = image.shape
        margin = self.settings.search_px + MARGIN_PX
        low = np.floor((corners.min(axis=0) - margin) / step).astype(int) * step
        high = np.ceil(corners.max(axis=0) + margin).astype(int) + 1
        self.x0, self.y0 = max(int(low[0]), 0), max(int(low[1]), 0)
        x1, y1 = min(int(high[0]), width), min(int(high[1]), height)
        if not (x1 - self.x0 >= 4 * step and y1 - self.y0 >= 4 * step):
            return False
        level = image[self.y0 : y1, self.x0 : x1].astype(np.float32)
        if block > 1:
            # Block averages keep the noise of different pixels independent.
            size = (level.shape[1] // block, level.shape[0] // block)
            level = level[: size[1] * block, : size[0] * block]
            level = cv2.resize(level, size, interpolation=cv2.INTER_AREA)
        self.images, self._spline = [level], ImageSpline(level)
        for _ in range(self.count - 1):
            level = cv2.pyrDown(level)
            self.images.append(level)
        centre_x, centre_y = self.x0 + (block - 1) / 2, self.y0 + (block - 1) / 2
        #: From the finest used level to the whole image.
        self.to_image = np.array([[block, 0, centre_x], [0, block, centre_y], [0, 0, 1.0]])
        back = np.array([[1, 0, -centre_x], [0, 1, -centre_y], [0, 0, block]]) / block
        self.homography = back @ self.homography
        return True

    def _bend(self, offset: np.ndarray) -> np.ndarray:
        """The offset at the pixels of the finest level, in pixels of the finest image."""
        import cv2

        rows, columns = (size + 2 for size in self.levels[0].image.shape)
        scaled = offset * np.float32(0.5**self.image_base)
        parts = [cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA) for part in scaled]
        return np.ascontiguousarray(np.stack(parts)[:, 1:-1, 1:-1])

    def soften(self, more: float, curve: float) -> bool:
        """Recompute the finest level with another blur and curve; returns whether that changes anything.

        Parameters
        ----------
        more
            Variance relative to the current one [px^2 of the finest level].
        curve
            Curve relative to the current one.
        """
        area = self.block[0] * self.block[1]
        before = self.blur, self.curve
        self.blur = self.template.blur_index(
            self.chain, self.template.variance(self.chain, self.blur) + more * area
        )
        # Steps have no gradient without a blur.
        self.blur = max(self.blur, 1) if self.template.sharp else self.blur
        self.curve = _nearest_curve(CURVES[self.curve] + curve)
        self.finest = self.template.finest(self.chain, self.blur, self.curve)
        return before != (self.blur, self.curve)

    def shade(self, light: np.ndarray) -> None:
        """Apply uneven illumination to the finest level, and exclude its border.

        Parameters
        ----------
        light
            Polynomial of the centred coordinates, 1 at the middle, (6,).
        """
        level = self.finest
        inner = slice(level.border, -level.border)
        level = replace(
            level,
            x=level.x[inner],
            y=level.y[inner],
            image=level.image[inner, inner],
            gradient_x=level.gradient_x[inner, inner],
            gradient_y=level.gradient_y[inner, inner],
            rows=level.rows[: -2 * level.border],
        )
        if self.offset is not None:
            self.bent = np.ascontiguousarray(self.bent[:, inner, inner])
        a, b, c, d, e, f = (np.float32(part) for part in light)
        x, y = level.x, level.y.astype(np.float32)[:, None]
        shade = (a + y * (c + f * y)) + x * (b + e * y) + x * x * d
        # Light is also reflected by black ink: the template value -bias / gain is dark.
        dark = np.float32(self.light[1] / self.light[0])
        self.finest = replace(
            level,
            image=(level.image + dark) * shade - dark,
            gradient_x=level.gradient_x * shade,
            gradient_y=level.gradient_y * shade,
        )

    def pair(self, k: int) -> tuple[Level, np.ndarray, np.ndarray]:
        """Template level, image level, and the centred homography between them.

        Parameters
        ----------
        k
            Level of the pyramid, 0 = finest.
        """
        level = self.levels[k] if k else self.finest
        h = self.homography @ level.to_template
        h[:2] *= 0.5**k
        return level, self.images[k], h

    def refine(self, k: int, how: GaussNewton, homography: np.ndarray | None = None) -> float:
        """Gauss-Newton passes on one level of the pyramid.

        Parameters
        ----------
        k
            Level of the pyramid, 0 = finest.
        how
            Passes, rows, interpolation and robust weights.
        homography
            Initial homography instead of the current estimate, (3, 3).

        Returns
        -------
        float
            Last motion of the corners in pixels of that level.
        """
        if homography is not None:
            self.homography = homography
        level, image, h = self.pair(k)
        h = np.ascontiguousarray(h / h[2, 2])
        if self.light[2] <= 0.0:
            # The illumination is unknown: one evaluation without a step, for gain and bias.
            self.light[:] = (1.0, 0.0, 1e3, 1e3, 1.0)
            self.run(k, level, image, h.copy(), level.rows, _LOOK)
            self._light_from_moments()
        rows = level.informative if how.subset else level.rows
        if how.cubic:
            image = self.spline(h)
        shift = self.run(k, level, image, h, rows, how)
        self.homography = self.uncentred(k, h)
        self.centred = h
        return shift

    def uncentred(self, k: int, h: np.ndarray) -> np.ndarray:
        """Template pixels to pixels of the finest image, from a level's centred homography, (3, 3).

        Parameters
        ----------
        k
            Level of the pyramid, 0 = finest.
        h
            Centred coordinates of the template to pixels of that level, (3, 3).
        """
        back = h @ (self.levels[k] if k else self.finest).from_template
        back[:2] *= 2.0**k
        return np.asarray(back / back[2, 2])

    def samples(self, k: int, h: np.ndarray) -> np.ndarray:
        """Samples of the image at all pixels of a level, and 1 inside of the image, 0 outside, (2, R, C) float32.

        They are valid until others are taken; at the same place they are not taken again.

        Parameters
        ----------
        k
            Level of the pyramid, 0 = finest.
        h
            Centred coordinates of the template to pixels of that level, (3, 3).
        """
        from ._sample_kernels import sample_rows

        level, image, _ = self.pair(k)
        found = self._buffer(level)
        at, place = self.sampled
        if at != k or np.abs(place - h).max() > 1e-9:
            to_centred = np.array(
                [[1 / level.unit, 0, level.x[0]], [0, 1 / level.unit, level.y[0]], [0, 0, 1.0]]
            )
            image = image if k else self.spline(h)
            sample_rows(image, h @ to_centred, self._offset(k), level.rows, k == 0, *found)
            self.sampled = k, h.copy()
        return found

    def _buffer(self, level: Level) -> np.ndarray:
        return self._samples[: 2 * level.image.size].reshape(2, *level.image.shape)

    def _offset(self, k: int) -> np.ndarray:
        return self.bent if self.offset is not None and k == 0 else NO_OFFSET

    def spline(self, h: np.ndarray) -> np.ndarray:
        """Cubic B-spline coefficients of the finest image in the area of the template, (rows, columns) float32, 0 elsewhere.

        Parameters
        ----------
        h
            Centred coordinates of the template to pixels of that image, (3, 3).
        """
        level = self.finest
        ends = np.array([(sx * level.x[-1], sy * level.y[-1], 1.0) for sx in (-1, 1) for sy in (-1, 1)])
        mapped = ends @ h.T
        return self._spline.around(mapped[:, :2] / np.maximum(mapped[:, 2:], 1e-9))

    def run(
        self, k: int, level: Level, image: np.ndarray, h: np.ndarray, rows: np.ndarray, how: GaussNewton
    ) -> float:
        """Call the kernel, which changes ``h``, gain, bias, and the moments of the residual.

        Parameters
        ----------
        k
            Level of the pyramid, 0 = finest.
        level
            Level of the template.
        image
            Level of the image, or its spline coefficients if ``how.cubic``, (rows, columns) float32.
        h
            Centred coordinates of the template to pixels of that level, (3, 3).
        rows
            Rows of the template to use.
        how
            Passes, interpolation and robust weights.

        Returns
        -------
        float
            Last motion of the corners [px of the level].
        """
        from ._esm_kernels import refine_level

        places = np.array((h, h))
        shift = refine_level(
            image, level.image, level.gradient_x, level.gradient_y, level.x, level.y, rows, self._offset(k), places,
            self.light, how.fraction, level.unit, how.cubic, np.array([how.cut, self.margin]), how.damping,
            how.passes, how.tolerance, self._buffer(level), self.matrix, self.stats,
        )  # fmt: skip
        h[:] = places[0]
        # They serve :meth:`samples` if they are all that it would take.
        self.sampled = (k if len(rows) == len(level.rows) and how.cubic == (k == 0) else -1), places[1]
        return float(shift)

    def _light_from_moments(self) -> None:
        n, i, t, ii, _, tt = self.stats[7:]
        if n < 1:
            return
        spread_t = max(tt / n - (t / n) ** 2, 1e-6)
        spread_i = max(ii / n - (i / n) ** 2, 1e-6)
        # The ratio of contrasts, which is independent of the alignment.
        gain = float(np.sqrt(spread_i / spread_t))
        spread = float(np.sqrt(spread_i))
        self.light[:] = (gain, (i - gain * t) / n, spread, spread, 1.0)

    @property
    def relative(self) -> float:
        """Pixels of the finest level of the image per pixel of the finest level of the template."""
        bx, by = self.block
        return float(self.scale * np.sqrt(bx * by) * 0.5**self.image_base)

    @property
    def ncc(self) -> float:
        """Correlation of the last pass."""
        n, i, t, ii, it, tt = self.stats[7:]
        if n < 1:
            return 0.0
        variance = max(ii - i * i / n, 0.0) * max(tt - t * t / n, 0.0)
        return float((it - i * t / n) / np.sqrt(variance)) if variance > 0 else 0.0


def _nearest_curve(curve: float) -> int:
    """Index of the member of ``CURVES`` that is closest."""
    return int(np.argmin([abs(known - curve) for known in CURVES]))
