"""Material of a foam strip: its calibrated stress curves, its size, and their file.

Symbols: eps strain (deflection / width), w width along the compression, h height
of the strip across the contour. Dissertation Sec. 3.2.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ....core.errors import InputError
from .hysteresis import HysteresisLaw
from .stress_curve import CurveKind, StressCurve
from .tension import Tension, expanded, softening

if TYPE_CHECKING:
    from pydantic import BaseModel


#: Largest number of parameters of a curve in a file: a spline has about ten.
MAX_PARAMETERS = 64


@dataclass(frozen=True, eq=False)
class FoamMaterial:
    """Calibrated foam strip.

    ``loading`` is the curve of increasing stress that is used for measurement; ``unloading``, if known,
    is the unloading curve from ``unloading_peak_strain``, and ``hysteresis`` the law of all
    other unloading paths. Without it unloading points are flagged and not valid.
    """

    loading: StressCurve
    width_m: float  #: w, thickness of the strip along the compression
    height_m: float  #: h, extent of the strip across the contour
    working_strain: tuple[float, float]  #: the plateau, where the foam is most sensitive
    densification_strain: float  #: readings beyond it are saturated
    residual_Pa: float  #: standard deviation of the calibration points about ``loading``
    unloading: StressCurve | None = None
    unloading_peak_strain: float = 0.0  #: strain at which the calibration changed to unloading
    hysteresis: HysteresisLaw | None = None  #: identified from the unloading points
    tension: Tension = field(default_factory=Tension)
    section: str = "rectangle"

    def __post_init__(self) -> None:
        low, high = self.working_strain
        problems = []
        for name in ("width_m", "height_m"):
            value = getattr(self, name)
            if not 1e-4 <= value <= 1.0:
                problems.append(f"{name} is {value}, expected 0.0001 to 1 m")
        if not 0 <= low < high <= self.densification_strain < 1:
            problems.append(
                f"working_strain {self.working_strain} and densification_strain "
                f"{self.densification_strain}, expected 0 <= low < high <= densification < 1"
            )
        if min(curve.minimum_slope()[1] for curve in (self.loading, self.narrow)) <= 0:
            problems.append("the loading curve is not rising everywhere")
        if not (np.isfinite(self.residual_Pa) and self.residual_Pa >= 0):
            problems.append(f"residual_Pa is {self.residual_Pa}, expected a number >= 0")
        if self.unloading is not None and not 0 < self.unloading_peak_strain < 1:
            problems.append("an unloading curve needs unloading_peak_strain between 0 and 1")
        if problems:
            raise InputError("FoamMaterial", "; ".join(problems), remedy="calibrate again")

    @cached_property
    def narrow(self) -> StressCurve:
        """Loading curve under bodies narrower than the strip, reduced by the lateral expansion of the foam."""
        taken, sigma = self._taken, self.tension.lateral_sigma
        return replace(
            self.loading,
            parameters=self.loading.parameters + self.tension.lateral * taken,
            covariance=self.loading.covariance + sigma**2 * np.outer(taken, taken),
        )

    @cached_property
    def _taken(self) -> Float[np.ndarray, "p"]:
        """Derivative of the parameters of :attr:`narrow` by the lateral expansion [Pa]."""
        strain = np.linspace(0.0, self.loading.max_strain, 201)
        stress = -self.loading.stress(strain) * strain**2
        result: Float[np.ndarray, "p"] = np.linalg.lstsq(self.loading.basis(strain), stress)[0]
        return result

    def pressed_force_N(self, delta_m: Float[np.ndarray, "K"], cell_m: Float[np.ndarray, "K"]) -> float:
        """Force of foam whose deflection is constant along each cell [N].

        Parameters
        ----------
        delta_m
            Deflection of each point [m], which may be infinite.
        cell_m
            Length of foam that each point represents [m].
        """
        if not delta_m.any():
            return 0.0
        pressure = self.stress(np.minimum(delta_m / self.width_m, 1.0))
        return self.height_m * float(cell_m @ pressure)

    def expansion_N(
        self, by_parameters: Float[np.ndarray, "R p"], top: Float[np.ndarray, "R"]
    ) -> Float[np.ndarray, "2 R"]:
        """Derivative of the force of R contacts by the lateral expansion, in :attr:`narrow` and at their own breadths [N].

        Parameters
        ----------
        by_parameters
            Derivative of each force by the parameters of the curve [m^2].
        top
            Largest strain of each contact.
        """
        narrow = by_parameters @ self._taken
        most = self.height_m * self.loading.stress(top) * top**2
        breadth = np.maximum(-narrow, 0.0) / np.maximum(most, np.finfo(float).tiny)
        return np.stack([narrow, narrow * expanded(breadth, self.width_m)])

    def force_sigma_N(
        self, by_parameters: Float[np.ndarray, "p"], by_ratio_N: float, by_lateral_N: float
    ) -> float:
        """Standard deviation of a force from the calibration of curve and tension [N].

        Parameters
        ----------
        by_parameters
            Derivative of the force by the parameters of the curve [m^2].
        by_ratio_N, by_lateral_N
            Derivatives of the force by the ratio of the tension and by the lateral expansion [N].
        """
        ratio_N, lateral_N = self.tension.sigma * by_ratio_N, self.tension.lateral_sigma * by_lateral_N
        variance = float(by_parameters @ self.loading.covariance @ by_parameters)
        variance += ratio_N**2 + lateral_N**2 + 2.0 * self.tension.correlation * ratio_N * lateral_N
        return float(np.sqrt(max(variance, 0.0)))

    def stress(self, strain: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Loading stress [Pa].

        Parameters
        ----------
        strain
            Compressive strain delta / w.
        """
        return self.narrow.stress(strain)

    def slope(self, strain: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Derivative of the loading stress by the strain [Pa].

        Parameters
        ----------
        strain
            Compressive strain delta / w.
        """
        return self.narrow.slope(strain)

    def stress_sigma(self, strain: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Standard deviation of the loading stress from the calibration [Pa].

        Parameters
        ----------
        strain
            Compressive strain delta / w.
        """
        return self.narrow.stress_sigma(strain)

    @cached_property
    def softening_table_Pa(self) -> Float[np.ndarray, "256"]:
        """Softening of the tension law at 256 equidistant strains from 0 to 1.2 times the end of the calibration."""
        return softening(self.narrow, np.linspace(0.0, self.softening_end, 256))

    @property
    def softening_end(self) -> float:
        """Strain of the last entry of ``softening_table_Pa``."""
        return min(1.2 * self.loading.max_strain, 0.95)

    def save(self, path: Path | str) -> None:
        """Write ``foam.yaml``.

        Parameters
        ----------
        path
            File to write.
        """
        from ....core.files import save_yaml

        data: dict[str, Any] = {
            "format": "visuohaptic-foam-1",
            "width_m": self.width_m,
            "height_m": self.height_m,
            "section": self.section,
            "working_strain": list(self.working_strain),
            "densification_strain": self.densification_strain,
            "residual_Pa": self.residual_Pa,
            "loading": _curve_data(self.loading),
            "tension": asdict(self.tension),
        }
        if self.unloading is not None:
            data["unloading"] = _curve_data(self.unloading)
            data["unloading_peak_strain"] = self.unloading_peak_strain
        if self.hysteresis is not None:
            data["hysteresis"] = {
                "yield_strain": self.hysteresis.yield_strain.tolist(),
                "fraction": self.hysteresis.fraction.tolist(),
                "stress_Pa": self.hysteresis.stress_Pa.tolist(),
                "relative_sigma": self.hysteresis.relative_sigma,
            }
        save_yaml(path, data)

    @classmethod
    def load(cls, path: Path | str) -> FoamMaterial:
        """Read ``foam.yaml``.

        Parameters
        ----------
        path
            ``foam.yaml``, as written by :meth:`save`.

        Raises
        ------
        InputError
            The file is missing or any field is missing, unknown or out of bounds.
        """
        from ....core.files import load_yaml_model

        file: Any = load_yaml_model(path, _schema())
        try:
            return cls(
                loading=_curve(file.loading),
                width_m=file.width_m,
                height_m=file.height_m,
                working_strain=(file.working_strain[0], file.working_strain[1]),
                densification_strain=file.densification_strain,
                residual_Pa=file.residual_Pa,
                unloading=_curve(file.unloading) if file.unloading is not None else None,
                unloading_peak_strain=file.unloading_peak_strain,
                hysteresis=_hysteresis(file.hysteresis),
                tension=Tension(**file.tension.model_dump()),
                section=file.section,
            )
        except InputError as error:
            raise InputError(path, error.problem, field=error.field, remedy=error.remedy) from error


def _curve_data(curve: StressCurve) -> dict[str, Any]:
    return {
        "kind": curve.kind,
        "knots": curve.knots.tolist(),
        "parameters_Pa": curve.parameters.tolist(),
        "covariance_Pa2": curve.covariance.tolist(),
    }


def _curve(file: Any) -> StressCurve:
    kind: CurveKind = file.kind
    size = len(file.parameters_Pa)
    if any(len(row) != size for row in file.covariance_Pa2) or len(file.covariance_Pa2) != size:
        raise InputError("foam file", f"must be {size} x {size}", field="covariance_Pa2")
    covariance = np.array(file.covariance_Pa2, dtype=np.float64)
    scale = float(np.max(np.abs(covariance), initial=0.0))
    if np.max(np.abs(covariance - covariance.T), initial=0.0) > 1e-6 * scale or (
        scale > 0 and np.linalg.eigvalsh(covariance)[0] < -1e-6 * scale
    ):
        raise InputError("foam file", "is not symmetric and positive", field="covariance_Pa2")
    return StressCurve(kind, np.array(file.knots), np.array(file.parameters_Pa), covariance)


def _hysteresis(file: Any) -> HysteresisLaw | None:
    if file is None:
        return None
    return HysteresisLaw(
        np.array(file.yield_strain, dtype=np.float64),
        np.array(file.fraction, dtype=np.float64),
        np.array(file.stress_Pa, dtype=np.float64),
        file.relative_sigma,
    )


def _schema() -> type[BaseModel]:
    """The file's schema; pydantic is imported only when a file is read."""
    from typing import Literal

    from pydantic import ConfigDict, Field, create_model

    strict = ConfigDict(extra="forbid", allow_inf_nan=False)
    curve_fields: dict[str, Any] = {
        "kind": (Literal["spline", "cubic"], ...),
        "knots": (list[float], Field(min_length=2, max_length=MAX_PARAMETERS)),
        "parameters_Pa": (list[float], Field(min_length=3, max_length=MAX_PARAMETERS)),
        "covariance_Pa2": (list[list[float]], Field(min_length=3, max_length=MAX_PARAMETERS)),
    }
    curve = create_model("CurveFile", __config__=strict, **curve_fields)
    tension = create_model(
        "TensionFile",
        __config__=strict,
        ratio=(float, Field(ge=0, le=5)),
        sigma=(float, Field(ge=0, le=5)),
        calibrated=(bool, False),
        lateral=(float, Field(0.0, ge=-2, le=3)),
        lateral_sigma=(float, Field(Tension().lateral_sigma, ge=0, le=5)),
        correlation=(float, Field(0.0, ge=-1, le=1)),
    )
    elements = (list[float], Field(min_length=1, max_length=MAX_PARAMETERS))
    hysteresis_fields: dict[str, Any] = {
        "yield_strain": elements,
        "fraction": elements,
        "stress_Pa": elements,
        "relative_sigma": (float, Field(ge=0, le=1)),
    }
    hysteresis = create_model("HysteresisFile", __config__=strict, **hysteresis_fields)
    fields: dict[str, Any] = {
        "format": (Literal["visuohaptic-foam-1"], ...),
        "width_m": (float, Field(ge=1e-4, le=1)),
        "height_m": (float, Field(ge=1e-4, le=1)),
        "section": (Literal["rectangle", "triangle", "trapezoid"], "rectangle"),
        "working_strain": (list[float], Field(min_length=2, max_length=2)),
        "densification_strain": (float, Field(gt=0, lt=1)),
        "residual_Pa": (float, Field(ge=0)),
        "loading": (curve, ...),
        "unloading": (curve | None, None),
        "unloading_peak_strain": (float, Field(0.0, ge=0, lt=1)),
        "hysteresis": (hysteresis | None, None),
        "tension": (tension, Field(default_factory=lambda: tension(**asdict(Tension())))),
    }
    model: type[BaseModel] = create_model("FoamFile", __config__=strict, **fields)
    return model
