"""Blocks of a template: their size, what each tells, and how each seems to move where the image is softer."""

# mypy: allow-untyped-calls

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32


def softened(
    image: Float32[np.ndarray, "R C"],
    gradients: tuple[Float32[np.ndarray, "R C"], Float32[np.ndarray, "R C"]],
    unit: float,
    blocks: tuple[int, int],
    bloom: Float[np.ndarray, "R C"],
) -> tuple[Float[np.ndarray, "down across 28"], Float[np.ndarray, "down across 2 4"]]:
    """Sums of each block without the image, and its apparent motions due to blur and curve.

    The motions are those due to a blur of 1 px^2 along x, across, and along y, and due to a curve that is larger by 1, all
    beyond the block's illumination. A blur of variance v adds v / 2 times the second derivative. An edge cut off by
    the border of a block then appears to have moved, and more so one near the border of the template, which is excluded.
    A curve moves edges towards black.

    Parameters
    ----------
    image, gradients
        The level, and its derivatives per unit of x and y.
    unit
        Pixels per unit of x.
    blocks
        Side of a block, and width of the border of the template that is excluded [px].
    bloom
        Change of the level due to a curve that is larger by 1.
    """
    from ._block_kernels import block_sums, template_sums

    (gradient_x, gradient_y), (side, border) = gradients, blocks
    down, across = (size // side for size in image.shape)
    upper, found, inside = np.triu_indices(7), [], np.ones_like(image)
    products = np.zeros((down, across, 28))
    template_sums(image, gradient_x, gradient_y, side, border, products)
    bend_x, bend_y = (
        np.gradient(part, axis=axis) / unit for part, axis in ((gradient_x, 1), (gradient_y, 0))
    )
    for bend in (0.5 * bend_x, np.gradient(gradient_x, axis=0) / unit, 0.5 * bend_y, bloom):
        sums, normal = np.zeros_like(products), np.zeros((down, across, 7, 7))
        bend = bend.astype(np.float32)
        block_sums(bend, inside, image, gradient_x, gradient_y, products, side, border, sums)
        normal[..., upper[0], upper[1]] = normal[..., upper[1], upper[0]] = sums
        # A ridge of a millionth for blank blocks.
        light = normal[..., :4, :4] + np.eye(4) * (
            1e-6 + 1e-6 * np.einsum("...ii", normal[..., :4, :4])[..., None, None]
        )
        beside = normal[..., 4:6, :4] @ np.linalg.solve(light, normal[..., :4, 4:])
        left = normal[..., 4:6, 4:] - beside
        damp = 1e-5 * np.einsum("...ii", left[..., :2])[..., None, None] + 1e-9
        found.append(np.linalg.solve(left[..., :2] + damp * np.eye(2), left[..., 2:])[..., 0])
    return products, np.stack(found, axis=-1)


def block_side(rows: int, columns: int) -> int:
    """Block size of a level: 12 px, in which light is uniform and motion observable; 6 to 16 blocks along a side.

    Parameters
    ----------
    rows, columns
        Size of the level [px].
    """
    shorter, longer = sorted((rows, columns))
    return max(min(max(shorter // 6, 4), 12), longer // 16)


def block_values(image: Float32[np.ndarray, "R C"], side: int) -> tuple[np.ndarray, np.ndarray]:
    """Number of independent values in each block, and its variance.

    Chance correlations of n independent values have a mean square of 1 / (n - 1); their actual size is measured on the
    other blocks of the template.

    Parameters
    ----------
    image
        The level.
    side
        Side of a block [px].
    """
    down, across = (size // side for size in image.shape)
    tiles = image[: down * side, : across * side].astype(np.float64).reshape(down, side, across, side)
    flat = tiles.swapaxes(1, 2).reshape(down * across, side * side)
    flat = flat - flat.mean(axis=1, keepdims=True)
    contrast = (flat**2).mean(axis=1).reshape(down, across)
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-6)
    squared = (flat @ flat.T) ** 2
    textured = np.diag(squared) > 0.5
    np.fill_diagonal(squared, 0.0)
    mean = squared[:, textured].sum(axis=1) / max(int(textured.sum()) - 1, 1)
    return (1.0 + 1.0 / np.maximum(mean, 1e-3)).reshape(down, across), contrast
