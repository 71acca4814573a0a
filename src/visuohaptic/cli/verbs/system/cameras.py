"""``visuohaptic cameras``: list the cameras that are connected.

reads   the devices of this machine; RealSense and Orbbec cameras with the extras realsense and orbbec
writes  nothing; prints one address per camera, which every --source accepts

A --source may also be part of a camera's name (camera:NAME), /dev/video0, rtsp://host/path, realsense:, orbbec:
or a recording.

example: visuohaptic cameras
"""

from __future__ import annotations

from typing import Any

from .... import io


def add_arguments(add: Any) -> None:
    """No arguments of its own."""


def run(args: Any) -> dict[str, Any]:
    """Run the verb; returns the mapping that ``--json`` prints."""
    found = io.find_cameras()
    for camera in found:
        args.report(f"{camera.address:<24}{camera.name}")
    if not found:
        args.report(
            "no camera found; check the cable, and on Linux that you may read /dev/video* (group 'video')"
        )
    return {"cameras": [{"address": camera.address, "name": camera.name} for camera in found]}
