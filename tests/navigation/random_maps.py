"""Random maps, real maps, and topology counted by a library: shared by the navigation tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from visuohaptic.io.maps import OccupancyMap

RADII_M = (0.05, 0.1, 0.2, 0.3)


def random_map(rng: np.random.Generator, largest: int = 50) -> OccupancyMap:
    """Noise of several densities, or boxes and walls; cells of 0.1 m, some unknown, any origin."""
    shape = tuple(int(n) for n in rng.integers(1, largest, 2))
    if rng.random() < 0.5:
        cells = 100 * (rng.random(shape) < rng.choice([0, 0.003, 0.01, 0.05, 0.3, 0.5]))
    else:
        cells = np.zeros(shape, int)
        for _ in range(rng.integers(1, 12)):
            row, column = rng.integers(0, shape)
            height, width = rng.choice([1, 1, 3, 8, 20], 2)
            cells[row : row + height, column : column + width] = rng.choice([0, 100, 100])
    cells[rng.random(shape) < rng.choice([0, 0, 0.02])] = -1
    return OccupancyMap(cells.astype(np.int8), 0.1, (*rng.normal(0, 3, 2), rng.uniform(-3, 3)))


def topology(cells: np.ndarray) -> tuple[int, int]:
    """Components (8-connected) and holes (4-connected) of a set, counted by labels alone."""
    from scipy.ndimage import label

    components = label(cells, np.ones((3, 3)))[1]
    outside = np.pad(~cells, 1, constant_values=True)
    return components, label(outside)[1] - 1


def real_maps(data: Path) -> dict[str, OccupancyMap]:
    """Every real map of the data."""
    folder = data / "navigation" / "dev" / "maps"
    found = {}
    for path in sorted(folder.rglob("*.yaml")):
        if path.stem in {"doors", "connectivity", "objects", "UMIC_FF", "locations"}:
            continue
        found[path.stem] = OccupancyMap.load(path)
    for path in sorted(folder.rglob("*.pgm")) + sorted(folder.rglob("*.png")):
        if path.stem.startswith(("willow", "freiburg")):
            found[path.stem] = OccupancyMap.from_image(path, 0.05)
    found["UMIC_first_floor"] = OccupancyMap.from_image(
        folder / "strands_umic" / "UMIC_first_floor.pgm", 0.02
    )
    return found
