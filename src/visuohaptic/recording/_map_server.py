"""The files of ROS's map_server: a YAML file and a picture."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Bool, Float, Int8
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from ..camera.model import MAX_PIXELS
from ..errors import InputError
from ..files import atomic_path, load_yaml_model, save_yaml
from .occupancy_map import FREE, OCCUPIED, UNKNOWN, OccupancyMap
from .ros_image import image_size

_log = logging.getLogger(__name__)

_SUFFIXES = (".pgm", ".png", ".bmp", ".jpg", ".jpeg")


class MapFile(BaseModel):
    """Fields of the YAML file; fields of other programs are accepted and ignored."""

    model_config = ConfigDict(extra="ignore")
    image: Annotated[str, Field(min_length=1)]
    resolution: Annotated[FiniteFloat, Field(gt=0)]
    origin: Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)]
    mode: Literal["trinary", "scale", "raw"] = "trinary"
    negate: bool = False
    occupied_thresh: Annotated[FiniteFloat, Field(ge=0, le=1)] = 0.65
    free_thresh: Annotated[FiniteFloat, Field(ge=0, le=1)] = 0.196


def load(path: Path) -> OccupancyMap:
    """Read a YAML file and its image."""
    info = load_yaml_model(path, MapFile)
    if info.mode != "raw" and not info.free_thresh < info.occupied_thresh:
        raise InputError(
            path,
            f"found {info.free_thresh}, expected less than occupied_thresh {info.occupied_thresh}",
            field="free_thresh",
        )
    shade, opaque = read_shade(_image_beside(path, info.image))
    cells = cells_from_shade(shade, opaque, info.mode, info.negate, info.occupied_thresh, info.free_thresh)
    x, y, yaw = info.origin
    return OccupancyMap(cells, info.resolution, (x, y, yaw))


def _image_beside(path: Path, name: str) -> Path:
    """The image of a map file, inside its folder."""
    folder = path.parent
    named = Path(name.strip().replace("\\", "/"))
    if named.is_absolute():
        # A map file must not read any file of the computer; its picture usually moved along with it.
        _log.warning("%s: image %s is an absolute path, its name is looked for beside the map", path, name)
        named = Path(named.name)
    target = folder / named
    if not target.resolve().is_relative_to(folder.resolve()):
        raise InputError(path, f"found {name!r}, expected a file inside the folder of the map", field="image")
    if target.is_file():
        return target
    for suffix in _SUFFIXES:
        other = target.with_suffix(suffix)
        if other.is_file() and other.resolve().is_relative_to(folder.resolve()):
            _log.warning("%s: image %s is not there, %s is used", path, name, other.name)
            return other
    raise InputError(path, f"found {name!r}, which is not there", field="image")


def read_shade(path: Path) -> tuple[Float[np.ndarray, "rows columns"], Bool[np.ndarray, "rows columns"]]:
    """Brightness 0..1 and where the image is opaque; row 0 is the bottom of the picture."""
    try:
        with path.open("rb") as stream:
            head = stream.read(1 << 20)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from error
    width, height = image_size(head, str(path))
    if width <= 0 or height <= 0 or width * height > MAX_PIXELS:
        raise InputError(
            path, f"its header says {width} x {height}, expected a positive size of at most {MAX_PIXELS} px"
        )
    if head[:2] in (b"P2", b"P5"):
        shade = _read_pgm(path)
        opaque = np.ones(shade.shape, dtype=bool)
    else:
        shade, opaque = _read_other(path)
    if shade.shape != (height, width):
        raise InputError(path, f"is damaged: {shade.shape[1]} x {shade.shape[0]}, header {width} x {height}")
    return shade[::-1], opaque[::-1]


def _read_pgm(path: Path) -> Float[np.ndarray, "rows columns"]:
    """PGM, text (P2) or binary (P5), 8 or 16 bit, with comments."""
    data = path.read_bytes()
    numbers: list[int] = []
    place = 2
    while len(numbers) < 3:
        while place < len(data) and (data[place : place + 1].isspace() or data[place] == ord("#")):
            if data[place] == ord("#"):
                end = data.find(b"\n", place)
                place = len(data) if end < 0 else end
            else:
                place += 1
        start = place
        while place < len(data) and data[place : place + 1].isdigit():
            place += 1
        if place == start or place - start > 10:
            raise InputError(path, f"found {data[start : start + 10]!r}, expected a number in the PGM header")
        numbers.append(int(data[start:place]))
    width, height, top = numbers
    if not 1 <= top <= 65535:
        raise InputError(path, f"found {top}, expected 1 to 65535", field="maxval")
    if width * height > MAX_PIXELS or width <= 0 or height <= 0:
        raise InputError(path, f"found {width} x {height}, expected at most {MAX_PIXELS} px")
    count = width * height
    if data[:2] == b"P5":
        kind = np.dtype(np.uint8) if top < 256 else np.dtype(">u2")
        body = data[place + 1 :]
        if len(body) < count * kind.itemsize:
            raise InputError(path, f"has {len(body)} bytes of pixels, expected {count * kind.itemsize}")
        values = np.frombuffer(body, dtype=kind, count=count)
    else:
        text = b"\n".join(line.split(b"#", 1)[0] for line in data[place:].split(b"\n"))
        try:
            values = np.array(text.split(), dtype=np.int64)
        except (ValueError, OverflowError) as error:
            raise InputError(path, "has a pixel that is no number") from error
        if len(values) < count:
            raise InputError(path, f"has {len(values)} pixels, expected {count}")
        values = values[:count]
    if values.min() < 0 or values.max() > top:
        raise InputError(path, f"has pixels from {values.min()} to {values.max()}, its maxval is {top}")
    return values.reshape(height, width).astype(np.float64) / top


def _read_other(path: Path) -> tuple[Float[np.ndarray, "rows columns"], Bool[np.ndarray, "rows columns"]]:
    import cv2

    try:
        image = cv2.imdecode(np.fromfile(path, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise InputError(path, f"is a damaged image ({error.err})") from error
    if image is None or image.dtype not in (np.uint8, np.uint16):
        raise InputError(path, "is a damaged image, or not of 8 or 16 bit")
    top = float(np.iinfo(image.dtype).max)
    if image.ndim == 2:
        return np.asarray(image, dtype=np.float64) / top, np.ones(image.shape, dtype=bool)
    colours = image[..., :3] if image.shape[2] >= 3 else image[..., :1]
    opaque = (
        image[..., -1] == np.iinfo(image.dtype).max
        if image.shape[2] in (2, 4)
        else np.ones(image.shape[:2], dtype=bool)
    )
    return colours.mean(axis=2) / top, opaque


def cells_from_shade(
    shade: Float[np.ndarray, "rows columns"],
    opaque: Bool[np.ndarray, "rows columns"],
    mode: str,
    negate: bool,
    occupied_thresh: float,
    free_thresh: float,
) -> Int8[np.ndarray, "rows columns"]:
    """Occupancy by the rules of map_server; what is not opaque is unknown.

    ROS averages the transparency of a trinary map into its grey level; here it
    means unknown in every mode.
    """
    if mode == "raw":
        value = np.rint(shade * 255)
        cells = np.where(value <= OCCUPIED, value, UNKNOWN)
    else:
        occupancy = shade if negate else 1.0 - shade
        if mode == "scale":
            part = (occupancy - free_thresh) / (occupied_thresh - free_thresh)
            cells = 1 + np.floor(98 * np.clip(part, 0.0, 1.0))
        else:
            cells = np.full(shade.shape, float(UNKNOWN))
        cells = np.where(occupancy > occupied_thresh, OCCUPIED, cells)
        cells = np.where(occupancy < free_thresh, FREE, cells)
    return np.where(opaque, cells, UNKNOWN).astype(np.int8)


def save(grid: OccupancyMap, path: Path) -> None:
    """Write YAML and PGM, the picture first: a YAML file never names a picture that is not there."""
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(path, "expected a name that ends in .yaml")
    trinary = bool(np.isin(grid.cells, (UNKNOWN, FREE, OCCUPIED)).all())
    if trinary:
        # The grey levels of map_saver.
        pixels = np.select([grid.occupied, grid.free], [0, 254], 205).astype(np.uint8)
    else:
        pixels = np.where(grid.unknown, 255, grid.cells).astype(np.uint8)
    rows, columns = grid.shape
    picture = path.with_suffix(".pgm")
    with atomic_path(picture) as temporary, temporary.open("wb") as stream:
        stream.write(f"P5\n{columns} {rows}\n255\n".encode())
        stream.write(np.ascontiguousarray(pixels[::-1]).tobytes())
    save_yaml(
        path,
        {
            "image": picture.name,
            "mode": "trinary" if trinary else "raw",
            "resolution": float(grid.resolution_m),
            "origin": [float(value) for value in grid.origin],
            "negate": 0,
            "occupied_thresh": 0.65,
            "free_thresh": 0.196,
        },
    )
