"""CSV files of the beam sensor: known loads for its calibration, and poses of templates."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from ...core.camera.pose import Pose
from ...core.errors import CalibrationError, InputError
from ...core.files import read_text
from ...core.measurement import Reason
from .observation import TemplateMeasurement

__all__ = ["POSE_COLUMNS", "LoadRecord", "read_loads", "read_template_poses", "write_template_poses"]

#: Larger files are rejected (bytes).
MAX_BYTES = 256 * 1024 * 1024

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
    names, rows = _table(path, CalibrationError)
    names = [_SHORT.get(name, {"x": "x_m", "y": "y_m", "z": "z_m"}.get(name, name)) for name in names]
    index = {name: place for place, name in enumerate(names)}
    if len(index) != len(names):
        raise CalibrationError(path, "found a column twice", field="header")

    def columns(requested: Iterable[str]) -> np.ndarray:
        missing = [name for name in requested if name not in index]
        if missing:
            raise CalibrationError(
                path,
                f"found columns {', '.join(names)[:120]}; {', '.join(missing)} is missing",
                field="header",
                remedy="give fx_N ... mz_Nm and read_fx_N ... read_mz_Nm, or x_m y_m z_m rx_rad ry_rad rz_rad",
            )
        places = [index[name] for name in requested]
        return np.array(
            [
                [_number(path, line, names[k], cells[k], CalibrationError) for k in places]
                for line, cells in rows
            ]
        )

    load = columns(_AXES)
    line = np.array([number for number, _ in rows])
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


def write_template_poses(
    path: Path | str, frames: Iterable[tuple[float, Iterable[TemplateMeasurement]]]
) -> None:
    """Write poses of templates, one row per frame and template.

    Parameters
    ----------
    path
        Output CSV file.
    frames
        Time [s] and templates of each frame.
    """
    from ...core.files import atomic_path

    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(POSE_COLUMNS)
        for t_s, templates in frames:
            for template in templates:
                pose = template.T_camera_template
                numbers = (
                    np.full(7, np.nan)
                    if pose is None
                    else np.hstack([pose.translation_m, pose.quaternion_xyzw])
                )
                upper = template.covariance[np.triu_indices(6)]
                head = [repr(float(t_s)), template.name, str(template.valid).lower(), template.reason.value]
                writer.writerow([*head, *(repr(float(value)) for value in (*numbers, *upper))])


def read_template_poses(path: Path | str) -> Iterator[tuple[float, list[TemplateMeasurement]]]:
    """Frames (t_s, templates) of a file of :func:`write_template_poses`; rows of a frame are consecutive.

    Parameters
    ----------
    path
        CSV file of :func:`write_template_poses`.

    Raises
    ------
    InputError
        Contains the line, the found and the expected value.
    """
    names, rows = _table(path, InputError)
    if names != [name.lower() for name in POSE_COLUMNS]:
        raise InputError(path, f"found columns {', '.join(names)[:80]}", field="header",
                         remedy=f"expected {', '.join(POSE_COLUMNS[:11])}, c00 ... c55")  # fmt: skip
    now: float | None = None
    frame: list[TemplateMeasurement] = []
    for line, cells in rows:
        t_s = _number(path, line, "t_s", cells[0], InputError)
        if now is not None and t_s != now:
            yield now, frame
            frame = []
        now = t_s
        frame.append(_template(path, line, cells))
    if now is not None:
        yield now, frame


def _template(path: Path | str, line: int, cells: list[str]) -> TemplateMeasurement:
    name, valid = cells[1].strip(), cells[2].strip().lower()
    try:
        reason = Reason(cells[3].strip())
    except ValueError:
        raise InputError(path, f"found {cells[3][:20]!r}, expected one of {', '.join(Reason)}",
                         field=f"line {line}: reason") from None  # fmt: skip
    if valid not in ("true", "false"):
        raise InputError(path, f"found {valid[:20]!r}, expected true or false", field=f"line {line}: valid")
    if valid == "false":
        return TemplateMeasurement.missing(name, reason if reason is not Reason.OK else Reason.LOST)
    numbers = np.array([
        _number(path, line, POSE_COLUMNS[k], cells[k], InputError) for k in range(4, len(POSE_COLUMNS))
    ])  # fmt: skip
    covariance = np.zeros((6, 6))
    covariance[np.triu_indices(6)] = numbers[7:]
    covariance = covariance + np.triu(covariance, 1).T
    if np.linalg.eigvalsh(covariance).min() <= 0:
        raise InputError(path, "the covariance is not positive definite", field=f"line {line}: c00")
    try:
        pose = Pose.from_quaternion(numbers[3:7], numbers[:3])
    except InputError as error:
        raise InputError(path, error.problem, field=f"line {line}: qx") from error
    return TemplateMeasurement(name, pose, covariance)


def _table(path: Path | str, error: type[InputError]) -> tuple[list[str], list[tuple[int, list[str]]]]:
    path = Path(path)
    text = read_text(path, MAX_BYTES, error=error)
    reader = csv.reader(text.splitlines())
    try:
        lines = [(reader.line_num, cells) for cells in reader if any(cell.strip() for cell in cells)]
    except csv.Error as problem:
        raise error(path, f"is not CSV: {problem}", field=f"line {reader.line_num}") from problem
    if len(lines) < 2:
        raise error(path, "has no rows, expected a header line and rows")
    names = [name.strip().lower() for name in lines[0][1]]
    for line, cells in lines[1:]:
        if len(cells) != len(names):
            raise error(path, f"found {len(cells)} cells, expected {len(names)}", field=f"line {line}")
    return names, lines[1:]


def _number(path: Path | str, line: int, name: str, text: str, error: type[InputError]) -> float:
    try:
        value = float(text)
    except ValueError:
        raise error(path, f"found {text[:20]!r}, expected a number", field=f"line {line}: {name}") from None
    if not np.isfinite(value):
        raise error(path, f"found {text.strip()}, expected a finite number", field=f"line {line}: {name}")
    return value
