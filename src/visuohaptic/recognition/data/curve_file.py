"""CSV files of measured curves: of one object to classify, of many objects for training, or firm squeezes of one container."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ...core.files import CsvRow, check_columns, read_csv
from .places import HEIGHTS, SIDES
from .readings import CurveCoefficients, MAX_SIZE_m, TouchNoise, TouchReading, fit_curve

#: Files with more samples are rejected.
MAX_SAMPLES = 1_000_000
#: No gripper or hand presses harder [N]; three newtons in millinewtons do.
MAX_FORCE_N = 1000.0


@dataclass(frozen=True, slots=True, eq=False)
class SqueezedObject:
    """All touches of one object of a known class."""

    label: str  #: class
    name: str  #: name of the object
    readings: tuple[TouchReading, ...]


@dataclass(frozen=True, slots=True, eq=False)
class SqueezeSamples:
    """One squeeze at a height."""

    height_m: float
    deformation_m: Float[np.ndarray, "n"]  #: of one side
    force_N: Float[np.ndarray, "n"]  #: of one finger


@dataclass(frozen=True, slots=True)
class _Sample:
    """One row; its curve is identified by label, object, curve, height and side."""

    label: str
    name: str
    curve: str
    height: int
    side: str
    deformation_m: float
    force_N: float
    width_m: float
    object_height_m: float


def read_curves(path: Path | str, noise: TouchNoise | None = None) -> tuple[TouchReading, ...]:
    """Measured curves of one object, in the order of their first sample.

    The CSV has the columns ``height`` (1 .. 16) or ``at`` (0 .. 1 of the object's height), ``side`` (x+, x-, y+, y-),
    ``force_N``, ``deformation_m``, and optionally ``width_m``, the gripper's opening at contact, ``object_height_m``, and
    ``curve``, any name that distinguishes several curves of one place.

    Parameters
    ----------
    path
        CSV file in UTF-8.
    noise
        Standard deviations of one sample.

    Raises
    ------
    InputError
        The file cannot be read, has several objects, a value is missing or out of range, with its line, or a curve is refused
        by :func:`.check_curve`.
    """
    path = Path(path)
    samples = list(_samples(path, ()))
    objects = {(one.label, one.name) for one in samples}
    if len(objects) > 1:
        raise InputError(
            path, f"found {len(objects)} objects (columns label, object), expected the curves of one"
        )
    return _touches(path, samples, noise)


def read_squeezed(path: Path | str) -> tuple[SqueezedObject, ...]:
    """Measured curves of objects with known classes.

    The CSV has the columns of :func:`read_curves`, ``label``, the class, and optionally ``object``, the name of the object
    if a class has several.

    Parameters
    ----------
    path
        As of :func:`read_curves`.

    Raises
    ------
    InputError
        As of :func:`read_curves`.
    """
    path = Path(path)
    objects: dict[tuple[str, str], list[_Sample]] = {}
    for sample in _samples(path, ("label",)):
        objects.setdefault((sample.label, sample.name), []).append(sample)
    return tuple(
        SqueezedObject(label, f"{label}/{name}" if name else label, _touches(path, samples, None))
        for (label, name), samples in objects.items()
    )


def read_squeezes(path: Path | str) -> tuple[SqueezeSamples, ...]:
    """Firm squeezes of one container, by their first sample.

    The CSV has the columns ``height_m`` above the foot, ``deformation_m`` of one side, ``force_N`` of one finger, and
    optionally ``curve``, any name that distinguishes several squeezes at one height.

    Parameters
    ----------
    path
        CSV file in UTF-8.

    Raises
    ------
    InputError
        The file cannot be read, or a value is not a positive number, with its line.
    """
    path = Path(path)
    curves: dict[tuple[str, float], list[tuple[float, float]]] = {}
    for number, row in enumerate(read_csv(path, ("height_m", "deformation_m", "force_N"))[1]):
        if number >= MAX_SAMPLES:
            raise InputError(path, f"has more than {MAX_SAMPLES} samples")
        height, *sample = (row.number(name) for name in ("height_m", "deformation_m", "force_N"))
        if min(height, *sample) <= 0:
            raise row.problem(
                f"found {height:g} m, {sample[0]:g} m and {sample[1]:g} N, expected more than 0"
            )
        curves.setdefault((row.get("curve"), height), []).append((sample[0], sample[1]))
    return tuple(SqueezeSamples(height, *np.array(rows).T) for (_, height), rows in curves.items())


def _touches(path: Path, samples: list[_Sample], noise: TouchNoise | None) -> tuple[TouchReading, ...]:
    """Coefficients of the curves; the two sides of a height and axis are one touch."""
    curves: dict[tuple[str, int, str], list[_Sample]] = {}
    for one in samples:
        curves.setdefault((one.curve, one.height, one.side), []).append(one)
    fits: dict[tuple[str, int, str], list[CurveCoefficients | None]] = {}
    widths: dict[tuple[str, int, str], float] = {}
    heights: dict[tuple[str, int, str], float] = {}
    for (curve, height, side), rows in curves.items():
        d, f = np.array([(one.deformation_m, one.force_N) for one in rows]).T
        try:
            found = fit_curve(d, f, noise)
        except InputError as error:
            raise InputError(
                path, error.problem, field=f"curve of {side}{height}", remedy=error.remedy
            ) from error
        touch = curve, height, side[0]
        fits.setdefault(touch, [None, None])[side[1] == "-"] = found
        for sizes, key in ((widths, "width_m"), (heights, "object_height_m")):
            known = [value for one in rows if math.isfinite(value := getattr(one, key))]
            sizes[touch] = known[-1] if known else sizes.get(touch, math.nan)
    return tuple(
        TouchReading(
            height, axis, (both[0], both[1]), widths[curve, height, axis], heights[curve, height, axis]
        )
        for (curve, height, axis), both in fits.items()
    )


def _samples(path: Path, more: tuple[str, ...]) -> Iterator[_Sample]:
    names, rows = read_csv(path, ("side", "force_N", "deformation_m", *more))
    place = "at" if "at" in names and "height" not in names else "height"
    check_columns(path, names, (place,))
    for number, row in enumerate(rows):
        if number >= MAX_SAMPLES:
            raise InputError(path, f"has more than {MAX_SAMPLES} samples")
        yield _sample(row, place, more)


def _sample(row: CsvRow, place: str, more: tuple[str, ...]) -> _Sample:
    side = row["side"]
    if side not in SIDES:
        raise row.problem(f"found {side!r}, expected one of {', '.join(SIDES)}", "side")
    height = row.number(place)
    if place == "at":
        if not 0 <= height <= 1:
            raise row.problem(f"found {height:g} of the height, expected 0 to 1", place)
        height = min(math.floor(height * HEIGHTS), HEIGHTS - 1) + 1
    if height not in range(1, HEIGHTS + 1):
        raise row.problem(f"found height {height:g}, expected 1 to {HEIGHTS}", place)
    sizes = [_size(row, key) for key in ("width_m", "object_height_m")]
    # Names that differ by the number of spaces only are the same name.
    label, name, curve = (" ".join(row.get(key).split()) for key in ("label", "object", "curve"))
    if "label" in more and not label:
        raise row.problem("found no label, expected the class of the object", "label")
    sample = row.number("deformation_m"), row.number("force_N")
    if abs(sample[1]) > MAX_FORCE_N:
        raise row.problem(
            f"found {sample[1]:g}, expected newtons, up to {MAX_FORCE_N:g}; divide millinewtons by 1000",
            "force_N",
        )
    return _Sample(label, name, curve, int(height), side, *sample, *sizes)


def _size(row: CsvRow, key: str) -> float:
    """Size [m]; NaN without that column or in an empty field."""
    if not row.get(key):
        return math.nan
    size = row.number(key)
    if not 0 < size <= MAX_SIZE_m:
        raise row.problem(f"found {size:g}, expected 0 to {MAX_SIZE_m:g} m", key)
    return size
