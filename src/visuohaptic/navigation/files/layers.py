"""Layers of a map as PNG and YAML: distance, cost, regions, confidence, in formats that other programs can read.

The YAML file has the fields of map_server, so that the image is located
in the map frame, and below ``layer`` the conversion from grey levels to values::

    value = offset + scale * level        levels 0 .. top
    no_value = 65535, infinite = 65534, minus_infinite = 65533  (16 bit)

Booleans and integers are stored exactly, floats to half a step of 1/65532 of their range.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int, Int8
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from ...core.errors import InputError
from ...core.files import load_yaml_model, read_image, save_yaml, write_image
from ...io.maps.occupancy_map import OCCUPIED, OccupancyMap
from ..problem import MovableObject, RobotModel, failure_probability, manipulability

#: 16 bit levels for values that are not finite numbers.
_NAN, _INF, _MINUS_INF, _TOP = 65535, 65534, 65533, 65532


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """Values on the grid of a map; row 0 is at the bottom."""

    name: str
    values: (
        Float[np.ndarray, "rows columns"] | Int[np.ndarray, "rows columns"] | Bool[np.ndarray, "rows columns"]
    )
    resolution_m: float
    origin: tuple[float, float, float]  #: (x, y, yaw) [m, m, rad] as in :class:`OccupancyMap`
    unit: str = "1"


class _LayerFields(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str
    unit: str = "1"
    kind: Literal["bool", "int32", "float32", "float64"]
    coding: Literal["linear8", "linear16"]
    offset: FiniteFloat = 0.0
    scale: FiniteFloat = 1.0
    no_value: int | None = None
    infinite: int | None = None
    minus_infinite: int | None = None


class _LayerFile(BaseModel):
    model_config = ConfigDict(extra="ignore")
    image: Annotated[str, Field(min_length=1, max_length=255)]
    resolution: Annotated[FiniteFloat, Field(gt=0)]
    origin: Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)]
    layer: _LayerFields


def save_layer(
    path: Path | str, values: np.ndarray, grid: OccupancyMap, *, name: str = "", unit: str = "1"
) -> None:
    """Write ``NAME.yaml`` and ``NAME.png`` next to it.

    Parameters
    ----------
    path
        File name that ends in ``.yaml``.
    values
        Booleans, integers in a range of 16 bits, or floats (NaN = no value, infinities are kept), with the shape of ``grid``.
    grid
        Map on whose grid the layer is defined.
    name
        Name of the layer.
    unit
        Unit of the values.

    Raises
    ------
    InputError
        The shape differs from the grid's, or the data type is not supported.
    """
    path = Path(path)
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(path, "expected a name that ends in .yaml")
    values = np.asarray(values)
    if values.shape != grid.shape:
        raise InputError("values", f"found shape {values.shape}, expected {grid.shape}, the shape of the map")
    pixels, fields = _coded(values)
    picture = path.with_suffix(".png")
    write_image(picture, pixels[::-1])
    save_yaml(
        path,
        {
            "image": picture.name,
            "mode": "scale",
            "resolution": float(grid.resolution_m),
            "origin": [float(value) for value in grid.origin],
            "negate": 1,  # a larger value is brighter
            "occupied_thresh": 1.0,
            "free_thresh": 0.0,
            "layer": {"name": name or path.stem, "unit": unit, **fields},
        },
    )


def _coded(values: np.ndarray) -> tuple[np.ndarray, dict[str, Any]]:
    """Pixels and the fields that describe their coding."""
    if values.dtype == np.bool_:
        fields = {"kind": "bool", "coding": "linear8", "offset": 0.0, "scale": 1.0 / 255}
        return np.where(values, 255, 0).astype(np.uint8), fields
    if np.issubdtype(values.dtype, np.integer):
        low, high = int(values.min()), int(values.max())
        if low < -(2**31) or high >= 2**31 or high - low > 65535:
            raise InputError("values", f"found whole numbers {low} to {high}, expected a range of 16 bits")
        wide = high - low > 255
        pixels = (values.astype(np.int64) - low).astype(np.uint16 if wide else np.uint8)
        return pixels, {"kind": "int32", "coding": "linear16" if wide else "linear8", "offset": float(low)}
    if not np.issubdtype(values.dtype, np.floating):
        raise InputError("values", f"found {values.dtype}, expected bool, whole numbers or floats")
    kind = "float32" if values.dtype.itemsize <= 4 else "float64"
    finite = np.isfinite(values)
    lowest = float(values[finite].min()) if finite.any() else 0.0
    highest = float(values[finite].max()) if finite.any() else 0.0
    scale = (highest - lowest) / _TOP or 1.0
    level = np.zeros(values.shape)
    level[finite] = np.rint((values[finite].astype(np.float64) - lowest) / scale)
    level[np.isnan(values)] = _NAN
    level[np.isposinf(values)] = _INF
    level[np.isneginf(values)] = _MINUS_INF
    fields = {"kind": kind, "coding": "linear16", "offset": lowest, "scale": scale}
    codes = {"no_value": _NAN, "infinite": _INF, "minus_infinite": _MINUS_INF}
    return level.astype(np.uint16), fields | codes


def load_layer(path: Path | str) -> Layer:
    """Read a layer written by :func:`save_layer`.

    Parameters
    ----------
    path
        File name, ends in ``.yaml``.

    Raises
    ------
    InputError
        Names the file and the field, with what was found and what was expected.
    """
    path = Path(path)
    info = load_yaml_model(path, _LayerFile)
    if Path(info.image).name != info.image:
        raise InputError(path, f"found {info.image!r}, expected the name of a file next to it", field="image")
    picture = path.parent / info.image
    if not picture.is_file():
        raise InputError(path, f"found {info.image!r}, which does not exist", field="image")
    pixels = read_image(picture, "unchanged")[::-1]
    layer = info.layer
    depth = {"linear8": "uint8", "linear16": "uint16"}[layer.coding]
    if pixels.ndim != 2 or str(pixels.dtype) != depth:
        raise InputError(picture, f"found {pixels.dtype} {pixels.shape}, expected a {layer.coding} image")
    raw = layer.offset + layer.scale * pixels.astype(np.float64)
    codes = ((layer.no_value, np.nan), (layer.infinite, np.inf), (layer.minus_infinite, -np.inf))
    for code, value in codes:
        if code is not None:
            raw[pixels == code] = value
    exact = {"bool": raw > 0.5, "int32": np.rint(raw)}
    values = exact.get(layer.kind, raw).astype(layer.kind)
    x, y, yaw = info.origin
    return Layer(layer.name, values, info.resolution, (x, y, yaw), layer.unit)


def felt_obstacles(
    grid: OccupancyMap, objects: Iterable[MovableObject], robot: RobotModel
) -> Int8[np.ndarray, "rows columns"]:
    """Cost of touched objects for a robot that drives into them, on the cells of a map.

    100 if an object cannot be pushed (fixed, falls, or heavier than the platform's force), 1 to 99 according to the probability
    that a push fails, 0 elsewhere; untouched objects have no cost.

    Parameters
    ----------
    grid
        The map.
    objects
        Footprints with tags.
    robot
        Provides the pushing force.
    """
    from shapely import Polygon, distance, points

    found = np.zeros(grid.shape, np.int8)
    for item in objects:
        if item.tag is None:
            continue
        risk = failure_probability(item.tag, 0.0, robot)
        value = 1 + round(98 * risk) if manipulability(item.tag, robot).possible else OCCUPIED
        corners = grid.cell_from_world(item.footprint_m)
        low, high = np.clip([corners.min(axis=0) - 1, corners.max(axis=0) + 2], 0, found.shape)
        cells = low + np.argwhere(np.ones(high - low, bool))
        # Every cell that overlaps the object: its centre is at most half a diagonal away.
        places = points(grid.world_from_cell(cells))
        reached = cells[distance(Polygon(item.footprint_m), places) <= grid.resolution_m * np.sqrt(0.5)]
        rows, columns = reached.T
        found[rows, columns] = np.maximum(found[rows, columns], value)
    return found
