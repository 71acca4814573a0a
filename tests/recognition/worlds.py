"""Made-up classes whose features are known in closed form, and folders like those of objects build."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from visuohaptic.recognition.data import HEIGHTS, CurveCoefficients, FeatureSet, TouchReading, as_measured

#: Class -> (log stiffness at the top, at the middle of y, width across y [m]).
PROFILES = {"soft": (4.0, 7.0, 0.06), "rim": (9.0, 7.0, 0.06), "flat": (9.0, 5.5, 0.03)}


def synthetic(variants: int = 30, seed: int = 0, spread: float = 0.1) -> FeatureSet:
    """Straight profiles: 9 at the foot, bent to the class's own values."""
    rng = np.random.default_rng(seed)
    features, widths, labels, names = [], [], [], []
    place = np.linspace(0, 1, HEIGHTS)
    for label, (top, middle, width) in PROFILES.items():
        for k in range(variants):
            scale = rng.normal(0, 2 * spread)
            axis_x = np.interp(place, [0, 0.5, 1], [9, 7, top]) + rng.normal(0, spread) * place
            axis_y = np.interp(place, [0, 0.5, 1], [9, middle, top]) + rng.normal(0, spread) * place
            grid = np.exp(scale + np.stack([axis_x, axis_x, axis_y, axis_y], axis=1))
            features.append(np.stack([grid, grid, np.zeros_like(grid)], axis=-1))
            factor = 1 + rng.normal(0, 0.03)
            widths.append(np.tile([0.06 * factor, width * factor], (HEIGHTS, 1)))
            labels.append(label)
            names.append(f"{label}-{k:05d}")
    return FeatureSet(np.stack(features), np.stack(widths), tuple(labels), tuple(names))


def touch_of(data: FeatureSet, row: int, *, sigma: float = 0.02, rng: np.random.Generator | None = None):
    """Touches of one object, with relative noise."""

    def touch(height: int, axis: str) -> TouchReading:
        column = 0 if axis == "x" else 2
        noise = np.ones(2) if rng is None else np.exp(rng.normal(0, sigma, 2))
        values = data.features[row, height - 1, column : column + 2, 0] * noise
        sides = [CurveCoefficients(float(v), float(v), 0.0, sigma, 0.1) for v in values]
        width = float(data.width_m[row, height - 1, column // 2])
        tall = np.nan if data.height_m is None else float(data.height_m[row])
        return TouchReading(height, axis, (sides[0], sides[1]), width, tall)

    return touch


def as_explored(data: FeatureSet, rng: np.random.Generator, *, pose_m: float = 0.002) -> FeatureSet:
    """The objects as one exploration of each reads them, by a simulation that is wrong by 6 %."""
    features = data.features.copy()
    features[..., 0] = np.exp(as_measured(np.log(features[..., 0]), rng, pose_m=pose_m))
    return replace(data, features=features)


def build_folder(folder: Path, data: FeatureSet, height_m: float = 0.0) -> Path:
    """As objects build would write it."""
    listed = []
    for row, name in enumerate(data.name):
        label = data.label[row]
        (folder / label).mkdir(parents=True, exist_ok=True)
        half = data.width_m[row] / 2
        points = np.zeros((HEIGHTS, 4, 3))
        points[:, :, 2] = ((np.arange(HEIGHTS) + 0.5) * height_m / HEIGHTS)[:, None]
        points[:, 0, 0], points[:, 1, 0] = half[:, 0], -half[:, 0]
        points[:, 2, 1], points[:, 3, 1] = half[:, 1], -half[:, 1]
        file = f"{label}/{name}.npz"
        np.savez(
            folder / file,
            features=data.features[row][None],
            feature_points_m=points,
            states=np.array([[0.0, 0.0]]),
        )
        listed.append({"file": file, "class": label})
    (folder / "manifest.json").write_text(json.dumps({"objects": listed}))
    return folder
