"""Conversion of published layouts of depth sequences to a sequence folder.

``arm``
    ``camera.json`` (width, height, fx, fy, cx, cy, depth_unit_m), ``depth/k.png``,
    ``color/k.jpg``, ``base_T_cam.txt`` with lines of ``k`` and the 16 numbers of a matrix, or ``k tx ty tz qx qy qz qw``.
``apc``
    ``cam.info.txt`` (labelled matrices), ``frame-NNNNNN.depth.png`` with rotated
    bits of 0.1 mm, aligned to ``frame-NNNNNN.color.png``.
``cleargrasp``
    ``camera_intrinsics.yaml``, ``N-<kind>-depth-img.exr`` in metres: single
    views without poses, each of a separate scene.
``plain``
    Depth images with explicitly given ``camera.yaml`` and pose file.
``sequence``
    A sequence folder of this library, to be written again with other poses.
``bag``
    An MCAP file or rosbag2 bag (:class:`.BagImages`).
"""

from __future__ import annotations

import logging
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from ...core import Camera, InputError, Pose
from ...core.camera.frame import USUAL_RATE_Hz
from ...core.files import (
    checked_model,
    image_size,
    load_json,
    load_yaml_model,
    read_bytes,
    read_text,
)
from ..image_folder import seconds_in
from .depth_images import DEPTH_SUFFIXES, DepthEncoding, read_depth
from .depth_sequence import (
    NO_POSES,
    DepthFrame,
    DepthSequence,
    _image_files,
    _matched,
    warn_of_unused_colour,
)
from .depth_sequence_out import write_sequence
from .poses import StampedPose, number_rows, poses_of_rows, read_poses, stamped_matrix

_log = logging.getLogger(__name__)

LAYOUTS = ("arm", "apc", "cleargrasp", "plain", "sequence")
#: File that only a folder of this layout has.
_FILES = {
    "camera.json": "arm", "cam.info.txt": "apc", "camera_intrinsics.yaml": "cleargrasp", "sequence.yaml": "sequence"
}  # fmt: skip
_NUMBER = re.compile(r"(\d+)")


@dataclass(frozen=True, slots=True)
class ImportedSequence:
    """Result of an import."""

    folder: Path
    layout: str
    frames: int
    skipped: list[str] = field(default_factory=list)  #: one line for each skipped image
    notes: list[str] = field(default_factory=list)  #: topics that were used of a recording


@dataclass(frozen=True, slots=True)
class _Layout:
    """Parsed contents of a third-party folder."""

    sensor: str
    camera: Camera
    encoding: DepthEncoding
    images: list[tuple[Path, Path | None, StampedPose]]  #: depth, colour, pose
    poses_source: str = ""


class _Pinhole(BaseModel):
    model_config = ConfigDict(extra="ignore")
    fx: FiniteFloat
    fy: FiniteFloat
    cx: FiniteFloat
    cy: FiniteFloat

    def camera_of(self, width: int, height: int, name: str) -> Camera:
        matrix = np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])
        return Camera(width, height, matrix, name=name)


class _CameraJson(_Pinhole):
    camera: str = "depth camera"
    width: int = Field(gt=0)
    height: int = Field(gt=0)
    depth_unit_m: FiniteFloat = Field(gt=0)


class _ClearGraspYaml(_Pinhole):
    camera_name: str = "depth camera"
    xres: int = Field(gt=0)
    yres: int = Field(gt=0)


def import_sequence(
    source: Path | str,
    target: Path | str,
    *,
    layout: str = "auto",
    kind: str = "transparent",
    camera: Path | str | None = None,
    poses: Path | str | None = None,
    depth_scale_m: float | None = None,
    bit_rotation: int = 0,
) -> ImportedSequence:
    """Convert a third-party folder to a sequence folder.

    Depth is written as plain 16-bit PNG; colour is copied. Images that
    cannot be read or have no pose are skipped and reported.

    Parameters
    ----------
    source
        Folder in one of the supported layouts.
    target
        Folder to create.
    layout
        One of :data:`LAYOUTS`, or ``auto`` to detect it from the files.
    kind
        Type of the ClearGrasp pairs: ``transparent`` or ``opaque``.
    camera, poses, depth_scale_m, bit_rotation
        For a plain folder: ``camera_info`` file, pose file, size of one unit [m],
        and the F200's bit rotation. With ``poses="none"``, images of any layout are kept without poses.

    Returns
    -------
    ImportedSequence
        What was written, and what was skipped and why.

    Raises
    ------
    InputError
        The source has no such layout, none of it can be read, or the
        target already exists.
    """
    source, target = Path(source), Path(target)
    if not source.is_dir():
        raise InputError(source, "is not a folder")
    if layout not in ("auto", *LAYOUTS):
        raise InputError("layout", f"found {layout!r}, expected auto, {', '.join(LAYOUTS)}")
    chosen = _layout_of(source, camera) if layout == "auto" else layout
    _check_options(source, chosen, camera, poses, depth_scale_m, bit_rotation)
    if chosen == "cleargrasp":
        found = _cleargrasp(source, kind)
    elif chosen == "plain":
        found = _plain(source, camera, poses, depth_scale_m, bit_rotation)
    else:
        found = {"arm": _arm, "apc": _apc, "sequence": _sequence}[chosen](source)
    if poses == NO_POSES:
        # The poses of these frames are not written.
        kept = [
            (depth, color, replace(stamped, pose=Pose.identity())) for depth, color, stamped in found.images
        ]
        found = replace(found, images=kept, poses_source=NO_POSES)
    return _write(found, target, chosen)


