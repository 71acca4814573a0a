"""``visuohaptic recording info``: summarise a recording.

reads   a video, a folder of images, an MCAP file (also a truncated one), a bag, the folder of a depth sequence (with the
        source of its poses, and the standard deviations of estimated ones), or a map_server YAML file
writes  nothing

Example: visuohaptic recording info run.mcap
"""

from __future__ import annotations

from argparse import Namespace
from typing import Any

from .... import core, io
from ....io import ros


def add_arguments(add: Any) -> None:
    """Arguments of the command."""
    add("file", str, "video, folder of images, MCAP or map YAML file")
    add("--rate-Hz", float, "frame rate of an image folder without times")


def run(args: Namespace) -> dict[str, Any]:
    """Summarise the recording; returns what is printed."""
    from pathlib import Path

    path = Path(args.file)
    if ros.is_bag(path):
        return _mcap(path)
    if path.suffix in (".yaml", ".yml"):
        return _map(path)
    if path.is_file():
        with path.open("rb") as stream:
            if stream.read(8) == b"\x89MCAP0\r\n":
                return _mcap(path)
    return _depth(path) if (path / "sequence.yaml").is_file() else _frames(args)


def _depth(path: Any) -> dict[str, Any]:
    import numpy as np

    sequence = io.DepthSequence(path)
    posed = sum(stamped.pose is not None for stamped in sequence.stamped)
    # Without any pose, no frame can be used, but its images are worth a summary.
    frames = sum(1 for _ in sequence) if posed else sum(one is not None for one in sequence.depth_images())
    times = sequence.times_s
    about = {
        "file": str(path),
        "kind": "depth sequence",
        "frames": frames,
        "skipped": sequence.skipped,
        "start_s": float(times.min()),
        "duration_s": float(times.max() - times.min()),
        "width": sequence.camera.width,
        "height": sequence.camera.height,
        "sensor": sequence.sensor,
        "poses": sequence.poses_source or "not stated",
        "without_pose": len(sequence) - posed,
    }
    if sequence.pose_sigma is not None and posed:
        median, largest = np.nanmedian(sequence.pose_sigma, axis=0), np.nanmax(sequence.pose_sigma, axis=0)
        about["pose_sigma_m"] = {"median": float(median[0]), "largest": float(largest[0])}
        about["pose_sigma_rad"] = {"median": float(median[1]), "largest": float(largest[1])}
    return about


def _mcap(path: Any) -> dict[str, Any]:
    file = ros.open_bag(path)
    topics = file.topics()
    start = min((topic.start_s for topic in topics), default=0.0)
    stop = max((topic.stop_s for topic in topics), default=0.0)
    return {
        "file": str(path),
        "kind": file.kind,
        "bytes": sum(part.stat().st_size for part in file.parts),
        "start_s": start,
        "duration_s": stop - start,
        "messages": sum(topic.messages for topic in topics),
        "damage": str(file.damage),
        "topics": [
            {"name": t.name, "type": t.datatype, "messages": t.messages, "bytes": t.bytes} for t in topics
        ],
    }


def _map(path: Any) -> dict[str, Any]:
    grid = io.OccupancyMap.load(path)
    return {
        "file": str(path),
        "kind": "map",
        "rows": grid.shape[0],
        "columns": grid.shape[1],
        "resolution_m": grid.resolution_m,
        "size_m": list(grid.size_m),
        "origin": list(grid.origin),
        "occupied": int(grid.occupied.sum()),
        "free": int(grid.free.sum()),
        "unknown": int(grid.unknown.sum()),
    }


def _frames(args: Namespace) -> dict[str, Any]:
    with io.open_source(args.file, rate_Hz=args.rate_Hz) as source:
        if not isinstance(source, io.RecordedSource):
            raise core.InputError(args.file, "is a live camera, expected a recording")
        first = next(iter(source))
        times = source.times_s
        return {
            "file": str(args.file),
            "kind": "folder" if "Folder" in type(source).__name__ else "video",
            "frames": source.frame_count,
            "missing": source.missing,
            "start_s": float(times[0]),
            "duration_s": float(times[-1] - times[0]),
            "width": first.image.shape[1],
            "height": first.image.shape[0],
            "colour": first.image.ndim == 3,
        }
