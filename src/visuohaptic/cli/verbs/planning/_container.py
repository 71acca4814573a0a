"""A container from the command line: the options of every verb that reads one."""

from __future__ import annotations

from typing import Any

from .... import core, deformation


def add_container_arguments(add: Any, *, also: str = "") -> None:
    """The object, and options of its wall, lid and shape; ``also`` is what else a verb reads.

    Parameters
    ----------
    add
        Of the verb.
    also
        What else the verb reads as an object, for the help.
    """
    add("object", str, f"YAML description, class, mesh (STL, PLY, OBJ, GLB, DAE){also}")
    wall = add.group("wall")
    wall("--material", str, "material of the library, or a YAML file of plies (default of a mesh: PET)")
    wall(
        "--thickness",
        str,
        "wall thickness [m]: a number, a range LOW:HIGH, or a CSV file with z_m, thickness_m or x_m, y_m, z_m, thickness_m (default: as measured in a mesh with two surfaces, else 0.0005)",
        metavar="M",
    )
    wall(
        "--thickness-spread",
        float,
        "relative standard deviation of the thickness (as measured in a mesh, or 0.1)",
        dest="wall_spread",
    )
    wall("--youngs-modulus", float, "Young's modulus [Pa]", dest="youngs_modulus_Pa", metavar="PA")
    wall("--poisson", float, "Poisson's ratio", dest="poisson_ratio", metavar="NU")
    shape = add.group("shape")
    shape("--open-top", bool, "remove the cap")
    shape(
        "--base-stiffness",
        float,
        "stiffness of an elastic base in each direction (default: clamped)",
        dest="base_N_per_m",
        metavar="N/M",
    )
    shape("--variant", int, "number of a random variant of a class (default: the middle of its ranges)")
    shape("--seed", 0, "seed of the variants")
    shape("--around", int, "vertices around the wall (72; 96 for a mesh)")
    shape(
        "--unit",
        str,
        "unit of a mesh (default: as its file states, or inferred from its size)",
        choices=("m", "dm", "cm", "mm", "in"),
    )
    shape(
        "--up",
        "z",
        "axis of a mesh that points up; in maps and positions it is z",
        choices=("x", "y", "z", "-x", "-y", "-z"),
    )
    shape(
        "--remesh",
        "auto",
        "repair the triangles of a mesh on their surface (auto), resample the wall on rings (cast), or neither",
        choices=("auto", "cast", "never"),
    )


def add_contents_arguments(add: Any) -> None:
    """Options of the contents.

    Parameters
    ----------
    add
        Of the verb.
    """
    state = add.group("state")
    state("--closed", bool, "the contents are enclosed (default: open)")
    state("--fill", float, "fill level of enclosed contents, 0..1; implies --closed")


def read_contents(args: Any) -> tuple[deformation.Contents | None, Any]:
    """Contents given by ``--closed`` and ``--fill``, and the same as plain data.

    Parameters
    ----------
    args
        As parsed.
    """

    if not args.closed and args.fill is None:
        return None, "open"
    contents = deformation.Contents(fill=args.fill or 0.0)
    return contents, {"closed": True, "fill": contents.fill}


def read_container(args: Any) -> deformation.ShellObject:
    """The object specified by ``args.object`` and the container options.

    Parameters
    ----------
    args
        As parsed.
    """

    thickness_m, spread, places = _thickness(args.thickness)
    container = deformation.load_object(
        args.object,
        wall=deformation.WallProperties(
            args.material,
            thickness_m,
            spread if args.wall_spread is None else args.wall_spread,
            args.youngs_modulus_Pa,
            args.poisson_ratio,
        ),
        open_top=args.open_top,
        base_N_per_m=args.base_N_per_m,
        around=args.around,
        variant=args.variant,
        seed=args.seed,
        convention=deformation.MeshConvention(args.unit, args.up, args.remesh),
    )
    return container if places is None else deformation.with_thickness_map(container, places, args.thickness)


def _thickness(text: str | None) -> tuple[float | None, float | None, Any]:
    """Thickness [m], its relative standard deviation, and a thickness map; ``None`` where not given."""
    from ....deformation.shapes.wall_properties import thickness_range

    if text is None:
        return None, None, None
    if text.lower().endswith(".csv"):
        return None, None, deformation.load_thickness_map(text)
    try:
        bounds = [float(part) for part in text.split(":")]
    except ValueError:
        bounds = []
    if len(bounds) not in (1, 2):
        raise core.InputError(
            "--thickness", f"found {text!r}, expected a number, LOW:HIGH in metres, or a .csv file"
        )
    return (bounds[0], None, None) if len(bounds) == 1 else (*thickness_range(*bounds), None)
