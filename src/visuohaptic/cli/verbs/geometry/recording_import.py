"""``visuohaptic recording import``: convert recorded depth images into a sequence folder.

reads   an MCAP file or rosbag2 bag with depth images, camera_info, and tf or a topic of poses;
        a folder with camera.json, cam.info.txt, camera_intrinsics.yaml or sequence.yaml (layouts arm, apc, cleargrasp,
        sequence);
        or any folder of 16-bit PNG or EXR depth images with --camera, --poses and --depth-scale-m
writes  sequence.yaml, camera.yaml, poses.txt, depth/ and color/ in the folder --out; with --poses odometry, poses that are
        estimated from the depth images of a scene at rest, and pose_sigma.txt with their standard deviations

example: visuohaptic recording import d435i_robot_arm --out scan
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .... import core, io
from ....core.camera import Camera
from ....core.files.plain_json import picked
from ....io import depth
from ....reconstruction import fusion, odometry


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("source", Path, "folder, MCAP file or bag to convert", metavar="PATH")
    add("--out", Path, "new sequence folder", required=True)
    add("--layout", "auto", "auto, arm, apc, cleargrasp, sequence or plain")
    add("--kind", "transparent", "which of a ClearGrasp pair: transparent or opaque")
    add("--camera", Path, "camera_info YAML file of a plain folder, or instead of a recording's")
    add(
        "--poses",
        str,
        "of a plain folder: TUM text, 4 x 4 text or MCAP; of a recording: tf, a topic or such a file (default: tf if it"
        " moves the camera, else the only topic of poses); of any source: odometry or none",
    )
    add(
        "--depth-topic",
        str,
        "depth images of a recording (default: the only ones, or those registered to colour)",
    )
    add(
        "--color-topic",
        str,
        "colour images of a recording, registered to the depth (default: by coordinate frame)",
    )
    add(
        "--depth-scale-m",
        float,
        "metres per unit of 16-bit depth (default: 0.001 in a recording); of a recording in metres, the unit to write (0.0001, up to 6.5 m)",
    )
    add("--bit-rotation", 0, "bits by which the 16-bit values are rotated (F200: 3)")


def needs(args: Any) -> set[str]:
    """Libraries beyond the core.

    Parameters
    ----------
    args
        As parsed.
    """
    return {"small_gicp"} if args.poses == "odometry" else set()


def run(args: Any) -> dict[str, Any]:
    """Import; returns the mapping that ``--json`` prints."""
    by_odometry = args.poses == "odometry"
    found = _imported(args, "none" if by_odometry else args.poses)
    for note in found.notes:
        args.report(note)
    if by_odometry:
        sequence = io.DepthSequence(found.folder)
        try:
            noise = fusion.sensor_noise(sequence.sensor)
        except core.InputError:
            noise = fusion.SENSOR_NOISE["kinect"]
        result = odometry.estimate_poses(list(sequence.depth_images()), sequence.camera, noise)
        depth.write_estimated_poses(found.folder, result.poses, f"odometry: {result.text}")
        args.report(result.text)
        found.notes.append(result.text)
    return picked(found, "folder layout frames skipped notes")


def _imported(args: Any, poses: str | None) -> io.ImportedSequence:
    if not depth.is_recording(args.source):
        args.refuse("--depth-topic --color-topic", f"{args.source} is not a recording with topics")
        return io.import_sequence(
            args.source,
            args.out,
            layout=args.layout,
            kind=args.kind,
            camera=args.camera,
            poses=poses,
            depth_scale_m=args.depth_scale_m,
            bit_rotation=args.bit_rotation,
        )
    args.refuse("--layout --kind --bit-rotation", f"does not apply to {args.source}, a recording")
    images = depth.BagImages(
        args.source,
        args.depth_topic,
        args.color_topic,
        Camera.load(args.camera) if args.camera else None,
        poses or "auto",
        args.depth_scale_m,
    )
    return depth.import_bag(images, args.out)
