"""``visuohaptic recording capture``: record depth images of a live camera with their poses.

reads
  --source   a depth camera: realsense:, realsense:SERIAL, orbbec: or orbbec:SERIAL
  --tag      number of an AprilTag 36h11 that lies flat in the scene; it gives the pose of every image
writes
  --out      a sequence folder for `visuohaptic reconstruct`: sequence.yaml, camera.yaml, poses.txt, depth/, color/

Print the tag with `visuohaptic template sheet`, lay it on the table, and move the camera around the scene so that the tag
stays visible. Images without the tag are skipped. The centre of the tag is the origin, z points up. Ctrl-C ends the
recording.

example: visuohaptic recording capture --source realsense: --tag 7 --size-m 0.08 --count 60 --out scan
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from threading import Event
from typing import Any

from .... import core, io, tracking
from ....core.errors import InputError
from ....io import depth
from ..._stop import signals

#: Metres of one unit of the depth images: a quarter of the cameras' own millimetre, up to 16 m.
_DEPTH_SCALE_M = 2.5e-4


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add(
        "--source",
        str,
        "depth camera: realsense: or orbbec:, with its serial number if there are several",
        required=True,
    )
    add("--tag", int, "number of the tag, 0..586", required=True, low=0, high=586)
    add(
        "--size-m", float, "side of the black border of the printed tag [m]", required=True, low=0, above=True
    )
    add("--out", Path, "new sequence folder", required=True)
    add("--count", 100, "number of images (100)", low=1)
    add("--every", 0.2, "time between stored images [s] (0.2)", metavar="S", low=0)


def run(args: Any) -> dict[str, Any]:
    """Record; returns the mapping that ``--json`` prints."""
    with depth.open_depth_camera(args.source) as source:
        maker = args.source.partition(":")[0]
        names = [camera.name for camera in io.find_cameras() if camera.address.startswith(args.source)]
        skipped = [0]
        stop = Event()
        # Between two images: the one that is being written would be lost, and the sequence unfinished.
        with signals(stop.set):
            views = _views(args, source, skipped, stop)
            if (first := next(views, None)) is None:
                raise InputError(
                    f"tag {args.tag}",
                    f"was not detected in {skipped[0]} images",
                    remedy="check --tag, and that the whole tag is visible in even light",
                )
            frames, sensor = chain([first], views), names[0] if names else maker
            count = depth.write_sequence(args.out, frames, sensor=sensor, depth_scale_m=_DEPTH_SCALE_M)
    args.report(f"{count} images in {args.out}, {skipped[0]} without the tag skipped")
    args.report(f"next: visuohaptic reconstruct {args.out} --out {args.out}_model")
    return {"folder": str(args.out), "frames": count, "skipped": skipped[0]}


def _views(
    args: Any, source: depth.LiveDepthSource, skipped: list[int], stop: Event
) -> Iterator[io.DepthFrame]:
    """Images with the pose of the camera in the frame of the tag, until there are enough or Ctrl-C."""
    import numpy as np

    # The y axis of the tag points down, its z axis into the paper; the z axis of the world points up.
    T_template_world = core.Pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    tag = tracking.Template.from_tag(args.tag, size_m=args.size_m)
    stored, last_s = 0, -np.inf
    with (
        tracking.TemplateTracker([tag], source.camera, threaded=False) as tracker,
        args.progress(args.count, "recording") as bar,
    ):
        while stored < args.count and not stop.is_set():
            image = source.read()
            (seen,) = tracker.update(core.Frame(image.color, image.t_s, image.index))
            if not seen.valid or seen.T_camera_template is None:
                skipped[0] += 1
                if not stored and skipped[0] > 20 * args.count:
                    return
                continue
            if image.t_s - last_s < args.every:
                continue
            stored, last_s = stored + 1, image.t_s
            bar.advance()
            yield image.posed((seen.T_camera_template @ T_template_world).inverse(), source.camera)
