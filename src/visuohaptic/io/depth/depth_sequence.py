"""A folder of depth images with camera poses.

=================  ====================================================================
``sequence.yaml``  ``sensor``, ``depth_scale_m``, ``camera: camera.yaml``; see
                   :class:`SequenceFile` for optional fields
``camera.yaml``    ROS ``camera_info``
``depth/``         16-bit PNG or EXR, in the order of their times in seconds, if the names end in them, or of their names
``color/``         optional, registered to the depth, same names or same count
``poses.txt``      TUM text (``t tx ty tz qx qy qz qw``), camera to world
``pose_sigma.txt`` optional, of estimated poses: ``sigma_m sigma_rad`` of each
=================  ====================================================================
"""

from __future__ import annotations

import logging
import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float, Float32, UInt8
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from ...core import Camera, InputError, Pose, load_yaml_model, read_image
from ...core.errors import brief
from ...core.resources import memory_bytes
from ..image_folder import natural, seconds_in
from ._conventions import check_conventions, compared
from .depth_images import DEPTH_SUFFIXES, DepthEncoding, read_depth
from .poses import StampedPose, interpolate_pose, number_rows, read_poses

_log = logging.getLogger(__name__)

_COLOR_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp"}
_NUMBER = re.compile(r"(\d+)\D*$")
#: If the camera moves farther between frames than this multiple of the depth, no point is seen twice: wrong unit.
_STEP_PER_DEPTH = 4.0
#: Memory that a reconstruction takes for a pixel of every view [bytes]: the frames are 7, the rest copies of the search;
#: measured by its peak, the same with 24 and with 64 views.
_PIXEL_BYTES = 36
#: ``poses_source`` of a sequence whose poses are not known.
NO_POSES = "none"


@dataclass(frozen=True, slots=True, eq=False)
class DepthFrame:
    """One view of a depth camera."""

    t_s: float  #: time [s]
    depth_m: Float32[np.ndarray, "rows columns"]  #: along the optical axis [m]; NaN: not measured
    color: UInt8[np.ndarray, "rows columns 3"] | None  #: blue, green, red; registered to the depth
    T_world_camera: Pose
    camera: Camera
    index: int = 0  #: index of the frame in its sequence

    def __post_init__(self) -> None:
        expected = (self.camera.height, self.camera.width)
        if self.depth_m.shape != expected or self.depth_m.dtype != np.float32:
            raise InputError(
                "DepthFrame",
                f"found {self.depth_m.dtype} of shape {self.depth_m.shape}, expected float32 {expected}",
                field="depth_m",
            )
        if self.color is not None and (self.color.shape != (*expected, 3) or self.color.dtype != np.uint8):
            raise InputError(
                "DepthFrame",
                f"found {self.color.dtype} of shape {self.color.shape}, expected uint8 {(*expected, 3)}",
                field="color",
            )


class SequenceFile(BaseModel):
    """Fields of ``sequence.yaml``."""

    model_config = ConfigDict(extra="forbid")
    sensor: Annotated[str, Field(max_length=200)] = (
        "unknown"  #: name of the sensor, which selects its noise model
    )
    depth_scale_m: Annotated[FiniteFloat, Field(gt=0)]  #: size of one unit [m]
    camera: str = "camera.yaml"  #: file of the camera model
    depth: str = "depth"  #: folder of the depth images
    color: str = "color"  #: folder of the colour images
    poses: str = "poses.txt"  #: TUM text, 4 x 4 text or MCAP
    poses_topic: str | None = None  #: topic of an MCAP file
    #: where the poses come from; ``none``: there are none
    poses_source: Annotated[str, Field(max_length=1000)] = ""
    pose_sigma: str | None = None  #: standard deviations of estimated poses: text, a line for each pose
    bit_rotation: Annotated[int, Field(ge=0, lt=16)] = 0  #: RealSense F200: 3
    invalid: Annotated[list[int], Field(max_length=16)] = [0, 65535]  #: values that mean "not measured"
    min_depth_m: Annotated[FiniteFloat, Field(ge=0)] = 0.05  #: nearer values are ignored
    max_depth_m: Annotated[FiniteFloat, Field(gt=0)] = 20.0  #: farther values are ignored


