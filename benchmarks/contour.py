"""Contour tracker: speed compared with scikit-image's snake, noise compared with the Cramer-Rao bound.

python -m benchmarks contour     CPU time, noise over bound, declared over true sigma, bias; on synthetic edges
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy.special import ndtr

from visuohaptic.tracking.contours import ConstraintLines, ContourSettings, ContourTracker

ROWS, COLUMNS, POINTS = 896, 1600, 85
CONTRAST, NOISE, HALF_WIDTH = 80.0, 5.0, 8.5
PIXEL_PX = np.sqrt(1.0 / 12.0)


def _edge(distance: np.ndarray, blur: float) -> np.ndarray:
    """Step of height one, exact blur of the optics, pixels by a mean over 9 x 1 points."""
    offsets = (np.arange(9) + 0.5) / 9 - 0.5
    return np.mean([ndtr((distance + o) / blur) for o in offsets], axis=0)


def _camera(exact: np.ndarray, noise: float, rng: np.random.Generator) -> np.ndarray:
    return np.clip(np.rint(exact + noise * rng.standard_normal(exact.shape)), 0, 255).astype(np.uint8)


def _lines(start: float, stop: float, origin_y: float) -> ConstraintLines:
    x = 85.0 + 17.0 * np.arange(POINTS)
    origin = np.stack([x, np.full(POINTS, origin_y)], axis=1)
    return ConstraintLines(
        origin, np.tile([0.0, 1.0], (POINTS, 1)), np.full(POINTS, start), np.full(POINTS, stop), HALF_WIDTH
    )


def _cpu_s(call: Callable[[], object], repeats: int, rounds: int = 3) -> float:
    """Best of the medians of CPU time."""
    medians = []
    for _ in range(rounds):
        times = []
        for _ in range(repeats):
            begin = time.process_time_ns()
            call()
            times.append(time.process_time_ns() - begin)
        medians.append(float(np.median(times)))
    return min(medians) * 1e-9


def _speed(rng: np.random.Generator) -> dict:
    from skimage.filters import gaussian
    from skimage.segmentation import active_contour

    x, y = np.arange(COLUMNS, dtype=float), np.arange(ROWS, dtype=float)[:, None]
    frames, fronts = [], []
    for shift in (0.0, 1.5, 3.0, 1.5):  # the contour moves while it is measured
        front = 500.3 - (20.0 + shift) * np.exp(-(((x - 800.0) / 120.0) ** 2))
        exact = 60.0 + 40.0 * _edge(300.2 - y, 1.0) + CONTRAST * _edge(y - front, 1.0)
        frames.append(_camera(exact, 3.0, rng))
        fronts.append(front)
    back_lines, front_lines = _lines(-20.0, 20.0, 300.0), _lines(40.0, 260.0, 300.0)
    back, ahead = ContourTracker(ContourSettings(polarity=-1)), ContourTracker(ContourSettings(polarity=1))
    trackers = (back, back_lines), (ahead, front_lines)
    at = 0

    def ours() -> None:
        nonlocal at
        at = (at + 1) % 4
        for tracker, lines in trackers:
            tracker.track(frames[at], lines)

    ours()
    # The snake gets a strip of 1600 x 240 and the contour of the previous frame, at most 3 px away.
    strip = gaussian(frames[0][360:600].astype(float), 1.0, preserve_range=True) / 255.0
    points = np.stack(
        [fronts[2][front_lines.origin_px[:, 0].astype(int)] - 360.0, front_lines.origin_px[:, 0]], 1
    )

    def peer() -> None:
        active_contour(strip, points, boundary_condition="fixed", max_num_iter=2500)

    ours_s, peer_s = _cpu_s(ours, 200), _cpu_s(peer, 3, 2)
    return {
        "name": f"contour: both contours, {POINTS} points, {COLUMNS} x {ROWS}, warm",
        "ours": 1.0 / ours_s,
        "peer": 1.0 / peer_s,
        "peer_name": "skimage active_contour, one contour, 1600 x 240, warm",
        "ratio": peer_s / ours_s,
        "unit": "frames/s",
        "floor": 650.0,
        "aim": 2000.0,
    }


def _noise(blur: float, rng: np.random.Generator, trials: int = 12) -> tuple[float, float, float]:
    """Scatter over bound, mean error [px], declared over true sigma."""
    lines = _lines(0.0, 60.0, 30.0)
    x, y = np.arange(COLUMNS, dtype=float), np.arange(130, dtype=float)[:, None]
    errors, declared = [], []
    for trial in range(trials):
        phase, tilt = trial / trials, rng.uniform(-0.02, 0.02)
        front = 60.0 + phase + tilt * (x - 800.0)
        length = np.sqrt(1.0 + tilt * tilt)
        frame = _camera(60.0 + CONTRAST * _edge((y - front) / length, blur), NOISE, rng)
        found = ContourTracker(ContourSettings(polarity=1)).track(frame, lines)
        truth = 30.0 + phase + tilt * (lines.origin_px[:, 0] - 800.0)
        errors.append((found.position_px - truth)[found.valid])
        declared.append(found.sigma_px[found.valid])
    error, sigma = np.concatenate(errors), np.concatenate(declared)
    bound = NOISE / CONTRAST * np.sqrt(2.0 * np.sqrt(np.pi) * blur / (2.0 * HALF_WIDTH))
    return float(error.std() / bound), float(error.mean()), float(np.sqrt(np.mean(sigma**2)) / error.std())


def run() -> list[dict]:
    """All figures of the contour tracker."""
    rng = np.random.default_rng(2016)
    rows = [_speed(rng)]
    biases = []
    for blur in (0.7, 1.0, 1.4, 2.0):
        over, bias, stated = _noise(blur, rng)
        biases.append(abs(bias))
        common = {"peer": 1.0, "unit": "ratio"}
        rows.append(
            {
                "name": f"contour: noise / bound, blur {blur}",
                "ours": over,
                "ratio": over,
                "floor": 1.15,
                "aim": 1.05,
            }
            | common
            | {"peer_name": "Cramer-Rao bound, all else known"}
        )
        rows.append(
            {"name": f"contour: declared / true sigma, blur {blur}", "ours": stated, "ratio": stated}
            | {"floor": "0.8-1.25", "aim": "0.9-1.1"}
            | common
            | {"peer_name": "scatter"}
        )
    rows.append(
        {"name": "contour: largest bias", "ours": max(biases), "peer": 0.0, "ratio": float("nan")}
        | {"unit": "px", "floor": 0.02, "aim": 0.02, "peer_name": "truth"}
    )
    return rows


if __name__ == "__main__":
    for row in run():
        figures = f"{row['ours']:10.4g} peer {row['peer']:8.4g} ratio {row['ratio']:8.4g} {row['unit']}"
        print(f"{row['name']:55s} {figures}")
