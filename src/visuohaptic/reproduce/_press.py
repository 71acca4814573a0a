"""Press tests of simulated foams, like those with the robot arm and a plate (Alt 2016, Sec. 3.2)."""

from __future__ import annotations

import tempfile
from pathlib import Path

from ..sensing.foam import FoamCalibration, calibrate_foam, read_strain_stress
from ..sensing.foam.material.stress_curve import CurveKind
from ..simulation.foam import FoamStripGeometry, calibration_press
from ..simulation.foam.strip_law import REFERENCE_FOAM, SOFT_FOAM, StripLaw, write_calibration_csv
from .output import Output

#: Name in the figures -> law of the simulated foam.
FOAMS: dict[str, StripLaw] = {"soft (as PUR)": SOFT_FOAM, "firm (as rubber)": REFERENCE_FOAM}
REFERENCE_SIGMA_N = 0.05  #: of the arm's force sensor


def pressed(out: Output, law: StripLaw, stream: int, curve: CurveKind = "cubic") -> FoamCalibration:
    """Press three times and fit the material; the cubic is the dissertation's m_P, Eq. (3.2).

    Parameters
    ----------
    out
        Its seed and size.
    law
        Simulated foam.
    stream
        Number of the random stream.
    curve
        "cubic" or "spline".
    """
    geometry = FoamStripGeometry(spacing_m=0.002)
    rows = calibration_press(
        geometry=geometry,
        law=law,
        steps=20 if out.quick else 60,
        reference_sigma_N=REFERENCE_SIGMA_N,
        rng=out.rng(stream),
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "strain_stress.csv"
        write_calibration_csv(path, rows)
        data = read_strain_stress(path)
    return calibrate_foam(data, width_m=geometry.width_m, height_m=geometry.height_m, curve=curve)
