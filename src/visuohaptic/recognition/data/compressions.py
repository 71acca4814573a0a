"""Published compressions of 3-D printed generalised cylindrical shells (GCS; Snapp et al., Nature Communications 2024).

The folder of the data set contains ``parameters.csv``, the design of each print, ``displacements.csv``, its largest displacement
between two plates, and ``forces.csv``, 100 forces at equal steps up to there. Copies without the forces exist.

No shell model of this library applies: the walls are folded until they touch. What applies is learning from readings
(:mod:`..touch.few_curves`). A print has one curve and four numbers, which stand for touches as its readings: the height is that
of the object, thickness and largest displacement are widths, the weight per height is a stiffness, as both are in N/m.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.constants import g

from ...core.errors import InputError
from ...core.files import MAX_DATA_BYTES, CsvRow, read_csv, read_text
from .curve_file import SqueezedObject
from .places import HEIGHTS
from .readings import CurveCoefficients, TouchReading, fit_curve

#: Columns of the shape, without the height: two coefficients of the outline at the base and at the top, twist, and taper.
SHAPE = (
    "c4_base", "c8_base", "c4_top", "c8_top", "twist_linear", "twist_amplitude", "twist_period", "perimeter_ratio",
)  # fmt: skip
#: Forces of a curve.
SAMPLES = 100
#: Heights of the touches that stand for thickness, displacement, weight and curve: far apart, as they are unrelated.
THICKNESS, DISPLACEMENT, WEIGHT, CURVE = (1 + part * (HEIGHTS - 1) // 3 for part in range(4))
#: Standard deviation of a mass that is rounded to 0.1 g, as many of them are [kg].
_MASS_SIGMA_kg = 1e-4 / math.sqrt(12)


@dataclass(frozen=True, slots=True, eq=False)
class Compression:
    """One print, compressed along its axis."""

    name: str  #: identifier of the experiment
    material: str
    shape: tuple[float, ...]  #: by :data:`SHAPE`
    height_m: float
    thickness_m: float  #: of the wall
    mass_kg: float
    displacement_m: float  #: largest
    force_N: Float[np.ndarray, "100"] | None = None  #: at equal steps from 0 to the largest displacement

    @property
    def design(self) -> tuple[float, ...]:
        """Shape and height [m]: equal for prints of the same design, of any material and wall."""
        return (*self.shape, self.height_m)

    def readings(self) -> tuple[TouchReading, ...]:
        """Touches that stand for the readings of this print, see the module.

        Raises
        ------
        InputError
            The force does not rise with the displacement.
        """
        weight = g * self.mass_kg / self.height_m
        side = CurveCoefficients(weight, weight, math.nan, _MASS_SIGMA_kg / self.mass_kg, math.nan)
        nothing = None, None
        out = [
            TouchReading(THICKNESS, "x", nothing, self.thickness_m, self.height_m),
            TouchReading(DISPLACEMENT, "x", nothing, self.displacement_m, self.height_m),
            TouchReading(WEIGHT, "x", (side, None), object_height_m=self.height_m),
        ]
        if self.force_N is not None:
            way = np.linspace(0.0, self.displacement_m, len(self.force_N))
            try:
                found = fit_curve(way, self.force_N, from_contact=True)  # folded walls are no membranes
            except InputError as error:
                raise InputError("forces.csv", error.problem, field=f"print {self.name}") from error
            out.append(TouchReading(CURVE, "x", (found, None), object_height_m=self.height_m))
        return tuple(out)

    def squeezed(self) -> SqueezedObject:
        """This print as an object of the class of its material.

        Raises
        ------
        InputError
            As of :meth:`readings`.
        """
        return SqueezedObject(self.material, f"{self.material}/{self.name}", self.readings())


def read_compressions(folder: Path | str) -> tuple[Compression, ...]:
    """Compressions of a copy of the data set, in the order of ``parameters.csv``.

    Parameters
    ----------
    folder
        With ``parameters.csv`` and ``displacements.csv`` and, for curves, ``forces.csv``. Lengths are in mm, masses in g.

    Raises
    ------
    InputError
        A file is missing or not of this data set, a print is not in all of them, or a value is out of range, with its line.
    """
    folder = Path(folder)
    path = folder / "displacements.csv"
    way = {
        row["ID_Number"]: 1e-3 * _positive(row, "Displacement")
        for row in read_csv(path, ("ID_Number", "Displacement"))[1]
    }
    forces_path = folder / "forces.csv"
    forces = dict(_forces(forces_path)) if forces_path.exists() else None
    out = []
    lengths = ("height", "thickness", "mass")
    for row in read_csv(folder / "parameters.csv", ("ID_Number", "material", *SHAPE, *lengths))[1]:
        name, material = row["ID_Number"], row["material"]
        if name not in way or (forces is not None and name not in forces):
            missing = path if name not in way else forces_path
            raise row.problem(f"found print {name!r}, which is not in {missing.name}", "ID_Number")
        if not material:
            raise row.problem("found no material", "material")
        height, thickness, mass = (1e-3 * _positive(row, key) for key in lengths)
        shape = tuple(row.number(key) for key in SHAPE)
        force = forces[name] if forces is not None else None
        out.append(Compression(name, material, shape, height, thickness, mass, way[name], force))
    return tuple(out)


def _positive(row: CsvRow, name: str) -> float:
    value = row.number(name)
    if not 0 < value < 1e3:
        raise row.problem(f"found {value:g}, expected more than 0 to 1000", name)
    return value


def _forces(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    """Print -> its forces; the header, whose names are numbers in some copies, is skipped."""
    for number, line in enumerate(read_text(path, MAX_DATA_BYTES).splitlines()[1:], 2):
        name, *words = line.split(",")
        try:
            force = np.array(words, dtype=float)
        except ValueError:
            force = np.full(0, np.nan)
        if len(force) != SAMPLES or not np.isfinite(force).all():
            raise InputError(
                path,
                f"expected a print and {SAMPLES} finite forces separated by commas",
                field=f"line {number}",
            )
        yield name.strip(), force
