"""The files ``beam.yaml`` (a beam and its calibration) and ``sensor.yaml`` (a whole beam sensor)."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, FiniteFloat

from ...core import InputError, load_yaml_model, save_yaml
from ...core.errors import brief_list
from ..config_fields import PoseSection, Positive, Section
from .correction import Correction
from .mechanics import Beam
from .sensor import BeamSetup
from .zero import BeamDriftSettings

Row6 = Annotated[list[FiniteFloat], Field(min_length=6, max_length=6)]
Matrix6 = Annotated[list[Row6], Field(min_length=6, max_length=6)]


class _CorrectionSection(Section):
    matrix: Matrix6
    row_covariance: Annotated[list[Matrix6], Field(min_length=6, max_length=6)]
    #: Missing in files of older versions: errors of the templates' positions then count in full.
    place_left: Annotated[list[Annotated[float, Field(ge=0, le=1)]], Field(min_length=6, max_length=6)] = [
        1.0
    ] * 6


class _BeamFile(Section):
    """Fields of :class:`Beam`; omitted ones keep their defaults."""

    kind: Literal["beam_material"] = "beam_material"
    beam: dict[str, FiniteFloat] = Field(default_factory=dict)
    calibration: _CorrectionSection | None = None


class _TemplateSection(Section):
    name: str  #: of its image
    xi: Annotated[float, Field(ge=0.05, le=1)]  #: position on the rod, x / L


class _DriftSection(Section):
    time_constant_s: Positive = 30.0  #: of the adaptation
    rest_s: Positive = 1.0  #: time of negligible load before the adaptation starts
    rest: Positive = 0.005  #: a load below this fraction of full scale is negligible
    limit: Positive = 0.02  #: fraction of full scale beyond which accumulated drift is not valid


class BeamSensorConfig(Section):
    """Fields of ``sensor.yaml``; file names are relative to its folder."""

    kind: Literal["beam"]
    beam: str = "beam.yaml"  #: parts of the sensor, written by ``visuohaptic calibrate beam``
    camera: str | None = None  #: required to track templates in images, not to read poses
    templates_folder: str | None = None  #: images of the templates, for the same
    reference: str = "reference"  #: name of the template on the base
    templates: Annotated[list[_TemplateSection], Field(min_length=1, max_length=31)]  #: on the rod
    T_reference_sensor: PoseSection  #: transforms frame S (origin in the clamp, X along the rod) to it
    view: Literal["moving", "steady"] = "moving"  #: steady: camera and base are rigidly connected
    model: Literal["auto", "linear", "exact"] = "auto"  #: of the rod; auto: exact for large deflections
    zero: str = "zero.yaml"  #: written by ``visuohaptic sense beam --zero``
    drift: _DriftSection = _DriftSection()  #: adaptation of the zero to slow changes at rest
    stress_limit: Annotated[float, Field(gt=0, le=1)] = 0.9  #: of the yield stress; beyond it: saturated
    max_age_s: Positive = 0.2  #: an older frame is stale

    @classmethod
    def load(cls, path: Path | str) -> BeamSetup:
        """Read the file and the beam that it names.

        Parameters
        ----------
        path
            ``sensor.yaml`` with ``kind: beam``.

        Raises
        ------
        InputError
            As of :meth:`.FoamSensorConfig.load`.
        """
        path = Path(path)
        config = load_yaml_model(path, cls)
        beam, correction = load_beam(path.parent / config.beam)
        names = [template.name for template in config.templates]
        if len(set(names)) != len(names):
            raise InputError(path, f"found a name twice in {brief_list(names)}", field="templates")
        try:
            pose = config.T_reference_sensor.pose()
            return BeamSetup(
                {template.name: template.xi for template in config.templates},
                pose,
                beam,
                correction,
                config.reference,
                config.view,
                config.model,
                drift=BeamDriftSettings(**config.drift.model_dump()),
                stress_limit=config.stress_limit,
                max_age_s=config.max_age_s,
                zero_path=path.parent / config.zero,
                camera_path=None if config.camera is None else path.parent / config.camera,
                templates_path=None
                if config.templates_folder is None
                else path.parent / config.templates_folder,
            )
        except InputError as error:
            raise InputError(path, error.problem, field=error.field or error.where) from error


def load_beam(path: Path | str) -> tuple[Beam, Correction | None]:
    """Read ``beam.yaml``: the parts, and the calibration if present.

    Parameters
    ----------
    path
        ``beam.yaml``.

    Returns
    -------
    tuple of Beam and Correction or None
        The parts, and the calibration if present.
    """
    data = load_yaml_model(path, _BeamFile)
    known = {entry.name for entry in fields(Beam)}
    unknown = sorted(set(data.beam) - known)
    if unknown:
        raise InputError(
            path, f"unknown field, expected one of {', '.join(sorted(known))}", field=f"beam.{unknown[0]}"
        )
    try:
        beam = Beam(**data.beam)
    except InputError as error:
        raise InputError(path, error.problem, field=f"beam.{error.field}", remedy=error.remedy) from error
    if data.calibration is None:
        return beam, None
    matrix, rows = np.array(data.calibration.matrix), np.array(data.calibration.row_covariance)
    rows = 0.5 * (rows + rows.transpose(0, 2, 1))
    if (
        np.linalg.cond(np.eye(6) + matrix) > 1e8
        or min(np.linalg.eigvalsh(row).min() for row in rows) < -1e-12
    ):
        raise InputError(
            path, "is not a valid correction: singular, or a covariance is negative", field="calibration"
        )
    return beam, Correction(matrix, rows, np.array(data.calibration.place_left))


def save_beam(path: Path | str, beam: Beam, correction: Correction | None = None) -> None:
    """Write ``beam.yaml`` atomically.

    Parameters
    ----------
    path
        Output file.
    beam
        Parts of the sensor and their tolerances.
    correction
        From :func:`calibrate_beam`; None: not calibrated.
    """
    data: dict[str, Any] = {"kind": "beam_material", "beam": {k: float(v) for k, v in asdict(beam).items()}}
    if correction is not None:
        data["calibration"] = {
            "matrix": _plain(correction.matrix),
            "row_covariance": _plain(correction.row_covariance),
            "place_left": _plain(correction.place_left),
        }
    save_yaml(path, data)


def _plain(values: np.ndarray) -> Any:
    return (
        [_plain(part) for part in values] if values.ndim > 1 else [float(f"{value:.9g}") for value in values]
    )
