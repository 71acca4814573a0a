"""``visuohaptic calibrate camera``: estimate intrinsics and distortion from images of a board.

reads   a folder of images, a video or an MCAP file
writes  a ROS camera_info YAML file

Prints every parameter with its standard deviation. Images that cannot give a good calibration are refused, with
the reason.

Example: visuohaptic calibrate camera photos/ --squares 9x6 --square-mm 25 --marker-mm 18 --out camera.yaml
"""

from __future__ import annotations

import re
from argparse import Namespace
from contextlib import nullcontext, suppress
from dataclasses import replace
from typing import Any

from .... import core, io
from ....core import camera
from ..._sensor_run import is_live


def add_arguments(add: Any) -> None:
    """Arguments of the command."""
    add("source", str, "folder of images, video, file.mcap[:/topic], or a camera until Ctrl-C (with --every)")
    add("--squares", str, "squares of the board, as 9x6", required=True, metavar="COLUMNSxROWS")
    add("--square-mm", float, "edge of a square on the print [mm]", required=True)
    add("--marker-mm", float, "edge of a ChArUco marker [mm]; without it the board is a chessboard")
    add("--dictionary", "DICT_4X4_250", "ArUco dictionary (default: %(default)s)")
    add("--every", 0.0, "use one frame per S seconds of a video", metavar="S")
    add("--max-rms-px", 0.6, "maximum residual [px]; a larger one is an error (default: %(default)s)")
    add(
        "--transfer-function",
        "unknown",
        "encoding of light as grey levels, if known; srgb is any gamma of about 2.2 (default: %(default)s)",
        choices=("linear", "srgb", "unknown"),
    )
    add("--name", "camera", "name of the camera (default: %(default)s)")
    add("--out", str, "ROS camera_info YAML file to write", required=True)


def run(args: Namespace) -> dict[str, Any]:
    """Detect, fit, write; returns what is printed."""
    squares = re.fullmatch(r"([0-9]{1,4})x([0-9]{1,4})", args.squares.lower())
    if squares is None:
        raise core.InputError(
            "--squares", f"found {core.brief(args.squares)}, expected COLUMNSxROWS, such as 9x6"
        )
    marker = None if args.marker_mm is None else args.marker_mm * 1e-3
    board = camera.Board(int(squares[1]), int(squares[2]), args.square_mm * 1e-3, marker, args.dictionary)
    views = []
    size = (0, 0)
    next_s = -float("inf")
    # The time stamps of a folder of photos are ignored.
    # A live camera has no end: Ctrl-C ends the acquisition.
    ends = suppress(KeyboardInterrupt) if is_live(args.source) else nullcontext()
    with (
        io.open_source(args.source, rate_Hz=None if is_live(args.source) else 1.0, grey=True) as source,
        ends,
    ):
        for frame in source:
            if frame.t_s < next_s:
                continue
            next_s = frame.t_s + args.every
            size = (frame.image.shape[1], frame.image.shape[0])
            views.append(camera.detect_board(frame.image, board, f"image {frame.index}"))
    result = camera.calibrate_camera(
        views, board, size, limits=camera.CalibrationLimits(max_rms_px=args.max_rms_px), name=args.name
    )
    replace(result.camera, transfer_function=args.transfer_function).save(args.out)
    return {"out": str(args.out), **result.summary()}
