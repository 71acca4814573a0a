"""False alarms and first detection of obstacles on floors of an independent renderer.

``python -m benchmarks.scene_evidence --seeds open --count 4 --report scene.jsonl`` prints alarms per minute on free floors, and
the distance at which a box is first detected, by floor.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from tests.worlds import ground

from benchmarks._journal import Journal
from benchmarks._seeds import add_seeds, seeds_of
from visuohaptic.core import BaseState
from visuohaptic.core.camera import Camera, Frame, PlaneView, Pose
from visuohaptic.core.geometry import rotation_2d
from visuohaptic.sensing.scene import EgoMotionSettings, SceneSettings, SceneTracker

#: Objects on the floor of a drive.
KINDS = ("free", "shadow", "box", "plain")
#: Standard deviation of the odometry's scale.
WHEELS = 0.02
#: A distance of the box is right within this [m].
RIGHT_M = 0.03


def floor_view() -> PlaneView:
    """The simulated camera, as its user would calibrate it."""
    view = ground.View()
    camera = Camera(ground.WIDTH, ground.HEIGHT, view.matrix)
    return PlaneView(camera, Pose(view.rotation, view.origin_m))


def run_drive(floor: str, kind: str, seed: int) -> dict:
    """One drive, frame by frame: whether obstacles are read, distance [m] that is said, its sigma, and that of the box.

    The tracker sees the frames and the odometry, whose scale is wrong by :data:`WHEELS`; ``None``: nothing is said,
    or there is no box.
    """
    world = ground.drive(
        floor, seed, shadow=kind == "shadow", box=kind in ("box", "plain"), plain=kind == "plain"
    )
    view, edge_m = floor_view(), 0.05
    # Frame F is the plane of the foam's visible edge, above the world's axes.
    foam = view.T_camera_plane @ Pose(np.eye(3), np.array([0.0, 0.0, edge_m]))
    settings = SceneSettings(front_m=0.0, ego=EgoMotionSettings(foam_ahead_m=0.0))
    tracker, frames = SceneTracker(view.camera, foam, edge_m, settings), []
    scale = 1.0 + np.random.default_rng([37, seed]).normal(0.0, WHEELS)
    rates = scale * np.diff(world.poses, axis=0, prepend=world.poses[:1]) / ground.FRAME_S
    for i, (image, pose) in enumerate(zip(world.images(), world.poses, strict=True)):
        t_s = i * ground.FRAME_S
        x_m, y_m, yaw_rad = pose.tolist()
        state = BaseState(t_s, x_m, y_m, yaw_rad, float(np.hypot(*rates[i, :2])), float(rates[i, 2]))
        found = tracker.update(Frame(image, t_s, i), base_state=state).obstacle
        says = bool(found.valid and np.isfinite(found.proximity_m))
        frames.append(
            [
                bool(found.valid),
                float(found.proximity_m) if says else None,
                float(found.proximity_sigma_m) if says else None,
                _ahead_m(world.box, pose, found.y_m) if world.box is not None else None,
            ]
        )
    return {"floor": floor, "kind": kind, "frames": frames}


def _ahead_m(box: np.ndarray, pose: np.ndarray, y_m: float) -> float:
    """Range of the box's near face, which the drive turns away, along the platform's x at the lateral place that is said."""
    x, y, side = box
    ends = np.array([[x, y - side / 2], [x, y + side / 2]]) - pose[:2]
    ahead, aside = (ends @ rotation_2d(pose[2])).T
    return float(np.interp(0.0 if np.isnan(y_m) else y_m, aside, ahead))


def figures(rows: list[dict]) -> list[dict]:
    """Alarms a minute on free floors, and distance at which the box is first seen, by floor."""
    lines = []
    for floor in ground.FLOORS:
        for kind in KINDS:
            mine = [row["frames"] for row in rows if (row["floor"], row["kind"]) == (floor, kind)]
            if mine:
                lines.append(
                    {
                        "name": f"{floor}, {kind}",
                        **(_sight(mine) if kind in ("box", "plain") else _alarms(mine)),
                    }
                )
    return lines


def _alarms(drives: list[list]) -> dict:
    frames = [frame for drive in drives for frame in drive]
    alarms = sum(near is not None for _, near, _, _ in frames)
    read = sum(valid for valid, _, _, _ in frames)
    per_minute = 60 * alarms / (max(read, 1) * ground.FRAME_S)
    return {
        "ours": per_minute,
        "unit": "alarms a minute",
        "floor": 2.0,
        "aim": 0.2,
        "note": f"{alarms} frames of {read} that are read, of {len(frames)}",
    }


def _sight(drives: list[list]) -> dict:
    """The box counts as seen where the distance is right within its own error."""
    first = [
        max((x for _, near, _, x in drive if near is not None and abs(near - x) < RIGHT_M), default=0.0)
        for drive in drives
    ]
    said = np.array(
        [[near - x, sigma] for drive in drives for _, near, sigma, x in drive if near is not None]
    )
    wrong = np.abs(said[:, 0]) > RIGHT_M if len(said) else np.zeros(0)
    ratio = float(np.sqrt(np.mean((said[:, 0] / said[:, 1]) ** 2))) if len(said) else np.nan
    return {
        "ours": 100 * min(first),
        "unit": "cm, first seen at",
        "aim": 30.0,
        "higher_is_better": True,
        "note": f"{int(wrong.sum())} of {len(said)} distances are wrong; rms of error by sigma {ratio:.2f}",
    }


def campaign(
    *, seeds: str = "open", first: int = 0, count: int = 2, only: str = "", report: Path | None = None
) -> list[dict]:
    """Rows of all drives whose keys begin with ``only``; those in ``report`` are not run again."""
    journal = Journal(report, {"campaign": "scene_evidence", "seeds": seeds})
    rows = []
    for seed in seeds_of(seeds, count, first):
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
    add_seeds(parser, 2)
    parser.add_argument("--only", default="", help="what a key begins with, such as 'grass:box'")
    parser.add_argument("--report", type=Path, help="JSON lines; a stopped campaign goes on where it was")
    for line in figures(campaign(**vars(parser.parse_args()))):
        print(f"{line['name']}: {line['ours']:.3g} {line['unit']}  ({line['note']})")


if __name__ == "__main__":
    main()
