"""Maps of real buildings as arrays, read apart from the library."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import yaml

__all__ = ["load", "names"]

#: Maps with rooms and passages: file, and the resolution of those that have no YAML file [m].
MAPS: dict[str, float | None] = {
    "aws_small_house/map.yaml": None,
    "cob_ipa_apartment/map.yaml": None,
    "freiburg/freiburg_building101.png": 0.05,
    "freiburg/freiburg_building52.png": 0.05,
    "giraff_homes/Sarmis2_map_adj.yaml": None,
    "giraff_homes/UMA_236_237.yaml": None,
    "giraff_homes/movecare_map.yaml": None,
    "intel_lab/intel.yaml": None,
    "nav2/depot.yaml": None,
    "strands_tsc_y4/tsc_1701.yaml": None,
    "strands_umic/UMIC_first_floor.yaml": None,
    "tuw_freihaus_eg/map.yaml": None,
    "ut_gdc_1/1.yaml": None,
    "ut_gdc_3/3.yaml": None,
    "willow_garage/willow-full-0.05.pgm": 0.05,
    "wpi_rail/rail_lab.yaml": None,
}


def names(folder: Path) -> list[str]:
    """The maps that are there."""
    return [name for name in MAPS if (folder / name).exists()]


def load(folder: Path, name: str) -> tuple[np.ndarray, float]:
    """Cells (-1, 0, 100), row 0 at the bottom, and the cell size [m]; the origin is left at (0, 0)."""
    path, resolution_m = folder / name, MAPS[name]
    negate, occupied, free = 0, 0.65, 0.196
    if resolution_m is None:
        data = yaml.safe_load(path.read_text())
        resolution_m = float(data["resolution"])
        negate = int(data.get("negate", 0))
        occupied, free = float(data["occupied_thresh"]), float(data["free_thresh"])
        path = path.parent / Path(data["image"]).name
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise FileNotFoundError(path)
    dark = image / 255.0 if negate else 1.0 - image / 255.0
    cells = np.full(image.shape, -1, np.int8)
    cells[dark > occupied] = 100
    cells[dark < free] = 0
    return cells[::-1].copy(), float(resolution_m)
