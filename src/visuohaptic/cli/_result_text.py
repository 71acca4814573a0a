"""Results as text for display: names, values and units whose prefixes fit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any


def result_lines(value: Any, indent: str = "", unit: str = "") -> Iterator[str]:
    """Write a plain result as text: one field per line, nested fields are indented and have the unit of their group.

    Parameters
    ----------
    value
        Mappings, sequences, numbers and texts; names end in the unit, as in ``narrowest_width_m``.
    indent
        Put before every line.
    unit
        Of values whose names end in none.
    """
    pairs = (
        value.items() if isinstance(value, dict) else ((f"{i + 1}.", item) for i, item in enumerate(value))
    )
    for name, item in pairs:
        label, own = _label(str(name))
        if isinstance(item, (dict, list)) and item and not _is_flat(item):
            yield f"{indent}{label}"
            yield from result_lines(item, indent + "  ", own or unit)
        elif len(text := _flat_text(item, own or unit)) > _LINE and isinstance(item, list):
            yield f"{indent}{label}"
            yield from (f"{indent}  {_flat_text(part, own or unit)}" for part in item)
        else:
            yield f"{indent}{label}: {text}"


#: Characters of a list, beyond which each of its values has a line of its own.
_LINE = 100

#: Units that end the names of fields, as they are written.
_UNITS = {
    unit.replace("/", "_per_"): unit
    for unit in ("m", "s", "N", "Pa", "kg", "J", "rad", "px", "Hz", "N/m", "rad/m", "s/m", "m/s")
} | {"m2": "m²", "m3": "m³"}

#: Units whose values are written with a prefix: the unit that takes it, its size, and the largest power of ten.
_PREFIXED = {unit: (unit, 1.0, 9) for unit in ("N", "Pa", "J", "Hz", "N/m")} | {
    "m": ("m", 1.0, 0),
    "s": ("s", 1.0, 0),
    "kg": ("g", 1e-3, 3),
    "m³": ("L", 1e-3, 0),
}
_PREFIXES = {9: "G", 6: "M", 3: "k", 0: "", -3: "m", -6: "µ", -9: "n"}


def _label(name: str) -> tuple[str, str]:
    """``narrowest_width_m`` as ``narrowest width``, ``m``."""
    for end, unit in sorted(_UNITS.items(), key=lambda pair: -len(pair[0])):
        if name.endswith(f"_{end}"):
            return name[: -len(end) - 1].replace("_", " "), unit
    return name.replace("_", " "), ""


def _is_flat(value: Any) -> bool:
    return isinstance(value, list) and not any(isinstance(item, (dict, list)) for item in value)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _flat_text(value: Any, unit: str = "") -> str:
    """Numbers in the unit whose prefix fits the largest of them; nothing else has a unit."""
    items = value if isinstance(value, list) else [value]
    numbers = [abs(item) for item in items if _is_number(item) and math.isfinite(item)]
    if not numbers:
        return _plain_text(value)
    if unit in _PREFIXED:
        symbol, size, highest = _PREFIXED[unit]
        largest = max(numbers) / size
        power = 3 * math.floor(math.log10(largest) / 3 + 1e-9) if largest else 0
        power = min(max(power, min(_PREFIXES)), highest)
        value = [item / (size * 10.0**power) if _is_number(item) else item for item in items]
        unit = _PREFIXES[power] + symbol
    return f"{_plain_text(value)} {unit}".rstrip()


def _plain_text(value: Any) -> str:
    if isinstance(value, (list, dict)):
        return ", ".join(_plain_text(item) for item in value) if value else "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "none" if value is None else _number(value) if isinstance(value, float) else str(value)


def _number(value: float) -> str:
    """Four digits; milliseconds of times since 1970."""
    return f"{value:.3f}" if 1e6 <= abs(value) < 1e12 else f"{value:.4g}"
