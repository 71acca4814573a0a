"""False alarms and first sight of obstacles on floors of an independent renderer.

``python -m benchmarks.scene_evidence --seeds open --count 4 --report scene.jsonl``
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from tests.worlds import ground

from benchmarks._journal import Journal
from visuohaptic.core.camera import Camera, PlaneView, Pose
from visuohaptic.sensing.scene import ObstacleDetector

#: What a drive has on its floor.
KINDS = ("free", "shadow", "box")
#: A distance of the box is right within this [m].
RIGHT_M = 0.03


def floor_view() -> PlaneView:
    """The world's camera, as its user would calibrate it."""
    view = ground.View()
    camera = Camera(ground.WIDTH, ground.HEIGHT, view.matrix)
    return PlaneView(camera, Pose(view.rotation, view.origin_m))


def run_drive(floor: str, kind: str, seed: int) -> dict:
    """Frames of one drive: distance that the detector says, and that of the box [m]; ``None`` without."""
    world = ground.drive(floor, seed, shadow=kind == "shadow", box=kind == "box")
    detector, frames = ObstacleDetector(floor_view(), 0.0), []
    for image, pose in zip(world.images(), world.poses, strict=True):
        found = detector.update(image)
        near = float(found.proximity_m) if found.valid and np.isfinite(found.proximity_m) else None
        frames.append([near, float(world.box[0] - pose[0]) if world.box is not None else None])
    return {"floor": floor, "kind": kind, "frames": frames}


def figures(rows: list[dict]) -> list[dict]:
    """Alarms a minute on free floors, and distance at which the box is first seen, by floor."""
    lines = []
    for floor in ground.FLOORS:
        for kind in KINDS:
            mine = [row["frames"] for row in rows if (row["floor"], row["kind"]) == (floor, kind)]
            if mine:
                lines.append(
                    {"name": f"{floor}, {kind}", **(_sight(mine) if kind == "box" else _alarms(mine))}
                )
    return lines


def _alarms(drives: list[list]) -> dict:
    frames = [near for drive in drives for near, _ in drive]
    alarms = sum(near is not None for near in frames)
    per_minute = 60 * alarms / (len(frames) * ground.FRAME_S)
    return {
        "ours": per_minute,
        "unit": "alarms a minute",
        "floor": 2.0,
        "aim": 0.2,
        "note": f"{alarms} of {len(frames)} frames",
    }


def _sight(drives: list[list]) -> dict:
    """The box counts as seen where the distance is right within its own error."""
    first = [
        max((x for near, x in drive if near is not None and abs(near - x) < RIGHT_M), default=0.0)
        for drive in drives
    ]
    near = sum(near is not None and near < x - RIGHT_M for drive in drives for near, x in drive)
    return {
        "ours": 100 * min(first),
        "unit": "cm, first seen at",
        "aim": 30.0,
        "higher_is_better": True,
        "note": f"{near} of {sum(map(len, drives))} frames say that it is nearer than it is",
    }


def campaign(
    *, seeds: str = "open", count: int = 2, only: str = "", report: Path | None = None
) -> list[dict]:
    """Rows of all drives whose keys begin with ``only``; those in ``report`` are not run again."""
    journal = Journal(report, {"campaign": "scene_evidence", "seeds": seeds})
    rows = []
    for seed in (2 * i + (seeds == "closed") for i in range(count)):
        for floor in ground.FLOORS:
            for kind in KINDS:
                key = f"{floor}:{kind}:{seed}"
                if not key.startswith(only):
                    continue
                if key not in journal:
                    journal.put(key, run_drive(floor, kind, seed))
                rows.append(journal.rows[key])
    return rows


def run() -> list[dict]:
    """Rows of the table: closed seeds."""
    return figures(campaign(seeds="closed"))


def main() -> None:
    """Run the campaign and print its figures."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.scene_evidence", description=__doc__)
    parser.add_argument("--seeds", choices=("open", "closed"), default="open")
    parser.add_argument("--count", type=int, default=2, help="seeds")
    parser.add_argument("--only", default="", help="what a key begins with, such as 'grass:box'")
    parser.add_argument("--report", type=Path, help="JSON lines; a stopped campaign goes on where it was")
    for line in figures(campaign(**vars(parser.parse_args()))):
        print(f"{line['name']}: {line['ours']:.3g} {line['unit']}  ({line['note']})")


if __name__ == "__main__":
    main()
