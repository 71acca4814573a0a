"""Doors detected from the geometry of real maps, compared with third-party annotations (UT Austin GDC).

A door counts as found when its middle is within 0.75 m of the annotated one's,
one to one. Some openings of the building are not annotated, and some annotated
doors were closed when the map was recorded: the figures are not corrected for this.

    python -m benchmarks nav_doors                    recall, precision, rooms on both sides, CPU time
    python -m benchmarks.nav_doors --pictures DIR     images of the detections on all real maps
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.mapping import DoorMap, DoorSettings, find_doors

TOLERANCE_M = 0.75


def data_folder() -> Path:
    """Where the real maps are."""
    named = os.environ.get("VISUOHAPTIC_DATA")
    root = Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "data"
    return root / "navigation" / "dev" / "maps"


def drawn_doors(path: Path) -> tuple[np.ndarray, list[list[np.ndarray]]]:
    """Corners (n, 2, 2) and approach points of each drawn door [m]."""
    entries = yaml.safe_load(path.read_text())
    corners = np.array([[entry["door_corner_pt_1"], entry["door_corner_pt_2"]] for entry in entries])
    return corners, [[np.array(a["point"][:2]) for a in entry["approach"]] for entry in entries]


def matched(found: DoorMap, corners: np.ndarray) -> list[tuple[int, int]]:
    """Pairs (found, annotated), one to one, nearest first."""
    middles = np.array([door.middle_m for door in found.doors]).reshape(-1, 2)
    return matched_places(middles, corners.mean(axis=1))


def matched_places(middles: np.ndarray, true_m: np.ndarray) -> list[tuple[int, int]]:
    """Pairs (position, true position), one to one, nearest first."""
    from scipy.optimize import linear_sum_assignment

    far = np.hypot(*(middles[:, None] - true_m[None]).transpose(2, 0, 1))
    rows, columns = linear_sum_assignment(np.where(far < TOLERANCE_M, far, 1e3))
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if far[i, j] < TOLERANCE_M]


def joins_its_rooms(grid: OccupancyMap, found: DoorMap, door: int, approach: list[np.ndarray]) -> bool:
    """Whether the drawn approach points lie in the two rooms that the door joins."""
    cells = grid.cell_from_world(np.array(approach))
    rooms = {int(found.rooms[tuple(cell)]) for cell in cells[grid.inside(cells)]}
    return len(rooms) == 2 and rooms == set(found.doors[door].rooms)


def run() -> list[dict[str, Any]]:
    """Recall, precision, rooms on both sides, and time."""
    hits = drawn = told = joined = 0
    curve: dict[float, list[int]] = {0.7: [0, 0], 0.9: [0, 0]}
    seconds = []
    for floor in (1, 3):
        folder = data_folder() / f"ut_gdc_{floor}"
        grid = OccupancyMap.load(folder / f"{floor}.yaml")
        corners, approach = drawn_doors(folder / "doors.yaml")
        started = time.process_time()
        found = find_doors(grid)
        seconds.append(time.process_time() - started)
        pairs = matched(found, corners)
        hits, drawn, told = hits + len(pairs), drawn + len(corners), told + len(found.doors)
        joined += sum(joins_its_rooms(grid, found, i, approach[j]) for i, j in pairs)
        for confidence, counts in curve.items():
            sure = DoorMap(tuple(d for d in found.doors if d.confidence >= confidence), found.rooms)
            counts[0] += len(matched(sure, corners))
            counts[1] += len(sure.doors)
    rows: list[dict[str, Any]] = [
        {"name": "doors: recall", "ours": hits / drawn, "unit": "1", "floor": 0.8, "aim": 0.95},
        {
            "name": "doors: precision",
            "ours": hits / told,
            "unit": "1",
            "aim": 0.9,
            "higher_is_better": True,
            "note": "openings without a drawn door count as wrong",
        },
        {
            "name": "doors: approach points in the two rooms that the door joins",
            "ours": joined / hits,
            "unit": "1",
            "higher_is_better": True,
            "note": "of the doors found",
        },
        {"name": "doors: CPU time per floor, 1857 x 1255", "ours": float(np.median(seconds)), "unit": "s"},
    ]
    for confidence, (good, all_told) in curve.items():
        rows.append(
            {
                "name": f"doors: precision at confidence {confidence}",
                "ours": good / max(all_told, 1),
                "unit": "1",
                "higher_is_better": True,
                "note": f"recall {good / drawn:.2f}",
            }
        )
    return rows


def pictures(folder: Path) -> None:
    """One picture per real map: rooms in colours, doors in green by confidence."""
    import cv2

    folder.mkdir(parents=True, exist_ok=True)
    colours = np.random.default_rng(1).integers(190, 256, (4096, 3))
    colours[0] = 170
    for path in sorted(data_folder().glob("*/*.yaml")):
        if "resolution" not in path.read_text():
            continue
        grid = OccupancyMap.load(path)
        found = find_doors(grid, DoorSettings())
        image = colours[found.rooms % 4096].astype(np.uint8)
        image[grid.unknown], image[grid.cells >= 50] = 140, 0
        for door in found.doors:
            ends = grid.cell_from_world(door.jambs_m)[:, ::-1]
            a, b = (tuple(int(v) for v in end) for end in ends)
            cv2.line(image, a, b, (0, 150, 0) if door.confidence > 0.7 else (255, 0, 255), 3)
        cv2.imwrite(str(folder / f"{path.parent.name}_{path.stem}.png"), image[::-1])
        print(path.parent.name, path.stem, len(found.doors), "doors", found.rooms.max(), "rooms")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=Path, help="folder for a picture of every real map")
    arguments = parser.parse_args()
    if arguments.pictures:
        pictures(arguments.pictures)
    for line in run():
        print(line)
