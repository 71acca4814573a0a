"""``visuohaptic calibrate beam``: fit the compliance of a beam sensor to known loads.

reads
  loads.csv  known loads on the tip: fx_N, fy_N, fz_N, mx_Nm, my_Nm, mz_Nm, and the observation:
             read_fx_N ... read_mz_Nm (the uncalibrated sensor's reading), or the motion of the tip:
             x_m, y_m, z_m with rx_rad, ry_rad, rz_rad (rotation vector) or roll_deg, pitch_deg, yaw_deg
  --beam     beam.yaml with length_m, diameter_m, youngs_Pa, ... and their tolerances
writes
  --out      beam.yaml with the calibration

Data that cannot give a valid calibration are refused, with the reason.

example
  visuohaptic calibrate beam loads.csv --beam beam.yaml --out beam.yaml
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ....core.files.plain_json import picked


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("loads", Path, "CSV of known loads and readings")
    add("--beam", Path, "beam.yaml (by default a 12 cm rod of 1.5 mm spring steel)")
    add("--out", Path("beam.yaml"), "file to write (beam.yaml)")
    add("--xi", 1.0, "x / L of the observed motion (1: the tip)", low=0.05, high=1)
    add("--angles", str, "unit of columns roll, pitch, yaw", choices=("deg", "rad"))
    add("--load-tolerance", 0.002, "relative sigma of the loads (0.002)", metavar="R", low=0, high=0.1)


def run(args: Any) -> dict[str, Any]:
    """Calibrate, write the file, and return what was found (SI units)."""
    from ....sensing.beam import AXES, Beam, calibrate_beam, prior_correction, read_loads
    from ....sensing.beam.config import load_beam, save_beam

    beam = Beam() if args.beam is None else load_beam(args.beam)[0]
    record = read_loads(args.loads, angles=args.angles)
    found = calibrate_beam(record, beam, xi=args.xi, load_tolerance=args.load_tolerance)
    save_beam(args.out, beam, found.correction)
    before = [100 * prior_correction(beam).row_covariance[k, k, k] ** 0.5 for k in range(6)]
    args.report(f"{len(record.load)} rows; residuals of the calibrated sensor and of the data sheet alone")
    args.report("axis  residual rms   data sheet    explained   scale err   sigma  data sheet's")
    for k, axis in enumerate(AXES):
        unit = "mN " if k < 3 else "mNm"
        args.report(
            f"{axis:4} {1e3 * found.residual_rms[k]:9.3f} {unit} {1e3 * found.uncalibrated_rms[k]:9.3f} {unit} "
            f"{100 * found.explained[k]:9.2f} % {100 * found.correction.matrix[k, k]:9.2f} % "
            f"{found.sigma_percent[k]:6.2f} % {before[k]:8.2f} %"
        )
    for note in found.notes:
        args.report(note)
    args.report(f"wrote {args.out}")
    return {
        "out": str(args.out),
        "rows": len(record.load),
        **picked(found, "residual_rms uncalibrated_rms explained sigma_percent compliance notes"),
    }
