"""A depth sequence folder from frames in memory: what a simulation or a live camera has seen."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ...core.camera.pose import Pose
from ...core.errors import InputError
from ...core.files import save_yaml
from .depth_images import write_depth
from .depth_sequence import DepthFrame
from .poses import write_poses

__all__ = ["write_sequence"]


def write_sequence(
    folder: Path | str,
    frames: Iterable[DepthFrame],
    *,
    sensor: str = "unknown",
    depth_scale_m: float = 1e-4,
) -> int:
    """Write a sequence folder that :class:`.DepthSequence` reads; tells the number of frames.

    Images are written as the frames come, the description last: a folder whose writer was stopped is no sequence.

    Parameters
    ----------
    folder
        A new or empty folder.
    frames
        Views of one camera, in order of time.
    sensor
        Name of the camera, by which its noise is known.
    depth_scale_m
        Metres of one unit; 0.1 mm reaches 6.5 m.

    Raises
    ------
    InputError
        The folder is not empty, there is no frame, or the frames are of several cameras.
    """
    folder = Path(folder)
    if folder.exists() and any(folder.iterdir() if folder.is_dir() else [folder]):
        raise InputError(folder, "is not empty", remedy="name a new folder")
    poses: list[tuple[float, Pose]] = []
    camera = None
    for index, frame in enumerate(frames):
        if camera is None:
            camera = frame.camera
            (folder / "depth").mkdir(parents=True)
        elif (frame.camera.width, frame.camera.height) != (camera.width, camera.height):
            raise InputError("write_sequence", f"frame {index} is of another camera, expected one camera")
        name = f"{index:06d}.png"
        write_depth(folder / "depth" / name, frame.depth_m, depth_scale_m)
        if frame.color is not None:
            _write_color(folder / "color" / name, frame)
        poses.append((frame.t_s, frame.T_world_camera))
    if camera is None:
        raise InputError("write_sequence", "found no frames, expected at least one")
    camera.save(folder / "camera.yaml")
    write_poses(folder / "poses.txt", poses)
    save_yaml(
        folder / "sequence.yaml",
        {"sensor": sensor, "depth_scale_m": depth_scale_m, "camera": "camera.yaml"},
    )
    return len(poses)


def _write_color(path: Path, frame: DepthFrame) -> None:
    import cv2

    from ...core.files import atomic_path

    path.parent.mkdir(exist_ok=True)
    with atomic_path(path) as temporary:
        temporary.write_bytes(cv2.imencode(".png", frame.color)[1].tobytes())
