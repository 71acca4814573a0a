"""Map files of ROS's map_server: a YAML file and an image."""

from __future__ import annotations

import logging
import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Int8
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, FiniteFloat

from ...core import InputError, atomic_path, load_yaml_model, save_yaml
from ._map_image import FREE, OCCUPIED, UNKNOWN, cells_from_image, read_map_image

_log = logging.getLogger(__name__)

#: Width of a door; no map of rooms has such cells, a resolution in centimetres has.
_DOOR_m = 0.8
_SUFFIXES = (".pgm", ".png", ".bmp", ".jpg", ".jpeg")


def _no_truth_value(value: object) -> object:
    # pydantic would read "resolution: yes" as 1 m.
    if isinstance(value, bool):
        raise ValueError("expected a number")
    return value


_Number = Annotated[FiniteFloat, BeforeValidator(_no_truth_value)]


class MapFile(BaseModel):
    """Fields of the YAML file; unknown fields are accepted and ignored.

    As in map_server, only ``mode`` is optional: thresholds missing from a truncated
    file would change which cells are free.
    """

    model_config = ConfigDict(extra="ignore")
    image: Annotated[str, Field(min_length=1, max_length=4096)]  #: image file, relative to this file
    resolution: Annotated[_Number, Field(ge=1e-4, le=1e3)]  #: side of a cell [m]
    #: x, y [m] and yaw [rad] of the lower left corner
    origin: Annotated[list[Annotated[_Number, Field(ge=-1e9, le=1e9)]], Field(min_length=3, max_length=3)]
    #: conversion of grey levels to cells
    mode: Literal["trinary", "scale", "raw"] = "trinary"
    negate: bool  #: whether bright cells are occupied
    occupied_thresh: Annotated[_Number, Field(ge=0, le=1)]  #: darkness above which a cell is occupied
    free_thresh: Annotated[_Number, Field(ge=0, le=1)]  #: darkness below which a cell is free


def load(path: Path) -> tuple[Int8[np.ndarray, "rows columns"], float, tuple[float, float, float]]:
    """Cells, resolution [m] and origin (x, y, yaw) [m, m, rad] of a YAML file with its image.

    Parameters
    ----------
    path
        YAML file of the map.
    """
    if path.is_file() and path.suffix.lower() in (".pgm", ".png", ".bmp", ".jpg", ".jpeg"):
        raise InputError(
            path,
            "is an image, expected the YAML file of a map",
            remedy=f"create one next to it: image: {path.name}, resolution: METRES_PER_PIXEL, origin: [0, 0, 0], "
            "negate: 0, occupied_thresh: 0.65, free_thresh: 0.196",
        )
    info = load_yaml_model(path, MapFile)
    if info.mode != "raw" and not info.free_thresh < info.occupied_thresh:
        raise InputError(
            path,
            f"found {info.free_thresh}, expected less than occupied_thresh {info.occupied_thresh}",
            field="free_thresh",
        )
    x, y, yaw = info.origin
    if abs(yaw) > 2.0 * math.pi:  # more than a turn is an angle in degrees
        raise InputError(
            path,
            f"found a yaw of {yaw:g}, expected -6.28 to 6.28 rad",
            field="origin",
            remedy=f"{yaw:g} degrees are {math.radians(yaw):.4f} rad",
        )
    if info.resolution > _DOOR_m:
        _log.warning(
            "%s: resolution: a cell has %g m, more than a door; expected metres", path, info.resolution
        )
    image = read_map_image(_image_beside(path, info.image))
    cells = cells_from_image(image, info.mode, info.negate, info.occupied_thresh, info.free_thresh)
    return cells, info.resolution, (x, y, yaw)


def _image_beside(path: Path, name: str) -> Path:
    """The image of a map file, which must be in its folder."""
    folder = path.parent
    named = Path(name.strip().replace("\\", "/"))
    if named.is_absolute():
        # A map file cannot read arbitrary files; its image was usually moved along with it.
        named = Path(named.name)
    target = folder / named
    try:
        if not target.resolve().is_relative_to(folder.resolve()):
            raise InputError(
                path, f"found {name!r}, expected a file inside the folder of the map", field="image"
            )
        if target.is_file():
            if Path(name.strip()).is_absolute():
                _log.warning(
                    "%s: image %s is an absolute path, %s next to the map is used", path, name, target
                )
            return target
        for suffix in _SUFFIXES if target.name else ():
            other = target.with_suffix(suffix)
            if other.is_file() and other.resolve().is_relative_to(folder.resolve()):
                _log.warning("%s: image %s does not exist, %s is used", path, name, other.name)
                return other
    except InputError:
        raise
    except (OSError, ValueError, RuntimeError) as error:  # not a valid file name, or circular links
        raise InputError(
            path, f"found {name[:80]!r}, which cannot be a file ({error})", field="image"
        ) from error
    raise InputError(path, f"found {name[:80]!r}, which does not exist", field="image")


def save(
    path: Path,
    cells: Int8[np.ndarray, "rows columns"],
    resolution_m: float,
    origin: tuple[float, float, float],
) -> None:
    """Write YAML and PGM, the image first: a YAML file never refers to a missing image.

    Parameters
    ----------
    path
        YAML file; the image next to it has the same name.
    cells
        -1 unknown, 0 free to 100 occupied, (rows, columns).
    resolution_m
        Edge of a cell [m].
    origin
        x [m], y [m] and yaw [rad] of the lower left corner.
    """
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(path, "expected a name that ends in .yaml")
    trinary = bool(np.isin(cells, (UNKNOWN, FREE, OCCUPIED)).all())
    if trinary:
        # Grey levels of map_saver.
        pixels = np.select([cells == OCCUPIED, cells == FREE], [0, 254], 205).astype(np.uint8)
    else:
        pixels = np.where(cells == UNKNOWN, np.uint8(255), cells.astype(np.uint8))
    rows, columns = cells.shape
    image = path.with_suffix(".pgm")
    with atomic_path(image) as temporary, temporary.open("wb") as stream:
        stream.write(f"P5\n{columns} {rows}\n255\n".encode())
        stream.write(np.ascontiguousarray(pixels[::-1]).tobytes())
    save_yaml(
        path,
        {
            "image": image.name,
            "mode": "trinary" if trinary else "raw",
            "resolution": float(resolution_m),
            "origin": [float(value) for value in origin],
            "negate": 0,
            "occupied_thresh": 0.65,
            "free_thresh": 0.196,
        },
    )