def _check_options(source: Path, layout: str, camera: object, poses: object, *numbers: float | None) -> None:
    """Refuse for other layouts what only a plain folder takes: it would not be used."""
    names = ("camera", "poses", "depth_scale_m", "bit_rotation")
    values = (camera, None if poses == NO_POSES else poses, *numbers)
    given = [name for name, value in zip(names, values, strict=True) if value]
    if layout != "plain" and given:
        remedy = "leave it out, or choose the layout plain"
        raise InputError(source, f"does not apply to the layout {layout}", field=given[0], remedy=remedy)


def _layout_of(source: Path, camera: Path | str | None) -> str:
    if camera is not None:
        return "plain"
    for name, layout in _FILES.items():
        if (source / name).is_file():
            return layout
    raise InputError(
        source,
        f"has none of {', '.join(_FILES)}",
        remedy="give camera, poses and depth scale of a plain folder",
    )


def _arm(source: Path) -> _Layout:
    path = source / "camera.json"
    info = load_json(path, "a camera.json", lambda data: checked_model(path, data, _CameraJson))
    table = source / "base_T_cam.txt"
    by_number: dict[float, StampedPose] = {}
    for line, row in number_rows(table):
        if len(row) not in (8, 17):
            said = f"found {len(row)} numbers, expected that of an image, and 16 (matrix) or 7 of its pose"
            raise InputError(table, said, field=f"line {line}")
        (by_number[row[0]],) = poses_of_rows(table, iter([(line, row)]))
    images = []
    for path in _image_files(source / "depth", set(DEPTH_SUFFIXES)):
        match = _NUMBER.search(path.stem)
        pose = by_number.get(int(match[1])) if match else None
        pose = pose or StampedPose(np.nan, None, f"{table.name} has no pose of it")
        images.append((path, _beside(source / "color", path.stem), pose))
    camera = info.camera_of(info.width, info.height, info.camera)
    return _Layout(info.camera, camera, DepthEncoding(info.depth_unit_m), images)


def _beside(folder: Path, stem: str) -> Path | None:
    found = (folder / (stem + suffix) for suffix in (".png", ".jpg", ".jpeg"))
    return next((path for path in found if path.is_file()), None)


def _labelled_matrices(path: Path) -> dict[str, Float[np.ndarray, "rows columns"]]:
    """Matrices of a text file, each labelled by the comment line above it."""
    lines = read_text(path).splitlines()
    found: dict[str, list[list[float]]] = {}
    label = ""
    for number, line in enumerate(lines, start=1):
        if line.startswith("#"):
            label = line[1:].strip()
        elif line.strip():
            try:
                found.setdefault(label, []).append([float(word) for word in line.split()])
            except ValueError as error:
                raise InputError(
                    path, f"found {line[:60]!r}, expected numbers", field=f"line {number}"
                ) from error
    matrices = {}
    for label, rows in found.items():
        if len({len(row) for row in rows}) != 1:
            raise InputError(path, f"the rows of {label!r} have different lengths")
        matrices[label] = np.array(rows)
    return matrices


def _apc(source: Path) -> _Layout:
    path = source / "cam.info.txt"
    matrices = _labelled_matrices(path)
    intrinsic = next((m for label, m in matrices.items() if label.startswith("Color camera intrinsic")), None)
    if intrinsic is None or intrinsic.shape != (3, 3):
        raise InputError(path, "has no 3 x 3 color camera intrinsic matrix")
    camera: Camera | None = None
    images: list[tuple[Path, Path | None, StampedPose]] = []
    for depth in _image_files(source, {".png"}):
        if not depth.name.endswith(".depth.png"):
            continue
        name = depth.name.removesuffix(".depth.png")
        matrix = next((m for label, m in matrices.items() if label.endswith(f"for {name}")), None)
        color = source / f"{name}.color.png"
        if camera is None:
            camera = _camera_of(depth, intrinsic)
        if matrix is None or matrix.shape != (4, 4):
            stamped = StampedPose(np.nan, None, f"{path.name} has no pose of {name}")
        else:
            stamped = stamped_matrix(matrix, name)
        images.append((depth, color if color.is_file() else None, stamped))
    if camera is None:
        raise InputError(source, "has no frame-NNNNNN.depth.png")
    return _Layout("Intel RealSense F200", camera, DepthEncoding(1e-4, bit_rotation=3), images)


