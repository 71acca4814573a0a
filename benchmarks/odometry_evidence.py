"""Poses of depth sequences without poses, in an independent ray caster (``tests/worlds/ray_scenes.py``) and of real sequences.

    python -m benchmarks.odometry_evidence --seeds open --count 4 --cache scenes --report out.json
                                      prints errors, declared errors and refusals of each kind of sequence

A hand walks around a table, 24 to 60 views of 320 x 240 px: three to six opaque objects, four of them and one clear vessel, a single can, or a
bare table. Errors are those of the camera centres relative to the first view; declared is sqrt(3) times the standard deviation per axis. A
sequence without poses is refused as a whole; one with an error of more than 10 mm is wrong, whatever it declares.

``--real``: the sequences of ``../shared/data/geometry`` that come with poses of a robot arm or a tracker, which are dropped.
The odd half of the seeds is closed. An interrupted campaign is continued.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from tests.worlds.ray_scenes import FAMILIES, sequence

from visuohaptic.core.camera import Camera
from visuohaptic.core.files import write_text
from visuohaptic.io.depth import DepthSequence
from visuohaptic.reconstruction import sequence_noise
from visuohaptic.reconstruction.fusion import DepthNoise, sensor_noise
from visuohaptic.reconstruction.odometry import estimate_poses

from ._journal import Journal
from ._seeds import add_seeds, seeds_of
from .harness import use_one_thread
from .transparency import real_frames

#: Error of a camera centre from which poses are wrong: as much as half of a small vessel's radius [m].
WRONG_M = 0.01
#: Real sequences, and maximum number of their views, as many as of the longest cast one.
REAL, VIEWS = ("d435i_robot_arm", "apc_f200_shelf"), 60


def compared(
    depths_m: Sequence[np.ndarray], true: np.ndarray, camera: Camera, noise: DepthNoise
) -> dict[str, Any]:
    """Estimated poses against the true ones (views, 4, 4)."""
    started = time.process_time()
    found = estimate_poses(depths_m, camera, noise)
    poses = [one.pose and one.pose.matrix for one in found.poses]
    posed = [k for k, pose in enumerate(poses) if pose is not None]
    first = poses[posed[0]] @ np.linalg.inv(true[posed[0]])
    away, turn = [], []
    for k in posed[1:]:
        off = np.linalg.inv(first @ true[k]) @ poses[k]
        away.append(float(np.linalg.norm(off[:3, 3])))
        turn.append(float(np.arccos(np.clip(0.5 * (np.trace(off[:3, :3]) - 1), -1, 1))))
    return {
        "views": len(true),
        "posed": len(posed) / len(true),
        "error_m": away,
        "turn_rad": turn,
        "sigma_m": [float(found.poses[k].sigma_m) for k in posed[1:]],
        "text": found.text,
        "cpu_s": time.process_time() - started,
    }


def cast(seed: int, cache: Path | None) -> dict[str, Any]:
    """A sequence of the ray caster."""
    scene = sequence("walk", seed, cache)
    camera = Camera(scene.camera.width, scene.camera.height, scene.camera.matrix)
    told = compared(list(scene.depth_m), scene.T_world_camera, camera, sensor_noise("realsense_d435"))
    return {"kind": scene.kind, **told}


def real(name: str) -> dict[str, Any]:
    """A real sequence whose poses are dropped."""
    with TemporaryDirectory() as folder:
        frames = real_frames(name, Path(folder))[:VIEWS]
        noise = sequence_noise(DepthSequence(Path(folder) / name))
    true = np.array([frame.T_world_camera.matrix for frame in frames])
    depths_m = [frame.depth_m for frame in frames]
    return {"kind": name, **compared(depths_m, true, frames[0].camera, noise)}


def figures(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Share of sequences with poses, errors, and errors by what is declared, of each kind."""
    found: list[dict[str, Any]] = []
    for kind in [kind for kind in (*FAMILIES["walk"], *REAL) if any(row["kind"] == kind for row in rows)]:
        of = [row for row in rows if row["kind"] == kind]
        told = [row for row in of if row["error_m"]]
        rms = [1e3 * float(np.sqrt(np.mean(np.square(row["error_m"])))) for row in told]
        said = [1e3 * float(np.sqrt(3 * np.mean(np.square(row["sigma_m"])))) for row in told]
        most = [1e3 * max(row["error_m"]) for row in told]
        wrong = sum(error > 1e3 * WRONG_M for error in most)
        # A table without anything on it, or with a body that looks alike from all sides, may be refused.
        hard = kind in ("can", "bare")
        low = {"unit": "1", "higher_is_better": False}
        found += [
            {"name": f"{kind}: sequences with poses", "ours": len(told) / len(of), "unit": "1",
             "floor": 0.0 if hard else 0.9, "aim": 1.0, "note": f"{len(of)} sequences"},
            {"name": f"{kind}: sequences with wrong poses", "ours": wrong / len(of), "floor": 0.0, "aim": 0.0, **low,
             "note": f"{wrong} of {len(of)}"},
        ]  # fmt: skip
        if told:
            ratio = [error / declared for error, declared in zip(rms, said, strict=True)]
            found += [
                {"name": f"{kind}: rms error", "ours": float(np.median(rms)), **low, "unit": "mm", "floor": 2.0, "aim": 1.0,
                 "note": f"largest of a view {max(most):.2f} mm, rms {', '.join(f'{one:.2f}' for one in rms)}"},
                {"name": f"{kind}: rms error / declared", "ours": float(np.median(ratio)), **low, "floor": 1.6,
                 "aim": 1.3, "note": ", ".join(f"{one:.2f}" for one in ratio)},
            ]  # fmt: skip
    return found


def run() -> list[dict[str, Any]]:
    """A slice: one open sequence of opaque objects."""
    return figures([cast(0, None)])


def main() -> None:
    """Run the campaign."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_seeds(parser, 8, "sequences")
    parser.add_argument("--real", action="store_true", help="the real sequences instead")
    parser.add_argument("--cache", type=Path, help="folder that keeps rendered sequences")
    parser.add_argument("--report", type=Path, help="JSON with all rows and figures")
    arguments = parser.parse_args()
    use_one_thread()
    what = "real" if arguments.real else arguments.seeds
    journal = arguments.report and arguments.report.with_name(f"{arguments.report.stem}_{what}.jsonl")
    done = Journal(journal, {"campaign": "odometry"})
    chosen = REAL if arguments.real else seeds_of(arguments.seeds, arguments.count, arguments.first)
    for one in map(str, chosen):
        if one not in done:
            done.put(one, real(one) if arguments.real else cast(int(one), arguments.cache))
        print(f"{one}: {done.rows[one]['kind']}, {done.rows[one]['text']}", flush=True)
    rows = [done.rows[str(one)] for one in chosen]
    told = figures(rows)
    for row in told:
        limits = f"floor {row['floor']}  aim {row['aim']}"
        print(f"{row['name']:44s} {row['ours']:7.3f} {row['unit']:3s} {limits}  {row['note']}")
    if arguments.report:
        write_text(arguments.report, json.dumps({"rows": rows, "figures": told}, indent=1) + "\n")


if __name__ == "__main__":
    main()
