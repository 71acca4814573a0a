"""Validated input of press records from CSV files: stress over strain, and contours under a plate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ....core.errors import CalibrationError
from ....core.files import MAX_TEXT_BYTES, read_csv

#: No foam is so soft that its stress stays below this [Pa]; values in kPa without a unit would.
SOFTEST_Pa = 150.0

_STRAIN = {"strain": 1.0, "strain_percent": 0.01, "strain_pct": 0.01, "strain_%": 0.01}
_STRESS = {"stress": 1.0, "stress_pa": 1.0, "stress_kpa": 1e3, "stress_mpa": 1e6}
_DIRECTION = ("direction", "direction_of_loading", "loading_direction")
_LOADING = {"loading", "load", "increasing", "up", "1", "+1"}
_UNLOADING = {"unloading", "unload", "decreasing", "down", "-1"}
_read_table = partial(read_csv, max_bytes=MAX_TEXT_BYTES, spreadsheet=True, error=CalibrationError)


@dataclass(frozen=True, slots=True, eq=False)
class StrainStress:
    """Calibration points in the order of measurement; compression positive."""

    strain: Float[np.ndarray, "n"]
    stress_Pa: Float[np.ndarray, "n"]
    direction: Int[np.ndarray, "n"]  #: +1 loading, -1 unloading
    where: str = "strain and stress"  #: file, for messages

    @property
    def loading(self) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
        """Strain and stress of the points of increasing load."""
        return self.strain[self.direction > 0], self.stress_Pa[self.direction > 0]

    @property
    def unloading(self) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
        """Strain and stress of the points of decreasing load."""
        return self.strain[self.direction < 0], self.stress_Pa[self.direction < 0]


@dataclass(frozen=True, slots=True, eq=False)
class PlateRecord:
    """One depth of a body pressed into the strip: the contour and the force on the body."""

    depth_m: float
    force_N: float
    s_m: Float[np.ndarray, "k"]
    delta_m: Float[np.ndarray, "k"]


def direction_from_order(strain: Float[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
    """Derive the direction of loading from the order of the points.

    The record is split at its reversals; oscillations smaller than 5 % of the
    strain range are noise and do not reverse the direction.

    Parameters
    ----------
    strain
        Strains in the order of measurement.

    Returns
    -------
    ndarray of int, shape (n,)
        +1 loading, -1 unloading.
    """
    threshold = 0.05 * float(np.ptp(strain))
    direction = np.ones(len(strain), dtype=np.int64)
    turn, sign = 0, 1
    for i in range(1, len(strain)):
        if sign * (strain[i] - strain[turn]) >= 0:
            turn = i
        elif sign * (strain[turn] - strain[i]) > threshold:
            direction[turn + 1 :] = -sign
            turn, sign = i, -sign
    return direction


def read_strain_stress(path: Path | str) -> StrainStress:
    """Read ``strain, stress_Pa[, direction]`` from a CSV file.

    The unit is in the column's name: ``strain`` (1) or ``strain_percent``, and
    ``stress_Pa`` (or ``stress``), ``stress_kPa`` or ``stress_MPa``. The direction is ``loading`` or
    ``unloading``; without that column it follows from the order of the strain.

    Parameters
    ----------
    path
        CSV file of a press.

    Raises
    ------
    CalibrationError
        A column is missing or a row cannot be read; the message states the line.
    """
    names, rows = _read_table(path)
    strain_name = _one_of(path, names, _STRAIN, "strain")
    stress_name = _one_of(path, names, _STRESS, "stress")
    direction_name = next((name for name in _DIRECTION if name in names), "")
    strain, stress, direction, lines = [], [], [], []
    for row in rows:
        strain.append(row.number(strain_name) * _STRAIN[strain_name])
        stress.append(row.number(stress_name) * _STRESS[stress_name])
        lines.append(row.line)
        if direction_name:
            text = row[direction_name].lower()
            if text not in _LOADING and text not in _UNLOADING:
                raise row.problem(f"found {text[:20]!r}, expected loading or unloading", direction_name)
            direction.append(1 if text in _LOADING else -1)
    strain_values, stress_values = np.array(strain), np.array(stress)
    too_far = np.flatnonzero((strain_values < -0.01) | (strain_values >= 1.0))
    if len(too_far):
        i = int(too_far[0])
        percent = strain_values.max() > 1.5
        raise CalibrationError(
            path,
            f"found strain {strain_values[i]:g}, expected 0 <= strain < 1",
            field=f"line {lines[i]}, {strain_name}",
            remedy="name the column strain_percent if it is in percent" if percent else "",
        )
    if stress_values.size and _STRESS[stress_name] == 1.0 and 0 < stress_values.max() < SOFTEST_Pa:
        raise CalibrationError(
            path,
            f"found at most {stress_values.max():g} Pa, expected more than {SOFTEST_Pa:g} Pa: no foam is so soft",
            field=stress_name,
            remedy="name the column stress_kPa or stress_MPa if it is in these",
        )
    if not direction_name:
        directions = direction_from_order(strain_values)
    else:
        directions = np.array(direction, dtype=np.int64)
    return StrainStress(strain_values, stress_values, directions, str(path))


def read_plate(path: Path | str) -> tuple[PlateRecord, ...]:
    """Read contours under a body: ``depth_m, force_N, s_m, delta_m`` in long format.

    Parameters
    ----------
    path
        CSV file, a row for each point of a contour.

    Raises
    ------
    CalibrationError
        A column is missing, a row cannot be read, or a depth has too few points.
    """
    columns = ("depth_m", "force_n", "s_m", "delta_m")
    table = np.array([[row.number(name) for name in columns] for row in _read_table(path, columns)[1]])
    records = []
    for depth in np.unique(table[:, 0]):
        part = table[table[:, 0] == depth]
        part = part[np.argsort(part[:, 2], kind="stable")]
        where = f"depth {depth:g} m"
        if len(part) < 10 or np.any(np.diff(part[:, 2]) <= 0):
            raise CalibrationError(
                path, f"found {len(part)} points, expected 10 or more at different s_m", field=where
            )
        if np.ptp(part[:, 1]) > 1e-9 + 1e-6 * abs(part[0, 1]) or part[0, 1] <= 0:
            raise CalibrationError(path, "expected one positive force_N for the whole depth", field=where)
        records.append(PlateRecord(float(depth), float(part[0, 1]), part[:, 2].copy(), part[:, 3].copy()))
    return tuple(records)


def _one_of(path: Path | str, names: list[str], known: dict[str, float], what: str) -> str:
    found = [name for name in names if name in known]
    if len(found) != 1:
        raise CalibrationError(
            path,
            f"found columns {', '.join(names)[:120]}; expected one of {', '.join(known)} for the {what}",
            field="header",
            remedy="name the columns with their unit, for example strain,stress_Pa,direction",
        )
    return found[0]