def _camera_of(image: Path, intrinsic: Float[np.ndarray, "3 3"]) -> Camera:
    width, height = image_size(read_bytes(image), image)
    return Camera(width, height, intrinsic, name="color")


def _cleargrasp(source: Path, kind: str) -> _Layout:
    if kind not in ("transparent", "opaque"):
        raise InputError("kind", f"found {kind!r}, expected transparent or opaque")
    info = load_yaml_model(source / "camera_intrinsics.yaml", _ClearGraspYaml)
    camera = info.camera_of(info.xres, info.yres, info.camera_name)
    images: list[tuple[Path, Path | None, StampedPose]] = []
    for path in _image_files(source, {".exr"}):
        if f"-{kind}-depth-img" in path.stem:
            color = path.with_name(path.stem.replace("depth-img", "rgb-img") + ".jpg")
            images.append((path, color if color.is_file() else None, StampedPose(np.nan, Pose.identity())))
    return _Layout(info.camera_name, camera, DepthEncoding(1.0), images, NO_POSES)  # single views


def _plain(
    source: Path,
    camera: Path | str | None,
    poses: Path | str | None,
    depth_scale_m: float | None,
    bit_rotation: int,
) -> _Layout:
    if camera is None or poses is None or depth_scale_m is None:
        values = {"camera": camera, "poses": poses, "depth_scale_m": depth_scale_m}
        missing = ", ".join(name for name, value in values.items() if value is None)
        remedy = "give a camera_info file, a file of poses (or none), and the metres of one unit"
        raise InputError(source, f"a plain folder needs {missing}", remedy=remedy)
    folder = source / "depth" if (source / "depth").is_dir() else source
    paths = _image_files(folder, set(DEPTH_SUFFIXES))
    if poses == NO_POSES:
        stamped = [StampedPose(time_s, None) for time_s in seconds_in(paths) or [np.nan] * len(paths)]
    else:
        stamped = _matched(source, paths, read_poses(poses)) if paths else []
    colors = [_beside(source / "color", path.stem) for path in paths]
    warn_of_unused_colour(
        source / "color", len(_image_files(source / "color", {".png", ".jpg", ".jpeg"})), colors
    )
    images = list(zip(paths, colors, stamped, strict=True))
    return _Layout("unknown", Camera.load(camera), DepthEncoding(depth_scale_m, bit_rotation), images)


def _sequence(source: Path) -> _Layout:
    sequence = DepthSequence(source)
    images = zip(sequence.paths, sequence.color_paths, sequence.stamped, strict=True)
    return _Layout(sequence.sensor, sequence.camera, sequence.encoding, list(images), sequence.poses_source)


def _write(found: _Layout, target: Path, layout: str) -> ImportedSequence:
    if not found.images:
        raise InputError(target, f"the source has no depth images of the layout {layout!r}")
    # Units of 0.1 mm reach 6.5 m in 16 bits; coarser units are kept.
    scale_m = 1e-4 if found.encoding.scale_m == 1.0 else found.encoding.scale_m
    skipped: list[str] = []
    count = write_sequence(
        target,
        _frames(found, target, skipped),
        sensor=found.sensor,
        depth_scale_m=scale_m,
        poses_source=found.poses_source,
    )
    return ImportedSequence(target, layout, count, skipped)


def _frames(found: _Layout, target: Path, skipped: list[str]) -> Iterator[DepthFrame]:
    """Frames with depth; colour images are copied to the target as they are."""
    index = 0
    for index, (depth_m, color, stamped) in enumerate(_readable(found, skipped), start=1):
        if color is not None:
            (target / "color").mkdir(parents=True, exist_ok=True)
            shutil.copyfile(color, target / "color" / f"{index - 1:06d}{color.suffix}")
        assert stamped.pose is not None
        time_s = stamped.t_s if np.isfinite(stamped.t_s) else (index - 1) / USUAL_RATE_Hz
        yield DepthFrame(time_s, depth_m, None, stamped.pose, found.camera, index - 1)
    if not index:
        raise InputError(target, f"no image of the source can be used; the first: {skipped[0]}")


def _readable(
    found: _Layout, skipped: list[str]
) -> Iterator[tuple[Float[np.ndarray, "rows columns"], Path | None, StampedPose]]:
    size = (found.camera.width, found.camera.height)
    for path, color, stamped in found.images:
        try:
            if stamped.pose is None:
                raise InputError(path, stamped.problem)
            depth_m = read_depth(path, found.encoding, size=size)
        except InputError as error:
            _log.warning("image skipped: %s", error)
            skipped.append(str(error))
            continue
        yield depth_m, color, stamped
