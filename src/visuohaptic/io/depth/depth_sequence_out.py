"""Writing of a depth sequence folder from frames in memory, simulated or from a live camera."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from ...core.errors import InputError
from ...core.files import PartFile, load_yaml_model, save_yaml, whole_lines, write_image, write_text
from .depth_images import MAX_UNITS, write_depth
from .depth_sequence import NO_POSES, DepthFrame, DepthSequence, SequenceFile
from .poses import POSE_HEADER, EstimatedPose, pose_line, read_poses

_log = logging.getLogger(__name__)

#: Name of the description until the sequence is complete.
DESCRIPTION_PART = "sequence.yaml.part"
#: Standard deviations of estimated poses, and the first line of the file.
SIGMA_FILE, SIGMA_HEADER = "pose_sigma.txt", "# sigma_m sigma_rad, per axis; nan: no pose\n"


def write_sequence(
    folder: Path | str,
    frames: Iterable[DepthFrame],
    *,
    sensor: str = "unknown",
    depth_scale_m: float = 1e-4,
    poses_source: str = "",
) -> int:
    """Write a sequence folder that :class:`.DepthSequence` reads; returns the number of frames.

    Each frame is passed to the operating system before the next one is taken. The description is renamed last: a folder
    whose writer was interrupted becomes a valid sequence by ``visuohaptic recording recover``.

    Parameters
    ----------
    folder
        A new or empty folder.
    frames
        Views of one camera, in temporal order.
    sensor
        Name of the sensor, which selects its noise model.
    depth_scale_m
        Size of one unit [m]; 0.1 mm reaches 6.5 m.
    poses_source
        Where the poses come from; with ``none``, those of the frames are not written.

    Raises
    ------
    InputError
        The folder is not empty, there are no frames, or the frames are from different cameras.
    """
    folder = Path(folder)
    if (folder / DESCRIPTION_PART).exists():
        raise InputError(
            folder,
            "contains a sequence that was not completed",
            remedy=f"run: visuohaptic recording recover {folder}, or choose a new folder",
        )
    if folder.exists() and any(folder.iterdir() if folder.is_dir() else [folder]):
        raise InputError(folder, "is not empty", remedy="choose a new folder")
    camera = poses = None
    count = beyond = 0
    for index, frame in enumerate(frames):
        if camera is None or poses is None:
            camera = frame.camera
            (folder / "depth").mkdir(parents=True)
            camera.save(folder / "camera.yaml")
            about = {"sensor": sensor, "depth_scale_m": depth_scale_m, "camera": "camera.yaml"}
            source = {"poses_source": poses_source} if poses_source else {}
            save_yaml(folder / DESCRIPTION_PART, about | source)
            poses = PartFile(folder / "poses.txt")
            poses.write(POSE_HEADER.encode())
        elif (frame.camera.width, frame.camera.height) != (camera.width, camera.height):
            raise InputError("write_sequence", f"frame {index} is of another camera, expected one camera")
        name = f"{index:06d}.png"
        write_depth(folder / "depth" / name, frame.depth_m, depth_scale_m)
        beyond += int(np.count_nonzero(frame.depth_m > MAX_UNITS * depth_scale_m))
        if frame.color is not None:
            (folder / "color").mkdir(exist_ok=True)
            write_image(folder / "color" / name, frame.color)
        pose = None if poses_source == NO_POSES else frame.T_world_camera
        poses.write(pose_line(frame.t_s, pose).encode())
        count += 1
    if poses is None:
        raise InputError("write_sequence", "found no frames, expected at least one")
    poses.finish()
    (folder / DESCRIPTION_PART).replace(folder / "sequence.yaml")
    if beyond and camera is not None:
        share, limit_m = beyond / (count * camera.width * camera.height), MAX_UNITS * depth_scale_m
        said = "%s: %.3g %% of the pixels are farther than %.3g m, the largest depth in units of %g m, and are left out"
        _log.warning(said, folder, 100 * share, limit_m, depth_scale_m)
    return count


def recover_sequence(folder: Path) -> int:
    """Complete a sequence left by an interrupted :func:`write_sequence`; returns the number of frames.

    Images without a pose are kept as ``NAME.part``.

    Parameters
    ----------
    folder
        The folder.

    Raises
    ------
    InputError
        The sequence is already complete, or contains no frame.
    """
    if not (folder / DESCRIPTION_PART).is_file():
        raise InputError(folder, "is not an interrupted depth sequence")
    part = folder / "poses.txt.part"
    if part.exists():
        lines = whole_lines(part)[1:]
        if not lines:
            raise InputError(folder, "contains no complete frame")
        for path in sorted(folder.glob("*/*.png")):
            if path.stem.isdecimal() and int(path.stem) >= len(lines):
                path.rename(path.with_name(path.name + ".part"))
        write_text(folder / "poses.txt", POSE_HEADER + "".join(f"{line}\n" for line in lines))
        part.unlink()
    count = len(read_poses(folder / "poses.txt"))
    (folder / DESCRIPTION_PART).replace(folder / "sequence.yaml")
    return count


def write_estimated_poses(folder: Path | str, poses: Sequence[EstimatedPose], source: str) -> None:
    """Give a complete sequence folder estimated poses with their standard deviations; the previous poses are replaced.

    Parameters
    ----------
    folder
        Sequence folder.
    poses
        One for each depth image, in name order.
    source
        How they were estimated, for the description.

    Raises
    ------
    InputError
        It is not a sequence folder, or has another number of images.
    """
    folder = Path(folder)
    sequence = DepthSequence(folder)
    if len(poses) != len(sequence):
        raise InputError(folder, f"has {len(sequence)} images, expected one for each of {len(poses)} poses")
    lines = [pose_line(t_s, one.pose) for t_s, one in zip(sequence.times_s, poses, strict=True)]
    sigmas = [f"{one.sigma_m:.6g} {one.sigma_rad:.6g}\n" for one in poses]
    known = load_yaml_model(folder / "sequence.yaml", SequenceFile)
    known = known.model_copy(
        update={"poses": "poses.txt", "poses_topic": None, "poses_source": source, "pose_sigma": SIGMA_FILE}
    )
    # The description is written last: until then, it states that there are no poses.
    write_text(folder / SIGMA_FILE, SIGMA_HEADER + "".join(sigmas))
    write_text(folder / "poses.txt", POSE_HEADER + "".join(lines))
    save_yaml(folder / "sequence.yaml", known.model_dump(exclude_unset=True))