class DepthSequence:
    """Views of a depth camera from a folder; iterates over :class:`DepthFrame`.

    Frames that cannot be used (unreadable, of another size, without pose, out
    of range) are skipped; ``skipped`` counts them by cause, and ``problems``
    has one line for each; both refer to the last iteration.

    Parameters
    ----------
    folder
        Folder with ``sequence.yaml``.

    Raises
    ------
    InputError
        The folder lacks required files, or they are inconsistent.

    Examples
    --------
    >>> from visuohaptic.io.depth import write_sequence
    >>> camera, pose = Camera.simple(64, 48, 60.0), Pose(np.eye(3), np.zeros(3))
    >>> wall = np.full((48, 64), 0.8, np.float32)
    >>> write_sequence("scan", [DepthFrame(0.0, wall, None, pose, camera)])
    1
    >>> [round(float(np.median(frame.depth_m)), 3) for frame in DepthSequence("scan")]
    [0.8]
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)
        info = load_yaml_model(self.folder / "sequence.yaml", SequenceFile)
        self.sensor = info.sensor
        self.camera = Camera.load(self._inside(info.camera, "camera"))
        self.encoding = DepthEncoding(
            info.depth_scale_m, info.bit_rotation, tuple(info.invalid), info.min_depth_m, info.max_depth_m
        )
        #: Depth images in name order, and the colour image of each.
        self.paths = _image_files(self._inside(info.depth, "depth"), set(DEPTH_SUFFIXES))
        if not self.paths:
            raise InputError(self.folder / info.depth, "has no depth images (.png, .exr)")
        colors = self._inside(info.color, "color")
        named = {path.stem: path for path in _image_files(colors, _COLOR_SUFFIXES)}
        self.color_paths = [named.get(path.stem) for path in self.paths]
        if not any(self.color_paths) and len(named) == len(self.paths):
            self.color_paths = [*named.values()]
        warn_of_unused_colour(colors, len(named), self.color_paths)
        poses = read_poses(self._inside(info.poses, "poses"), info.poses_topic)
        #: Time and pose of each image; missing poses have a reason.
        self.stamped: list[StampedPose] = _matched(self.folder, self.paths, poses)
        #: Where the poses come from; empty if the description does not say it.
        self.poses_source = info.poses_source
        if self.poses_source == NO_POSES:
            why = "the sequence has no poses, `recording import --poses odometry` estimates them"
            self.stamped = [StampedPose(stamped.t_s, None, why) for stamped in self.stamped]
        #: Standard deviation of each estimated pose: translation [m], rotation [rad]; ``None`` if not estimated.
        self.pose_sigma = self._sigmas(info.pose_sigma) if info.pose_sigma else None
        #: Number of poses without an image, if the file names reveal it.
        self.missing = 0 if seconds_in(self.paths) else len(poses) - len(self.paths)
        self._check_steps()
        self._check_conventions()
        self.skipped: Counter[str] = Counter()  #: skipped frames, by cause
        self.problems: list[str] = []  #: one line for each skipped frame

    def _inside(self, name: str, field: str) -> Path:
        """A path of the description; must be inside the folder."""
        path = self.folder / name
        if "\0" in name or not path.resolve().is_relative_to(self.folder.resolve()):
            raise InputError(
                self.folder / "sequence.yaml",
                f"found {name!r}, expected a path inside the folder",
                field=field,
            )
        return path

    def _sigmas(self, name: str) -> Float[np.ndarray, "n 2"]:
        path = self._inside(name, "pose_sigma")
        rows = [row for _, row in number_rows(path)]
        if len(rows) != len(self.paths) or {len(row) for row in rows} != {2}:
            raise InputError(path, f"expected two numbers for each of {len(self.paths)} images")
        return np.array(rows)

    def depth_images(self) -> Iterator[Float32[np.ndarray, "rows columns"] | None]:
        """Depth [m] of every image in name order, also of those without pose; ``None`` if it cannot be read."""
        for path in self.paths:
            try:
                yield self._read(path)
            except InputError as error:
                _log.warning("image skipped: %s", error)
                yield None

    def _check_steps(self) -> None:
        """Reject poses whose unit differs from that of the depth."""
        places = np.array([stamped.pose.translation_m for stamped in self.stamped if stamped.pose])
        if len(places) < 2:
            return
        step_m = float(np.median(np.linalg.norm(np.diff(places, axis=0), axis=1)))
        for path in self.paths[:3]:
            try:
                depths = self._read(path)
            except InputError:
                continue
            valid = depths[np.isfinite(depths)]
            if not valid.size:
                continue
            depth_m = float(np.median(valid))
            if step_m > _STEP_PER_DEPTH * depth_m:
                raise InputError(
                    self.folder,
                    f"the camera moves {step_m:.3g} m between frames and measures depths of {depth_m:.3g} m",
                    remedy="check that poses are in metres, and depth_scale_m",
                )
            return

    def _check_conventions(self) -> None:
        """Reject poses that are obviously meant otherwise; a few views are read for it."""
        usable = [
            (path, stamped.pose)
            for path, stamped in zip(self.paths, self.stamped, strict=True)
            if stamped.pose is not None
        ]

        def views(group: list[int]) -> Iterator[tuple[Float32[np.ndarray, "rows columns"], Pose]]:
            for path, pose in (usable[number] for number in group):
                with suppress(InputError):
                    yield self._read(path), pose

        groups = (list(views(group)) for group in compared(len(usable)))
        check_conventions(self.folder, self.camera, groups)

    def _read(self, path: Path) -> Float32[np.ndarray, "rows columns"]:
        return read_depth(path, self.encoding, size=(self.camera.width, self.camera.height))

    def __len__(self) -> int:
        return len(self.paths)

    @property
    def times_s(self) -> Float[np.ndarray, "n"]:
        """Time of every image [s]; the frame number if the poses have no times."""
        return np.array(
            [stamped.t_s if np.isfinite(stamped.t_s) else k for k, stamped in enumerate(self.stamped)],
            dtype=np.float64,
        )

    def __iter__(self) -> Iterator[DepthFrame]:
        """Usable frames in name order; every iteration starts at the first one."""
        return self._frames(1)

    def load(self, every: int = 1) -> list[DepthFrame]:
        """Usable frames, all in memory.

        Parameters
        ----------
        every
            Only one of this number of images is read.

        Raises
        ------
        InputError
            ``every`` is no whole number of 1 or more, the frames would not fit into the memory that this process may use, or none can be used.
        """
        if not isinstance(every, int | np.integer) or every < 1:
            raise InputError(
                "DepthSequence.load",
                f"found {brief(every)}, expected a whole number of 1 or more",
                field="every",
            )
        width, height = self.camera.width, self.camera.height
        image_bytes = width * height * _PIXEL_BYTES
        needed = len(range(0, len(self.paths), every)) * image_bytes
        memory = memory_bytes()
        if needed > memory:
            fitting = max(1, int(memory / image_bytes))
            raise InputError(
                self.folder,
                f"{needed // image_bytes} images of {width} x {height} need {needed * 1e-9:.1f} GB of memory, "
                f"expected at most the {memory * 1e-9:.1f} GB that this process may use",
                remedy=f"read one of {math.ceil(len(self.paths) / fitting)} images (--every)",
            )
        return list(self._frames(every))

    def _frames(self, every: int) -> Iterator[DepthFrame]:
        """One of ``every`` images, if it is usable.

        Raises
        ------
        InputError
            No frame can be used; the message contains the first cause.
        """
        self.skipped, self.problems = Counter(), []
        delivered = 0
        times_s = self.times_s
        for index in range(0, len(self.paths), every):
            path, stamped = self.paths[index], self.stamped[index]
            if stamped.pose is None:
                self._skip("no pose", f"{path.name}: {stamped.problem}")
                continue
            try:
                depth_m = self._read(path)
            except InputError as error:
                self._skip("wrong size" if error.field == "size" else "unreadable", str(error))
                continue
            if np.isnan(depth_m).all():
                self._skip("empty", f"{path.name}: not one depth is valid")
                continue
            delivered += 1
            color = self._color(self.color_paths[index])
            yield DepthFrame(float(times_s[index]), depth_m, color, stamped.pose, self.camera, index)
        if not delivered:
            raise InputError(
                self.folder, f"none of {len(self.problems)} frames can be used; the first: {self.problems[0]}"
            )

    def _skip(self, cause: str, problem: str) -> None:
        self.skipped[cause] += 1
        self.problems.append(problem)
        _log.warning("frame skipped: %s", problem)

    def _color(self, found: Path | None) -> UInt8[np.ndarray, "rows columns 3"] | None:
        if found is None:
            return None
        try:
            image = read_image(found)
        except InputError as error:
            _log.warning("colour skipped: %s", error)
            return None
        if image.shape[:2] != (self.camera.height, self.camera.width):
            _log.warning("colour skipped: %s has another size than the depth", found)
            return None
        return image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)


def warn_of_unused_colour(folder: Path, count: int, used: Sequence[Path | None]) -> None:
    """Warn of colour images none of which belongs to a depth image, as of another camera with times of its own.

    Parameters
    ----------
    folder
        Folder of the colour images.
    count
        Number of images in it.
    used
        Colour image of each depth image.
    """
    if count and not any(used):
        _log.warning(
            "%s: none of its %d images has the name of one of %d depth images; colour is left out",
            folder,
            count,
            len(used),
        )


def _image_files(folder: Path, suffixes: set[str]) -> list[Path]:
    if not folder.is_dir():
        return []
    found = [path for path in folder.iterdir() if path.suffix.lower() in suffixes and path.name[0] != "."]
    found.sort(key=lambda path: natural(path.stem))
    # By name, 12.6 would come before 12.533.
    times_s = seconds_in(found)
    return [found[place] for place in np.argsort(times_s, kind="stable")] if times_s else found


def _matched(folder: Path, paths: list[Path], poses: list[StampedPose]) -> list[StampedPose]:
    """The pose of each image: by the time in its name, by count, or by its number if images are missing."""
    timed = sorted((stamped for stamped in poses if np.isfinite(stamped.t_s)), key=lambda s: s.t_s)
    if (seconds := seconds_in(paths)) and timed:
        return [StampedPose(time_s, *interpolate_pose(timed, time_s)) for time_s in seconds]
    if len(paths) == len(poses):
        return poses
    numbers = [int(match[1]) for path in paths if (match := _NUMBER.search(path.stem))]
    if len(numbers) == len(paths) and max(numbers) - min(numbers) + 1 == len(poses) > len(paths):
        _log.warning("%s: %d of %d depth images are missing", folder, len(poses) - len(paths), len(poses))
        return [poses[number - min(numbers)] for number in numbers]
    raise InputError(
        folder,
        f"has {len(paths)} depth images and {len(poses)} poses, expected one pose for each image",
        remedy="or name the images by their time in seconds",
    )
