"""What the verbs share that read frames: which part of a source, and how it is opened."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..core.camera.model import Camera
    from ..core.robots import FrameSource

__all__ = ["add_part", "opened_frames"]


def add_part(parser: argparse.ArgumentParser) -> None:
    """Options for a part of a recording, and for the times of a folder that has none."""
    parser.add_argument("--start", type=float, default=0.0, metavar="S", help="skip the first S seconds")
    parser.add_argument("--stop", type=float, default=float("inf"), metavar="S", help="stop after S seconds")
    parser.add_argument("--rate-Hz", type=float, dest="rate_Hz", help="rate of an image folder without times")


def opened_frames(args: Any, camera: Camera | None, *, grey: bool = False) -> FrameSource:
    """The frames of ``--source``, to be used as a context."""
    from ..io.frames.frames import open_source

    return open_source(
        args.source, camera=camera, start_s=args.start, stop_s=args.stop, rate_Hz=args.rate_Hz, grey=grey
    )
