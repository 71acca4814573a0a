"""Corrupted depth sequences: each has to give a clear error, or frames that are left out and counted; no crash.

python -m benchmarks.sequence_faults --count 200    prints how many crashed, were accepted silently, or had an unclear error
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from visuohaptic.core import InputError
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.core.files import save_yaml
from visuohaptic.io.depth import DepthSequence, write_depth, write_poses

from .map_fuzz import SEED, fuzz_arguments

FRAMES = 6

Rng = np.random.Generator


def whole(folder: Path, rng: Rng) -> None:
    """A good sequence: a wall with steps, seen by a camera that moves by centimetres."""
    (folder / "depth").mkdir(parents=True)
    Camera.simple(64, 48, 60.0).save(folder / "camera.yaml")
    poses = []
    for k in range(FRAMES):
        depth = (
            0.8
            + 0.3 * (np.add.outer(np.arange(48), np.arange(64)) // 16 % 3)
            + rng.normal(0, 0.002, (48, 64))
        )
        depth[rng.random(depth.shape) < 0.1] = np.nan
        write_depth(folder / "depth" / f"{k:06d}.png", depth)
        poses.append((k / 30, Pose.from_rotation_vector(rng.normal(0, 0.02, 3), [0.02 * k, 0, 0])))
    write_poses(folder / "poses.txt", poses)
    save_yaml(folder / "sequence.yaml", {"sensor": "test", "depth_scale_m": 0.001})


def _picture(folder: Path, rng: Rng) -> Path:
    return folder / "depth" / f"{int(rng.integers(FRAMES)):06d}.png"


def missing_frame(folder: Path, rng: Rng) -> None:
    """One or several images are missing."""
    for _ in range(int(rng.integers(1, 4))):
        _picture(folder, rng).unlink(missing_ok=True)


def wrong_size(folder: Path, rng: Rng) -> None:
    """An image of another camera."""
    shape = (int(rng.integers(1, 90)), int(rng.choice([1, 32, 63, 65, 128])))
    write_depth(_picture(folder, rng), np.full(shape, 1.0))


def nan_poses(folder: Path, rng: Rng) -> None:
    """Poses with NaN or infinite numbers, or an invalid rotation."""
    path = folder / "poses.txt"
    lines = path.read_text().splitlines()
    line = int(rng.integers(1, len(lines)))
    words = lines[line].split()
    kind = int(rng.integers(4))
    if kind == 0:
        words[int(rng.integers(1, 8))] = str(rng.choice(["nan", "inf", "-inf"]))
    elif kind == 1:
        words[4:] = ["0", "0", "0", "0"]
    elif kind == 2:
        words[4:] = ["1", "2", "3", "4"]
    else:
        words = words[: int(rng.integers(1, 8))]
    lines[line] = " ".join(words)
    path.write_text("\n".join(lines))


def scale_off(folder: Path, rng: Rng) -> None:
    """Depth or poses in another unit."""
    if rng.random() < 0.7:
        scale = float(rng.choice([1.0, 1e-6]))
        save_yaml(folder / "sequence.yaml", {"sensor": "test", "depth_scale_m": scale})
    else:
        poses = [(k / 30, Pose(np.eye(3), np.array([20.0 * k, 0, 0]))) for k in range(FRAMES)]
        write_poses(folder / "poses.txt", poses)


def cut_png(folder: Path, rng: Rng) -> None:
    """A truncated image, or one with a changed byte."""
    path = _picture(folder, rng)
    data = bytearray(path.read_bytes())
    if rng.random() < 0.7:
        data = data[: int(rng.integers(len(data)))]
    else:
        data[int(rng.integers(len(data)))] ^= int(rng.integers(1, 256))
    path.write_bytes(bytes(data))


FAULTS: tuple[Callable[[Path, Rng], None], ...] = (missing_frame, wrong_size, nan_poses, scale_off, cut_png)


def campaign(count: int, seed: int = SEED) -> list[dict[str, Any]]:
    """Outcome of each corrupted sequence: refused, counted, silent or crashed."""
    found = []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        fault = FAULTS[number % len(FAULTS)]
        with tempfile.TemporaryDirectory() as root:
            folder = Path(root) / "scan"
            whole(folder, rng)
            fault(folder, rng)
            text = ""
            try:
                sequence = DepthSequence(folder)
                frames = sum(1 for _ in sequence)
                lost = sum(sequence.skipped.values()) + sequence.missing
                outcome = "counted" if lost and frames + lost == FRAMES else "silent"
                text = "; ".join(sequence.problems)
            except InputError as error:
                outcome, text = "refused", str(error)
            except Exception as error:  # noqa: BLE001 - these are counted
                outcome, text = "crashed", f"{type(error).__name__}: {error}"
            if outcome == "refused" and ("\n" in text or len(text) > 1000):
                outcome = "unclear"
        found.append({"fault": fault.__name__, "outcome": outcome, "text": text.replace(root, "")})
    return found


def run(count: int = 200, seed: int = SEED) -> list[dict[str, Any]]:
    """Rows of the table."""
    found = [entry["outcome"] for entry in campaign(count, seed)]
    return [
        {
            "name": f"corrupted sequences: {outcome}",
            "ours": float(found.count(outcome)),
            "unit": f"of {count}",
            "floor": 0.0,
            "aim": 0.0,
            "higher_is_better": False,
            "note": f"{found.count('refused')} refused, {found.count('counted')} with frames left out",
        }
        for outcome in ("crashed", "silent", "unclear")
    ]


if __name__ == "__main__":
    arguments = fuzz_arguments(__doc__)
    if arguments.verbose:
        for entry in campaign(arguments.count, arguments.seed):
            print(f"{entry['fault']:<14}{entry['outcome']:<9}{entry['text'][:160]}")
    for line in run(arguments.count, arguments.seed):
        print(line)
