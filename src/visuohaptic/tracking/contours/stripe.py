"""The colour stripe on the foam, Alt 2016, Sec. 3.3.1: an edge of constant appearance, and an occlusion test.

A Gaussian mixture of the colours of the stripe and of the rest is trained once. The results are
a look-up table for the class of a pixel, and the linear combination of the
colours with the largest difference between stripe and foam. The tracker uses the latter: a
mixture of two colours remains a linear mixture, so that a blurred edge keeps its position,
unlike in an image of class probabilities.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, UInt8

from ...core import CalibrationError, InputError, MissingExtraError, atomic_path, read_npz
from .lines import ConstraintLines

#: Cells of the table per colour channel, and their width in grey levels.
CELLS = 32
CELL = 256 // CELLS
FORMAT = 1
#: Maximum number of training pixels per class.
MAX_TRAINING = 20_000
#: Number of Gaussians per class of colours.
COMPONENTS = 3
#: Border around the lines that is filled in an edge image [px].
MARGIN_PX = 24
#: A point is clear if, beyond a gap for the blur [px], in a patch of this depth [px], this fraction of the pixels is stripe.
GAP_PX, DEPTH_PX, CLEAR_FRACTION = 3.0, 3.0, 0.6


@dataclass(frozen=True, slots=True, eq=False)
class StripeModel:
    """Colour model of the stripe; created by ``train`` or ``load``."""

    table: UInt8[np.ndarray, "32 32 32"]  #: probability of the stripe x 255 for blue, green, red cells
    axis: Float[np.ndarray, "3"]  #: weights of blue, green, red of the edge image
    offset: float  #: edge image = axis . colour + offset: the rest near 50, the stripe near 200

    @classmethod
    def train(
        cls,
        image_bgr: UInt8[np.ndarray, "rows columns 3"],
        stripe: Bool[np.ndarray, "rows columns"],
        rest: Bool[np.ndarray, "rows columns"] | None = None,
        *,
        rng: np.random.Generator,
    ) -> StripeModel:
        """Train the model from one image.

        Parameters
        ----------
        image_bgr
            The undeformed sensor, well lit.
        stripe, rest
            Pixels of the stripe and of everything else; ``rest`` defaults to all others. Exclude a pixel or
            two along the edge, where the colours mix.
        rng
            Random generator for sampling and dither.

        Raises
        ------
        CalibrationError
            Too few pixels, or colours that cannot be distinguished.
        MissingExtraError
            scikit-learn is not installed.
        """
        _check_colour("StripeModel.train", image_bgr)
        other = ~stripe if rest is None else rest
        if stripe.shape != image_bgr.shape[:2] or other.shape != stripe.shape:
            raise InputError(
                "StripeModel.train",
                f"found masks {stripe.shape} and {other.shape}, expected {image_bgr.shape[:2]}",
            )
        samples = [
            _training_colours(name, image_bgr[mask], 50 * COMPONENTS, rng)
            for name, mask in (("stripe", stripe), ("rest", other))
        ]
        probability, recognised, mistaken = _trained_table(samples, rng)
        if recognised < 0.9 or mistaken > 0.1:
            raise CalibrationError(
                "StripeModel.train",
                f"{100 * recognised:.0f} % of the stripe and {100 * mistaken:.0f} % of the rest "
                "look like the stripe, expected at least 90 % and at most 10 %",
                field="stripe",
                remedy="check the masks and the light, or use a stripe of another colour",
            )
        # Linear discriminant between both colours, scaled to 150 grey levels.
        centre_stripe, centre_rest = samples[0].mean(axis=0), np.median(samples[1], axis=0)
        within = np.cov(samples[0].T) + 25.0 * np.eye(3)
        weights = np.linalg.solve(within, centre_stripe - centre_rest)
        weights *= 150.0 / float(weights @ (centre_stripe - centre_rest))
        return cls(
            table=np.rint(255 * probability).astype(np.uint8).reshape(CELLS, CELLS, CELLS),
            axis=weights,
            offset=50.0 - float(weights @ centre_rest),
        )

    def edge_image(
        self,
        image_bgr: UInt8[np.ndarray, "rows columns 3"],
        lines: ConstraintLines,
    ) -> UInt8[np.ndarray, "rows columns"]:
        """Image for ``ContourTracker``, computed only around the lines; the stripe is bright.

        Parameters
        ----------
        image_bgr
            Colour image (blue, green, red).
        lines
            Constraint lines of the contour.
        """
        import cv2

        _check_colour("StripeModel.edge_image", image_bgr)
        ends = np.concatenate([lines.points_px(lines.start_px), lines.points_px(lines.stop_px)])
        rows, columns = image_bgr.shape[:2]
        left, top = np.maximum(np.floor(ends.min(axis=0)).astype(int) - MARGIN_PX, 0)
        right, bottom = np.ceil(ends.max(axis=0)).astype(int) + MARGIN_PX + 1
        result = np.zeros((rows, columns), np.uint8)
        part = image_bgr[top : min(bottom, rows), left : min(right, columns)]
        if part.size:
            matrix = np.append(self.axis, self.offset)[None]
            result[top : top + part.shape[0], left : left + part.shape[1]] = cv2.transform(part, matrix)
        return result

    def likelihood(self, colours: UInt8[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape"]:
        """Probability that pixels of these colours (blue, green, red) belong to the stripe.

        Parameters
        ----------
        colours
            Blue, green, red.
        """
        cell = np.asarray(colours) // CELL
        return self.table[cell[..., 0], cell[..., 1], cell[..., 2]] / 255.0

    def clear(
        self,
        image_bgr: UInt8[np.ndarray, "rows columns 3"],
        lines: ConstraintLines,
        position_px: Float[np.ndarray, "k"],
    ) -> Bool[np.ndarray, "k"]:
        """Whether the pixels directly in front of the points have the stripe's colour.

        Tests a patch of ``DEPTH_PX`` beyond a ``GAP_PX`` for the blur, over
        half of the point's width; ``CLEAR_FRACTION`` of the pixels must be stripe.

        Parameters
        ----------
        image_bgr, lines
            As in :meth:`edge_image`.
        position_px
            Position of the points along the lines [px].
        """
        _check_colour("StripeModel.clear", image_bgr)
        rows, columns = image_bgr.shape[:2]
        along = np.asarray(position_px)[:, None] + np.linspace(GAP_PX, GAP_PX + DEPTH_PX, 4)
        half = 0.5 * np.asarray(lines.half_width_px)
        across = half[:, None] * np.linspace(-1.0, 1.0, 5)
        side = np.stack([-lines.direction_px[:, 1], lines.direction_px[:, 0]], axis=-1)
        points = (
            lines.origin_px[:, None, None]
            + along[:, :, None, None] * lines.direction_px[:, None, None]
            + across[:, None, :, None] * side[:, None, None]
        )
        finite = np.isfinite(points)
        nearest = np.rint(np.where(finite, points, -1.0)).astype(np.int64)
        x, y = nearest[..., 0], nearest[..., 1]
        inside = (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
        colours = image_bgr[np.clip(y, 0, rows - 1), np.clip(x, 0, columns - 1)]
        is_stripe = (self.likelihood(colours) > 0.5) & inside
        return np.asarray(is_stripe.mean(axis=(1, 2)) >= CLEAR_FRACTION)

    def save(self, path: Path | str) -> None:
        """Write an NPZ file, atomically.

        Parameters
        ----------
        path
            Output file.
        """
        with atomic_path(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(
                file,
                format=np.int64(FORMAT),
                table=self.table,
                axis=self.axis,
                offset=np.float64(self.offset),
            )

    @classmethod
    def load(cls, path: Path | str) -> StripeModel:
        """Read a file written by ``save``; arrays only, no code in it is executed.

        Parameters
        ----------
        path
            The file.

        Raises
        ------
        InputError
            The file is missing, damaged, or of another type.
        """
        names = ("format", "table", "axis", "offset")
        stored = read_npz(path, "a stripe model", names=names, remedy="train it again")
        try:
            version, table = int(stored["format"]), stored["table"]
            axis, offset = stored["axis"].astype(np.float64), float(stored["offset"])
        except (TypeError, ValueError) as error:
            raise InputError(path, "is not a stripe model", remedy="train it again") from error
        if version != FORMAT:
            raise InputError(path, f"found version {version}, expected {FORMAT}", field="format")
        if table.shape != (CELLS,) * 3 or table.dtype != np.uint8 or axis.shape != (3,):
            raise InputError(
                path, f"found {table.dtype} {table.shape}, expected uint8 (32, 32, 32)", field="table"
            )
        if not (np.isfinite(axis).all() and np.isfinite(offset)):
            raise InputError(path, "found a value that is not finite", field="axis")
        return cls(table, axis, offset)


def _training_colours(
    name: str, colours: UInt8[np.ndarray, "n 3"], min_pixels: int, rng: np.random.Generator
) -> Float[np.ndarray, "m 3"]:
    """At most ``MAX_TRAINING`` colours of one class, with a dither that compensates for rounding."""
    if len(colours) < min_pixels:
        raise CalibrationError(
            "StripeModel.train", f"found {len(colours)} pixels, expected at least {min_pixels}", field=name
        )
    chosen = colours.astype(np.float64)
    if len(chosen) > MAX_TRAINING:
        chosen = chosen[rng.choice(len(chosen), MAX_TRAINING, replace=False)]
    return chosen + rng.uniform(-0.5, 0.5, chosen.shape)


def _trained_table(
    samples: list[Float[np.ndarray, "n 3"]], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "cells"], float, float]:
    """Probability of the stripe for every cell, and the fractions of stripe and rest that look like the stripe."""
    try:
        from sklearn.mixture import GaussianMixture
    except ImportError as error:
        raise MissingExtraError("scikit-learn", "learn", "training the stripe model") from error

    middle = (np.arange(CELLS) + 0.5) * CELL - 0.5
    grid = np.stack(np.meshgrid(middle, middle, middle, indexing="ij"), axis=-1).reshape(-1, 3)
    # Log density of each class over the cells, the stripe's own pixels and the rest.
    log_density: list[list[np.ndarray]] = []
    for colours in samples:
        mixture = GaussianMixture(COMPONENTS, reg_covar=4.0, random_state=int(rng.integers(2**31)))
        mixture.fit(colours)
        log_density.append([mixture.score_samples(where) for where in (grid, *samples)])
    # Unseen colours are not the stripe: a thin uniform density is added to the rest.
    unknown = np.log(0.05 / 256.0**3)
    probability, own, rest = (
        _odds(stripe, np.logaddexp(other, unknown)) for stripe, other in zip(*log_density, strict=True)
    )
    return probability, float(np.mean(own > 0.5)), float(np.mean(rest > 0.5))


def _odds(log_a: Float[np.ndarray, "n"], log_b: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    """a / (a + b) without overflow."""
    return 1.0 / (1.0 + np.exp(np.clip(log_b - log_a, -700.0, 700.0)))


def _check_colour(where: str, image: UInt8[np.ndarray, "rows columns 3"]) -> None:
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise InputError(
            where, f"found {image.dtype} {image.shape}, expected uint8 (rows, columns, 3)", field="image_bgr"
        )
