"""``visuohaptic recording import``: convert third-party depth images into a sequence folder.

reads   a folder with camera.json, cam.info.txt or camera_intrinsics.yaml (layouts arm, apc, cleargrasp),
        or any folder of 16-bit PNG or EXR depth images with --camera, --poses and --depth-scale-m
writes  sequence.yaml, camera.yaml, poses.txt, depth/ and color/ in the folder --out

example: visuohaptic recording import d435i_robot_arm --out scan
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .... import io
from ....core.files.plain_json import picked


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("folder", Path, "folder to convert")
    add("--out", Path, "new sequence folder", required=True)
    add("--layout", "auto", "auto, arm, apc, cleargrasp or plain")
    add("--kind", "transparent", "which of a ClearGrasp pair: transparent or opaque")
    add("--camera", Path, "camera_info YAML file of a plain folder")
    add("--poses", Path, "TUM text, 4 x 4 text or MCAP of a plain folder")
    add("--depth-scale-m", float, "metres per unit of a plain folder")
    add("--bit-rotation", 0, "bits by which the 16-bit values are rotated (F200: 3)")


def run(args: Any) -> dict[str, Any]:
    """Import; returns the mapping that ``--json`` prints."""
    found = io.import_sequence(
        args.folder,
        args.out,
        layout=args.layout,
        kind=args.kind,
        camera=args.camera,
        poses=args.poses,
        depth_scale_m=args.depth_scale_m,
        bit_rotation=args.bit_rotation,
    )
    return picked(found, "folder layout frames skipped")
