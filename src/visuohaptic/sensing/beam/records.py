"""CSV files of the beam sensor: known loads for its calibration, and poses of templates."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from ...core import CalibrationError, InputError, Pose, Reason
from ...core.files import MAX_TEXT_BYTES, CsvRow, read_csv
from .observation import TemplateMeasurement

_AXES = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")
_SHORT = {"fx": "fx_n", "fy": "fy_n", "fz": "fz_n", "tx": "mx_nm", "ty": "my_nm", "tz": "mz_nm",
          "mx": "mx_nm", "my": "my_nm", "mz": "mz_nm"}  # fmt: skip
_PLACE = ("x_m", "y_m", "z_m")
_TURNS = {
    "rad": (("rx_rad", "ry_rad", "rz_rad"), 1.0, False),
    "rpy_deg": (("roll_deg", "pitch_deg", "yaw_deg"), np.pi / 180, True),
    "rpy_rad": (("roll_rad", "pitch_rad", "yaw_rad"), 1.0, True),
    "rpy": (("roll", "pitch", "yaw"), 1.0, True),
}

#: Columns of a file of template poses; c00 ... c55 is the upper triangle of the covariance.
POSE_COLUMNS = (
    *("t_s", "name", "valid", "reason", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"),
    *(f"c{i}{j}" for i in range(6) for j in range(i, 6)),
)


@dataclass(frozen=True, slots=True, eq=False)
class LoadRecord:
    """Known loads on the tip and the observations; n rows."""

    load: Float[np.ndarray, "n 6"]  #: applied at the tip, frame S [N, Nm]
    observed: Float[np.ndarray, "n 6"]  #: a wrench [N, Nm], or the tip's (d, phi) [m, rad]
    kind: Literal["wrench", "motion"]  #: kind of the observation
    line: Int[np.ndarray, "n"]  #: in the file
    where: str = "loads"


def read_loads(path: Path | str, *, angles: Literal["deg", "rad"] | None = None) -> LoadRecord:
    """Read known loads: ``fx_N ... mz_Nm`` with the readings of the sensor or a tracker.

    The observation is either the reading of the uncalibrated sensor
    (``read_fx_N ... read_mz_Nm``), or the motion of the tip: ``x_m, y_m, z_m`` with
    a rotation vector ``rx_rad, ry_rad, rz_rad`` or with ``roll_deg, pitch_deg,
    yaw_deg`` about fixed axes.

    Parameters
    ----------
    path
        The CSV file.
    angles
        Unit of columns ``roll, pitch, yaw`` without one.

    Raises
    ------
    CalibrationError
        A column is missing or a row cannot be read; the message states the line.
    """
    written, rows = read_csv(path, max_bytes=MAX_TEXT_BYTES, spreadsheet=True, error=CalibrationError)
    short = _SHORT | {"x": "x_m", "y": "y_m", "z": "z_m"}
    # Standard name -> name in the file.
    index = {short.get(name, name): name for name in written}
    if len(index) != len(written):
        raise CalibrationError(path, "found a column name twice", field="header")
    table = list(rows)

    def columns(requested: Iterable[str]) -> np.ndarray:
        missing = [name for name in requested if name not in index]
        if missing:
            raise CalibrationError(
                path,
                f"found columns {', '.join(index)[:120]}; missing: {', '.join(missing)}",
                field="header",
                remedy="give fx_N ... mz_Nm and read_fx_N ... read_mz_Nm, or x_m y_m z_m rx_rad ry_rad rz_rad",
            )
        return np.array([[row.number(index[name]) for name in requested] for row in table])

    load = columns(_AXES)
    line = np.array([row.line for row in table])
    if "read_fx_n" in index:
        return LoadRecord(load, columns([f"read_{name}" for name in _AXES]), "wrench", line, str(path))
    place = columns(_PLACE)
    kind = next((kind for kind, (three, _, _) in _TURNS.items() if three[0] in index), "rad")
    three, factor, euler = _TURNS[kind]
    if kind == "rpy":
        if angles is None:
            raise CalibrationError(
                path,
                "the unit of roll, pitch, yaw is not stated",
                field="header",
                remedy="name them roll_deg, pitch_deg, yaw_deg, or give --angles deg",
            )
        factor = np.pi / 180 if angles == "deg" else 1.0
    turn = factor * columns(three)
    if np.abs(turn).max() > np.pi:
        raise CalibrationError(
            path, f"found an angle of {np.abs(turn).max():g} rad", field=three[0], remedy="check the unit"
        )
    if euler:
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_euler("xyz", turn).as_rotvec()
    return LoadRecord(load, np.hstack([place, turn]), "motion", line, str(path))


def read_template_poses(path: Path | str) -> Iterator[tuple[float, list[TemplateMeasurement]]]:
    """Frames (t_s, templates) of a CSV file with :data:`POSE_COLUMNS`; rows of a frame are consecutive.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    InputError
        Contains the line, the found and the expected value.
    """
    _, rows = read_csv(path, POSE_COLUMNS, max_bytes=MAX_TEXT_BYTES)
    now: float | None = None
    frame: list[TemplateMeasurement] = []
    for row in rows:
        t_s = row.number("t_s")
        if now is not None and t_s != now:
            yield now, frame
            frame = []
        now = t_s
        frame.append(_template(row))
    if now is not None:
        yield now, frame


def _template(row: CsvRow) -> TemplateMeasurement:
    name, valid = row["name"], row["valid"].lower()
    try:
        reason = Reason(row["reason"])
    except ValueError:
        problem = f"found {row['reason'][:20]!r}, expected one of {', '.join(Reason)}"
        raise row.problem(problem, "reason") from None
    if valid not in ("true", "false"):
        raise row.problem(f"found {valid[:20]!r}, expected true or false", "valid")
    if valid == "false":
        return TemplateMeasurement.missing(name, reason if reason is not Reason.OK else Reason.LOST)
    numbers = np.array([row.number(column) for column in POSE_COLUMNS[4:]])
    covariance = np.zeros((6, 6))
    covariance[np.triu_indices(6)] = numbers[7:]
    covariance = covariance + np.triu(covariance, 1).T
    if np.linalg.eigvalsh(covariance).min() <= 0:
        raise row.problem("the covariance is not positive definite", "c00")
    try:
        pose = Pose.from_quaternion(numbers[3:7], numbers[:3])
    except InputError as error:
        raise row.problem(error.problem, "qx") from error
    return TemplateMeasurement(name, pose, covariance)
