"""``visuohaptic recording info``: summarise a recording.

reads   a video, a folder of images, an MCAP file (also a truncated one), or a map_server YAML file
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
    sequence = io.DepthSequence(path)
    frames = list(sequence)
    times = [frame.t_s for frame in frames]
    return {
        "file": str(path),
        "kind": "depth sequence",
        "frames": len(frames),
        "skipped": sequence.skipped,
        "start_s": min(times, default=0.0),
        "duration_s": max(times, default=0.0) - min(times, default=0.0),
        "width": sequence.camera.width,
        "height": sequence.camera.height,
    }


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
