"""``visuohaptic squeeze``: compute force against deformation of one pinch on a container.

reads   a YAML description, the name of a built-in class, or a mesh, as `stiffness` does; and with --measured, a CSV file of
        firm squeezes of this container: height_m, deformation_m of one side, force_N of one finger [, curve]
writes  the curve: CSV (deformation_m, force_N, first_m, second_m, gauge_Pa, stress_Pa), and a plot

Large deformations are simulated, with enclosed air and liquid. The result states up to which force the container
is linear, at which force it buckles, and at which it yields. Forces are those of one fingertip [N]. With --measured, nothing is
simulated: the result is the probability of a lid, of a filling and of its level, of a round PET container.

example: visuohaptic squeeze bottle --at 0.035 0 0.1 --force 10 --out curve.csv --plot curve.png
"""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

from .... import core, deformation, recognition
from ....core import files
from ....core.files.plain_json import picked
from ....deformation import maps
from ._container import add_container_arguments, add_contents_arguments, read_container, read_contents


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add_container_arguments(add)
    add("--at", float, "position of the first fingertip [m]", metavar="X Y Z")
    add("--side", str, "instead of --at: side of the container (x+)", choices=("x+", "x-", "y+", "y-"))
    add("--height", float, "instead of --at: height above the foot [m] (half of the container's)")
    limit = add.one_of()
    limit("--force", float, "maximum force of one fingertip [N]", metavar="N")
    limit("--deformation", float, "maximum deformation of one side [m] (0.005)", metavar="M")
    add("--points", int, "points of the curve (8)")
    add("--out", Path, "curve to write: .csv")
    add("--plot", Path, "plot to write: .png, .pdf or .svg")
    add_contents_arguments(add)
    felt = add.group("measured squeezes")
    felt("--measured", Path, "infer lid and contents from these squeezes: .csv")
    felt("--mass", float, "as weighed, with its contents", metavar="KG", low=0, above=True)
    felt("--mass-sigma", float, "standard deviation of --mass (0.005)", metavar="KG", low=0, above=True)


def run(args: Any) -> dict[str, Any]:
    """Compute and report; returns the mapping that ``--json`` prints."""
    if args.measured:
        return _contents(args)
    args.refuse("--mass --mass-sigma", "found without --measured")
    if args.out:
        files.check_target(args.out, (".csv",))
    if args.at:
        args.refuse("--height --side", "found with --at, expected one of them")
    begin = time.perf_counter()
    container = read_container(args)
    contents, inside = read_contents(args)
    found = deformation.squeeze(
        container,
        point_m=args.at,
        side=args.side or "x+",
        height_m=args.height,
        force_N=args.force,
        deformation_m=args.deformation,
        points=8 if args.points is None else args.points,
        contents=contents,
    )
    if args.out:
        maps.save_squeeze(args.out, found)
    if args.plot:
        maps.plot_squeeze(args.plot, found, f"{container.name}, {container.material.name}")
    curve = found.curve
    result: dict[str, Any] = {
        "object": str(args.object),
        "name": container.name,
        **picked(curve, "point_m opposite_m"),
        "contents": inside,
        **picked(found, "distance_m stiffness_N_per_m stiffness_sigma_N_per_m"),
        **picked(found, "linear_to_N buckling_force_N yield_force_N yield_stress_Pa"),
        **picked(curve, "deformation_m force_N gauge_Pa stress_Pa complete reason"),
        "notes": list(container.notes),
        "seconds": time.perf_counter() - begin,
    }
    result |= {name: str(path) for name, path in (("out", args.out), ("plot", args.plot)) if path}
    _report(args, result, found.remarks)
    return result


def _contents(args: Any) -> dict[str, Any]:
    """Probability of lid, filling and level, from measured squeezes and the mass."""
    import numpy as np

    from ....recognition.touch.contents import EMPTY, ENCLOSED, FILLINGS, MAX_DEFORMATION_M

    simulated = "--at --side --height --force --deformation --points --out --plot --fill --closed"
    args.refuse(simulated, "found with --measured, which simulates nothing")
    if args.mass is None:
        args.refuse("--mass-sigma", "found without --mass", "give the --mass it belongs to")
    begin = time.perf_counter()
    squeezes = recognition.read_squeezes(args.measured)
    container = read_container(args)
    # An ellipse of amplitude e loses 2 e / d more or less of its area than a circle, of which the model knows ENCLOSED.
    outline = deformation.round_outline(container, 0.5 * ENCLOSED * MAX_DEFORMATION_M)
    for one in squeezes:
        if one.height_m >= outline[-1, 1]:
            raise core.InputError(
                args.measured,
                f"a squeeze at {one.height_m:g} m, expected less than the height of {outline[-1, 1]:.4g} m",
            )
    given = float(np.median(np.asarray(container.mesh.thickness_m)))
    first = [(one.height_m, float(one.force_N[0] / one.deformation_m[0])) for one in squeezes]
    wall_m = given if args.thickness else recognition.wall_from_stiffness(outline, first, given)
    mass = None if args.mass is None else (args.mass, 0.005 if args.mass_sigma is None else args.mass_sigma)
    found = recognition.ContentsModel(outline, wall_m).posterior(squeezes, mass)
    known = dict.fromkeys((EMPTY, *FILLINGS), 0.0)
    for name, probability in zip(found.filling, found.probability, strict=True):
        known[name] += float(probability)
    mean, sigma = found.fill_of()
    result: dict[str, Any] = {
        "object": str(args.object),
        "name": container.name,
        "squeezes": len(squeezes),
        "thickness_m": wall_m,
        "lid": found.belief(),
        "filling": {**known, recognition.UNKNOWN: found.unknown},
        "fill": {"mean": mean, "sigma": sigma},
        "notes": list(container.notes),
        "seconds": time.perf_counter() - begin,
    }
    for name in ("lid", "filling"):
        args.report(f"{name}: " + ", ".join(f"{key} {value:.3f}" for key, value in result[name].items()))
    args.report(f"fill: {mean:.2f} ± {sigma:.2f} of the volume, given that the contents are known")
    args.report(
        f"wall: {1e3 * wall_m:.3g} mm, "
        + ("as given" if args.thickness else "from the squeezes, if it is of PET")
    )
    return result


def _report(args: Any, result: dict[str, Any], remarks: tuple[str, ...]) -> None:
    x, y, z = (1e3 * value for value in result["point_m"])
    share = 100 * result["stiffness_sigma_N_per_m"] / result["stiffness_N_per_m"]
    args.report(
        f"{result['name']} at ({x:.0f}, {y:.0f}, {z:.0f}) mm: {result['stiffness_N_per_m']:.0f} N/m ± {share:.0f} % at rest"
    )
    # Three digits of the largest deformation: that of glass is below a micrometre. No point may have been reached.
    digits = max(2, 2 - math.floor(math.log10(1e3 * max(result["deformation_m"], default=1.0))))
    for depth, force in zip(result["deformation_m"], result["force_N"], strict=True):
        args.report(f"{1e3 * depth:{digits + 4}.{digits}f} mm  {force:8.2f} N")
    for line in (*remarks, *(f"note: {note}" for note in result["notes"])):
        args.report(line)
