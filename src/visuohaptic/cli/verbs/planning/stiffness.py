"""``visuohaptic stiffness``: compute the stiffness of a container at every surface point.

reads   a YAML description (see `visuohaptic defaults container`), the name of a built-in class (bottle, cup, cup-rim,
        elliptic, smoothie, cien, isana, cleaner, palmo), or a mesh: STL, PLY, OBJ, GLB, DAE. A mesh is the
        mid-surface of the wall or both of its sides; z is its height axis unless --up is given. The base is clamped, or
        elastic with --base-stiffness.
writes  the map: NPZ (vertices_m, faces, stiffness_N_per_m, stiffness_sigma_N_per_m), VTU or GLB

Stiffness is the force of one fingertip divided by the mean deformation of both sides [N/m]. It is infinite where the
wall is clamped, and NaN where there is no opposite point.

example: visuohaptic stiffness bottle --material PET --thickness 0.0005 --out map.npz --plot map.png
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from .... import core, deformation
from ....core import files
from ....core.files.plain_json import picked, plain
from ....deformation import maps
from ._container import add_container_arguments, add_contents_arguments, read_container, read_contents


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add_container_arguments(add)
    add("--out", Path, "map to write: .npz, .vtu or .glb")
    add("--plot", Path, "plot to write: .png, .pdf or .svg")
    add(
        "--at",
        float,
        "also print the stiffness at the nearest surface point, interpolated between vertices, and its distance [m]; z is measured from the foot, x and y from the axis of a class or YAML description, and as in the file of a mesh; may be repeated",
        action="append",
        metavar="X Y Z",
    )
    add_contents_arguments(add)
    add("--no-sigma", bool, "do not compute the standard deviation; halves the time")


def run(args: Any) -> dict[str, Any]:
    """Compute and write; returns the mapping that ``--json`` prints."""
    import numpy as np

    if args.out:
        files.check_target(args.out, maps.MAP_SUFFIXES)
    for point in args.at or ():
        if not np.isfinite(point).all():
            raise core.InputError("--at", f"found {point}, expected finite numbers")
    begin = time.perf_counter()
    container = read_container(args)
    _check_near(container.mesh.vertices_m, args.at or ())
    contents, inside = read_contents(args)
    found = deformation.object_map(container, contents, band=not args.no_sigma)
    if not np.isfinite(found.stiffness_N_per_m).any():
        raise core.InputError(args.object, "no surface point has a finite stiffness")
    if args.out:
        deformation.save_map(args.out, found)
    if args.plot:
        deformation.plot_map(args.plot, found, f"{container.name}, {container.material.name}")
    result = _described(args, container, found, inside)
    result["seconds"] = time.perf_counter() - begin
    result |= {name: str(path) for name, path in (("out", args.out), ("plot", args.plot)) if path}
    if args.at:
        result["at"] = [_at(found, point) for point in args.at]
    return result


def _described(
    args: Any, container: deformation.ShellObject, found: core.StiffnessMap, inside: Any
) -> dict[str, Any]:
    """The object and the range of its stiffness."""
    import numpy as np

    stiffness, sigma = found.stiffness_N_per_m, found.stiffness_sigma_N_per_m
    use = np.isfinite(stiffness)
    thickness_m = float(np.median(np.asarray(container.mesh.thickness_m)))
    return {
        "object": str(args.object),
        "name": container.name,
        "material": container.material.name,
        **picked(container.material, "youngs_modulus_Pa poisson_ratio"),
        **picked(container, "height_m volume_m3 notes"),
        "thickness_m": thickness_m,
        "thickness_sigma_m": thickness_m * container.wall_spread,
        "contents": inside,
        "vertices": len(found.vertices_m),
        "faces": len(found.faces),
        "stiffness_N_per_m": {
            "min": float(stiffness[use].min()),
            "median": float(np.median(stiffness[use])),
            # The stiffness diverges towards the clamped foot: a maximum would only show how close a vertex is to it.
            "percentile_95": float(np.percentile(stiffness[use], 95)),
        },
        "relative_sigma_median": None if args.no_sigma else float(np.nanmedian(sigma[use] / stiffness[use])),
    }


def _check_near(vertices_m: Any, points_m: Any) -> None:
    """Refuse points farther from the box around the wall than its diagonal: another unit or origin."""
    import numpy as np

    low_m, high_m = vertices_m.min(axis=0), vertices_m.max(axis=0)
    for point_m in points_m:
        away_m = float(np.linalg.norm(point_m - np.clip(point_m, low_m, high_m)))
        if away_m > np.linalg.norm(high_m - low_m):
            box = " to ".join("({:.3g}, {:.3g}, {:.3g})".format(*corner_m) for corner_m in (low_m, high_m))
            raise core.InputError(
                "--at",
                f"found {point_m}, {away_m:.3g} m from the object, expected a point at its surface, which extends from {box} m",
                remedy="give metres, in the frame of the mesh turned by --up, z from its foot",
            )


def _at(found: core.StiffnessMap, point_m: list[float]) -> dict[str, Any]:
    """Stiffness and sigma at the surface point nearest to a point."""
    import numpy as np

    target_m = np.array(point_m)
    value, place_m = deformation.nearest_value(
        found.vertices_m, found.faces, found.stiffness_N_per_m, target_m
    )
    sigma, _ = deformation.nearest_value(
        found.vertices_m, found.faces, found.stiffness_sigma_N_per_m, target_m
    )
    return {
        "asked_m": list(point_m),
        "point_m": place_m.tolist(),
        "distance_m": float(np.linalg.norm(place_m - target_m)),
        "stiffness_N_per_m": plain(value),
        "sigma_N_per_m": plain(sigma),
    }
