"""One step of the Gaussian mixture of every pixel."""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["update_mixture"]


@njit(
    [
        "void(uint8[:, :, ::1], float32[:, :, :, ::1], uint8[:, ::1], float32, float32, float32, "
        "float32[::1], uint8[:, ::1])"
    ],
    cache=True,
    error_model="numpy",
    fastmath={"nsz", "arcp", "contract", "reassoc"},
)
def update_mixture(
    image: np.ndarray,
    modes: np.ndarray,
    held: np.ndarray,
    rate: float,
    rate_foreground: float,
    background_share: float,
    settings: np.ndarray,
    mask: np.ndarray,
) -> None:
    """Compare an image with its mixtures, then let them learn (Zivkovic 2004).

    ``image`` (H, W, C) uint8; ``modes`` (H, W, K, 2 + C) float32 with weight, variance and means of each
    mode, heaviest first, weight 0 = unused; ``held`` (H, W), not 0 where a pixel learns as
    foreground whatever it matches; ``rate`` and ``rate_foreground`` learning rates of pixels
    that match the background and that do not; ``background_share`` the heaviest modes that together hold
    it are background; ``settings`` = (squared distance of a match [variances], prior c_T, variance of
    a new, smallest and largest variance); ``mask`` (H, W) becomes 255 where the
    pixel is not background, else 0.
    """
    height, width, channels = image.shape
    count = modes.shape[2]
    gate, prior, start = settings[0], settings[1], settings[2]
    smallest, largest = settings[3], settings[4]
    one = np.float32(1.0)
    zero = np.float32(0.0)
    for row in range(height):
        for column in range(width):
            mode = modes[row, column]
            # Which mode the pixel belongs to: the heaviest that is near enough.
            found = -1
            cumulated = zero
            background = 0
            distance = zero
            for k in range(count):
                if mode[k, 0] <= zero:
                    break
                distance = zero
                for c in range(channels):
                    difference = np.float32(image[row, column, c]) - mode[k, 2 + c]
                    distance += difference * difference
                if distance < gate * np.float32(channels) * mode[k, 1]:
                    found = k
                    background = 1 if cumulated < background_share else 0
                    break
                cumulated += mode[k, 0]
            mask[row, column] = np.uint8(0) if background == 1 else np.uint8(255)
            alpha = rate if background == 1 and held[row, column] == 0 else rate_foreground
            if alpha <= zero:
                continue
            keep = one - alpha
            total = zero
            for k in range(count):
                weight = mode[k, 0]
                if weight > zero:
                    weight = keep * weight - alpha * prior
                    if k == found:
                        weight += alpha
                        step = min(alpha / max(weight, np.float32(1e-6)), one)
                        for c in range(channels):
                            mode[k, 2 + c] += step * (np.float32(image[row, column, c]) - mode[k, 2 + c])
                        variance = mode[k, 1] + step * (distance / np.float32(channels) - mode[k, 1])
                        mode[k, 1] = min(max(variance, smallest), largest)
                    mode[k, 0] = max(weight, zero)
                    total += mode[k, 0]
            if found < 0:
                # A new mode in place of the lightest.
                found = count - 1
                total -= mode[found, 0]
                mode[found, 0] = alpha
                mode[found, 1] = start
                for c in range(channels):
                    mode[found, 2 + c] = np.float32(image[row, column, c])
                total += alpha
            scale = one / total
            for k in range(count):
                mode[k, 0] *= scale
            # Heaviest first: only the mode that grew can have to move, and gaps close behind it.
            k = found
            while k > 0 and mode[k, 0] > mode[k - 1, 0]:
                for c in range(channels + 2):
                    mode[k, c], mode[k - 1, c] = mode[k - 1, c], mode[k, c]
                k -= 1
