"""One step of the Gaussian mixture of every pixel.

The columns of a row are the innermost loop of everything, and decisions are selections between two values: the
compiler turns that into vector instructions, eight pixels at a time.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel

__all__ = ["update_mixture"]

_JIT = {
    "error_model": "numpy",
    "nogil": True,
    "fastmath": {"nsz", "arcp", "contract", "reassoc"},
}


@kernel(**_JIT)
def _distance(level, mean, distance):
    """Squared distance to one mean, added up."""
    for i in range(len(level)):
        difference = level[i] - mean[i]
        distance[i] += difference * difference


@kernel(**_JIT)
def _hits(weight, variance, distance, reach, found, hit):
    """1 where a pixel is near enough to a mode and belongs to no heavier one."""
    zero, one = np.float32(0.0), np.float32(1.0)
    for i in range(len(weight)):
        w, v, d, f = weight[i], variance[i], distance[i], found[i]
        hit[i] = one if (f < zero) & (w > zero) & (d < reach * v) else zero


@kernel(**_JIT)
def _choose(hit, value, target):
    """``value`` where there is a hit."""
    for i in range(len(hit)):
        new, old = value[i], target[i]
        target[i] = new if hit[i] > np.float32(0.0) else old


@kernel(**_JIT)
def _set(hit, value, target):
    for i in range(len(hit)):
        old = target[i]
        target[i] = value if hit[i] > np.float32(0.0) else old


@kernel(**_JIT)
def _floor(hit, cumulated, fraction, background):
    """1 where the modes that are heavier than the one of the hit leave it a part of the floor."""
    zero, one = np.float32(0.0), np.float32(1.0)
    for i in range(len(hit)):
        old, before = background[i], cumulated[i]
        new = one if before < fraction else zero
        background[i] = new if hit[i] > zero else old


@kernel(**_JIT)
def _add(value, total):
    for i in range(len(total)):
        total[i] += value[i]


@kernel(**_JIT)
def _weigh(weight, found, alpha, number, prior):
    """The weight of one mode follows the image."""
    zero, one = np.float32(0.0), np.float32(1.0)
    for i in range(len(weight)):
        w, rate = weight[i], alpha[i]
        seen = one if found[i] == number else zero
        new = max((one - rate) * w - rate * prior + rate * seen, zero)
        weight[i] = new if w > zero else zero


@kernel(**_JIT)
def _steps(weight, found, alpha, number, step):
    """By what part of the difference a mode moves; nothing where it was not seen."""
    zero, one, tiny = np.float32(0.0), np.float32(1.0), np.float32(1e-6)
    for i in range(len(weight)):
        part = min(alpha[i] / max(weight[i], tiny), one)
        step[i] = part if found[i] == number else zero


@kernel(**_JIT)
def _spread(variance, nearest, step, channels, smallest, largest):
    """The variance of one mode follows the image."""
    for i in range(len(variance)):
        old, part = variance[i], step[i]
        new = min(max(old + part * (nearest[i] * channels - old), smallest), largest)
        variance[i] = new if part > np.float32(0.0) else old


@kernel(**_JIT)
def _approach(mean, level, step):
    for i in range(len(mean)):
        mean[i] += step[i] * (level[i] - mean[i])


@kernel(**_JIT)
def _exchange(swap, first, second):
    """Two values change places."""
    for i in range(len(swap)):
        p, q = first[i], second[i]
        heavier = swap[i] > np.float32(0.0)
        first[i] = q if heavier else p
        second[i] = p if heavier else q


@kernel(**_JIT)
def _heavier(first, second, swap):
    zero, one = np.float32(0.0), np.float32(1.0)
    for i in range(len(swap)):
        swap[i] = one if second[i] > first[i] else zero


@kernel(**_JIT)
def update_mixture(image, modes, held, rate, rate_foreground, background_fraction, settings, mask):
    """Compare an image with its mixtures, then let them learn (Zivkovic 2004); all numbers are float32.

    ``image`` (H, W, C) uint8; ``modes`` (H, K, 2 + C, W) float32 with weight, variance and means of each
    mode, heaviest first, weight 0 = unused; ``held`` (H, W), not 0 where a pixel learns as
    foreground whatever it matches; ``rate`` and ``rate_foreground`` > 0: learning rates of pixels
    that match the background and that do not; ``background_fraction`` the heaviest modes that together hold
    it are background; ``settings`` = (squared distance of a match [variances], prior c_T, variance of
    a new, smallest and largest variance); ``mask`` (H, W) becomes 255 where the
    pixel is not background, else 0. All numbers are float32.

    Parameters
    ----------
    image
        (H, W, C) uint8.
    modes
        (H, K, 2 + C, W): weight, variance and means of each mode, heaviest first; weight 0: unused.
    held
        (H, W), not 0 where a pixel learns as foreground whatever it matches.
    rate, rate_foreground
        Learning rates of pixels that match the background and of those that do not, more than 0.
    background_fraction
        The heaviest modes that together hold this weight are background.
    settings
        Squared distance of a match [variances], prior c_T, variance of a new mode, smallest and largest
        variance.
    mask
        (H, W), filled with 255 where the pixel is not background, else 0.
    """
    height, width, channels = image.shape
    count = modes.shape[1]
    gate, prior, start = settings[0], settings[1], settings[2]
    smallest, largest = settings[3], settings[4]
    one, zero = np.float32(1.0), np.float32(0.0)
    per_channel = one / np.float32(channels)
    level = np.zeros((channels, width), np.float32)
    distance, nearest = np.zeros(width, np.float32), np.zeros(width, np.float32)
    # The number of the mode is a float as well: all selections are then of one width.
    found, background = np.zeros(width, np.float32), np.zeros(width, np.float32)
    cumulated, total = np.zeros(width, np.float32), np.zeros(width, np.float32)
    alpha, flag = np.zeros(width, np.float32), np.zeros(width, np.float32)
    for row in range(height):
        mode = modes[row]
        for c in range(channels):
            for i in range(width):
                level[c, i] = image[row, i, c]
        found[:], background[:], cumulated[:], total[:] = -one, zero, zero, zero
        for k in range(count):
            distance[:] = zero
            for c in range(channels):
                _distance(level[c], mode[k, 2 + c], distance)
            _hits(mode[k, 0], mode[k, 1], distance, gate * np.float32(channels), found, flag)
            _floor(flag, cumulated, background_fraction, background)
            _choose(flag, distance, nearest)
            _set(flag, np.float32(k), found)
            _add(mode[k, 0], cumulated)
        for i in range(width):
            floor = background[i] > zero
            mask[row, i] = 0 if floor else 255
            alpha[i] = rate if floor & (held[row, i] == 0) else rate_foreground
        for k in range(count):
            _weigh(mode[k, 0], found, alpha, np.float32(k), prior)
            _add(mode[k, 0], total)
            _steps(mode[k, 0], found, alpha, np.float32(k), flag)
            _spread(mode[k, 1], nearest, flag, per_channel, smallest, largest)
            for c in range(channels):
                _approach(mode[k, 2 + c], level[c], flag)
        # Where nothing was near, a new mode in place of the lightest.
        last = mode[count - 1]
        for i in range(width):
            flag[i] = one if found[i] < zero else zero
        for i in range(width):
            total[i] += flag[i] * (alpha[i] - last[0, i])
        _choose(flag, alpha, last[0])
        _set(flag, start, last[1])
        for c in range(channels):
            _choose(flag, level[c], last[2 + c])
        for i in range(width):
            total[i] = one / total[i]
        for k in range(count):
            for i in range(width):
                mode[k, 0, i] *= total[i]
        # Heaviest first: only the mode that grew can have to move, so that one round from the lightest is enough.
        for k in range(count - 1, 0, -1):
            _heavier(mode[k - 1, 0], mode[k, 0], flag)
            for v in range(2 + channels):
                _exchange(flag, mode[k - 1, v], mode[k, v])
