"""``visuohaptic calibrate foam``: fit the stress-strain curve of a foam.

reads   data.csv with columns strain, stress_Pa, direction (loading or unloading);
        --plate: depth_m, force_N, s_m, delta_m of a plate narrower than the strip
writes  foam.yaml (curve, covariance, working range, tension) and, with --plot, a figure

Data that cannot give a valid curve are refused, with the reason.

example visuohaptic calibrate foam press.csv --width 0.02 --height 0.01 --out foam.yaml --plate plate.csv --plot foam.png
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .... import core
from ....core.files.plain_json import picked
from ....sensing import foam


def add_arguments(add: Any) -> None:
    """Declare what the command reads and writes."""
    add("data", Path, "CSV file of strain and stress")
    add("--out", Path("foam.yaml"), "file to write (foam.yaml)")
    add("--plate", Path, "CSV file of contours under a narrow plate: calibrates tension and expansion")
    add(
        "--width",
        float,
        "w, thickness of the strip in the direction of compression [m], such as 0.04; checked when zeroing",
        required=True,
        metavar="M",
    )
    add(
        "--height",
        float,
        "h, height of the strip across the contour [m]; forces are proportional to it",
        required=True,
        metavar="M",
    )
    add("--curve", "spline", "model of the curve (spline)", choices=("spline", "cubic"))
    add(
        "--section",
        "rectangle",
        "cross-section of the sensor's rod; the data are those of a rectangle (rectangle)",
        choices=("rectangle", "triangle", "trapezoid"),
    )
    add("--plot", Path, "plot of the curve and the sensitivity to write", metavar="PNG")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Calibrate, write the files, and return what was found (SI units)."""
    from dataclasses import replace

    for name in ("width", "height"):
        # A strip of foam is between a millimetre and a metre thick; larger numbers are millimetres.
        if not 1e-3 <= (size_m := getattr(args, name)) <= 1.0:
            raise core.InputError(
                f"--{name}",
                f"found {size_m:g} m, expected 0.001 to 1 m",
                remedy="sizes are given in metres: 20 mm is 0.02",
            )
    data = foam.read_strain_stress(args.data)
    found = foam.calibrate_foam(data, width_m=args.width, height_m=args.height, curve=args.curve)
    material = found.material
    if args.plate is not None:
        tension = foam.calibrate_tension(foam.read_plate(args.plate), material, where=str(args.plate))
        material = replace(material, tension=tension)
        found = replace(found, material=material)
    if args.plot is not None:
        from ....sensing.foam.material.material_plots import save_calibration_plot

        save_calibration_plot(found, args.plot)
    if args.section != "rectangle":
        material = foam.section_material(material, args.section)
    material.save(args.out)
    result = {
        "out": str(args.out),
        "plot": None if args.plot is None else str(args.plot),
        **picked(args, "curve section"),
        **picked(material, "width_m height_m residual_Pa working_strain densification_strain"),
        "points_loading": len(data.loading[0]),
        "points_unloading": len(data.unloading[0]),
        **picked(
            found,
            "residual_spline_Pa residual_cubic_Pa cubic_monotone hysteresis_loss presses press_sigma notes",
        ),
        "tension_ratio": material.tension.ratio,
        "tension_sigma": material.tension.sigma,
        "tension_calibrated": material.tension.calibrated,
        "lateral_expansion": material.tension.lateral,
        "lateral_expansion_sigma": material.tension.lateral_sigma,
    }
    for line in _lines(result, unloading=found.material.unloading is not None):
        args.report(line)
    return result


def _lines(result: dict[str, Any], *, unloading: bool) -> list[str]:
    low, high = result["working_strain"]
    cubic = result["residual_cubic_Pa"]
    kind = "calibrated" if result["tension_calibrated"] else "default: calibrate it with --plate"
    return [
        f"strip: width {1e3 * result['width_m']:g} mm along the compression, "
        f"height {1e3 * result['height_m']:g} mm",
        f"{result['points_loading']} loading and {result['points_unloading']} unloading points",
        _scatter(result["presses"], result["press_sigma"]),
        f"residual: spline {result['residual_spline_Pa']:.1f} Pa, cubic "
        + ("not fitted" if cubic is None else f"{cubic:.1f} Pa")
        + ("" if result["cubic_monotone"] else " (not monotone)")
        + f"; used: {result['curve']}",
        f"working range: strain {low:.2f} to {high:.2f}, saturated beyond {result['densification_strain']:.2f}",
        f"hysteresis: {100 * result['hysteresis_loss']:.0f} % of the work of loading is lost"
        if unloading
        else "hysteresis: not measured; without an unloading curve, forces of foam that is released are invalid",
        f"tension ratio {result['tension_ratio']:.2f} +- {result['tension_sigma']:.2f}, lateral expansion "
        f"{result['lateral_expansion']:.2f} +- {result['lateral_expansion_sigma']:.2f} ({kind})",
        *result["notes"],
        f"wrote {result['out']}" + (f" and {result['plot']}" if result["plot"] else ""),
    ]


def _scatter(presses: int, sigma: float) -> str:
    """What the presses of a record tell about the next one."""
    if presses > 1:
        return f"{presses} presses: the stress of the next one is known to {100 * sigma:.1f} %"
    return "one press: sigma lacks what differs from press to press, and with speed; several presses in one table determine it"
