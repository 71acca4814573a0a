"""``visuohaptic recording import``: a sequence folder from third-party depth images.

reads   a folder with camera.json, cam.info.txt or camera_intrinsics.yaml (layouts arm, apc, cleargrasp),
        or any folder of 16-bit PNG or EXR depth with --camera, --poses and --depth-scale-m
writes  sequence.yaml, camera.yaml, poses.txt, depth/ and color/ in the folder --out

example: visuohaptic recording import d435i_robot_arm --out scan
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("folder", type=Path, help="the foreign folder")
    parser.add_argument("--out", type=Path, required=True, help="new sequence folder")
    parser.add_argument("--layout", default="auto", help="auto, arm, apc, cleargrasp or plain")
    parser.add_argument("--kind", default="transparent", help="of ClearGrasp pairs: transparent or opaque")
    parser.add_argument("--camera", type=Path, help="camera_info YAML file of a plain folder")
    parser.add_argument("--poses", type=Path, help="TUM text, 4 x 4 text or MCAP of a plain folder")
    parser.add_argument("--depth-scale-m", type=float, help="metres of one unit of a plain folder")
    parser.add_argument(
        "--bit-rotation", type=int, default=0, help="bits by which the words are rotated (F200: 3)"
    )


def run(args: Any) -> dict[str, Any]:
    """Import; the mapping is what ``--json`` prints."""
    from ....io.depth.depth_import import import_sequence

    found = import_sequence(
        args.folder,
        args.out,
        layout=args.layout,
        kind=args.kind,
        camera=args.camera,
        poses=args.poses,
        depth_scale_m=args.depth_scale_m,
        bit_rotation=args.bit_rotation,
    )
    return {
        "folder": str(found.folder),
        "layout": found.layout,
        "frames": found.frames,
        "skipped": found.skipped,
    }
