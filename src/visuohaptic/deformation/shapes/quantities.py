"""Numbers with units in YAML: ``35 mm``, ``5 %``, ``[30 mm, 40 mm]`` for a range."""

from __future__ import annotations

import math
import re
from typing import Annotated, Any

from pydantic import BeforeValidator

#: Factor to SI units, by kind of quantity.
UNITS: dict[str, dict[str, float]] = {
    "length": {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "in": 0.0254},
    "pressure": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "bar": 1e5},
    "angle": {"rad": 1.0, "deg": math.pi / 180, "°": math.pi / 180},
    "fraction": {"": 1.0, "%": 0.01},
}
_PATTERN = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\d\s]*)\s*")

#: One value or a range from low to high, in SI units.
Span = tuple[float, float]


def quantity(found: Any, kind: str) -> float:
    """A number in SI units, or a text with a unit.

    Parameters
    ----------
    found
        Number in SI units, or a text with a unit.
    kind
        ``length``, ``pressure``, ``angle`` or ``fraction``.

    Raises
    ------
    ValueError
        Not a finite number with a known unit; pydantic adds the field.

    Examples
    --------
    >>> quantity("35 mm", "length")
    0.035
    """
    units = UNITS[kind]
    if isinstance(found, bool) or not isinstance(found, int | float | str):
        raise ValueError(f"expected a number or a text like '{_example(kind)}'")
    if isinstance(found, str):
        match = _PATTERN.fullmatch(found[:64])
        if match is None or match[2] not in units:
            raise ValueError(f"expected a text like '{_example(kind)}', with a unit of {', '.join(units)}")
        found = float(match[1]) * units[match[2]]
    if not math.isfinite(found):
        raise ValueError("expected a finite number")
    # 35 * 1e-3 is 0.035000000000000003: return the decimal number as written.
    return float(f"{found:.12g}")


def _span(kind: str) -> Any:
    def read(found: Any) -> Span:
        if isinstance(found, list | tuple):
            if len(found) != 2:
                raise ValueError("expected one value or a range [low, high]")
            low, high = (quantity(value, kind) for value in found)
            if low > high:
                raise ValueError(f"expected low <= high in the range, found {low:g} to {high:g}")
            return low, high
        value = quantity(found, kind)
        return value, value

    return BeforeValidator(read)


def _example(kind: str) -> str:
    return {"length": "35 mm", "pressure": "2.5 GPa", "angle": "30 deg", "fraction": "5 %"}[kind]


Length = Annotated[Span, _span("length")]
Pressure = Annotated[Span, _span("pressure")]
Angle = Annotated[Span, _span("angle")]
Fraction = Annotated[Span, _span("fraction")]
