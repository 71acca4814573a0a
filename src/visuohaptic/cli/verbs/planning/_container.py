"""A container from the command line: the same words for every verb that reads one."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ....deformation.shapes.mesher import ShellObject

__all__ = ["add_container_arguments", "read_container"]


def add_container_arguments(parser: argparse.ArgumentParser, *, also: str = "") -> None:
    """The object, and options of its wall, lid and shape; ``also`` is what else a verb reads.

    Parameters
    ----------
    parser
        Of the verb.
    also
        What else the verb reads as an object, for the help.
    """
    parser.add_argument("object", help=f"YAML description, class, mesh (STL, PLY, OBJ, GLB, DAE){also}")
    wall = parser.add_argument_group("wall")
    wall.add_argument("--material", help="of the library; a mesh is of PET by default")
    wall.add_argument(
        "--thickness",
        type=float,
        dest="thickness_m",
        help="[m]; by default as a mesh with two surfaces measures, else 0.0005",
    )
    wall.add_argument(
        "--thickness-spread",
        type=float,
        dest="wall_spread",
        help="its relative standard deviation (as measured in a mesh, or 0.1)",
    )
    wall.add_argument("--youngs-modulus", type=float, dest="youngs_modulus_Pa", metavar="PA", help="[Pa]")
    wall.add_argument("--poisson", type=float, dest="poisson_ratio", metavar="NU", help="Poisson's ratio")
    shape = parser.add_argument_group("shape")
    shape.add_argument("--open-top", action="store_true", help="take the cap off")
    shape.add_argument(
        "--base-stiffness",
        type=float,
        dest="base_N_per_m",
        metavar="N/M",
        help="of an elastic base, each direction; the base is clamped by default",
    )
    shape.add_argument("--variant", type=int, help="of a class; its middle by default")
    shape.add_argument("--seed", type=int, default=0, help="of the variants")
    shape.add_argument("--around", type=int, help="vertices round the wall (72; 96 for a mesh)")
    shape.add_argument("--unit", choices=("m", "dm", "cm", "mm", "in"), help="of a mesh; guessed by default")
    shape.add_argument(
        "--up",
        choices=("x", "y", "z", "-x", "-y", "-z"),
        default="z",
        help="axis of a mesh that points up; maps and places have it turned to z",
    )
    shape.add_argument(
        "--remesh",
        choices=("auto", "cast", "never"),
        default="auto",
        help="of a mesh: repair its triangles on their surface (auto), sample the wall anew on rings, or neither",
    )


def read_container(args: Any) -> ShellObject:
    """The object that ``args.object`` and those options name.

    Parameters
    ----------
    args
        As parsed.
    """
    from ....deformation.shapes.import_mesh import MeshConvention
    from ....deformation.shapes.load_shell import load_object
    from ....deformation.shapes.wall_properties import WallProperties

    return load_object(
        args.object,
        wall=WallProperties(
            args.material,
            args.thickness_m,
            args.wall_spread,
            args.youngs_modulus_Pa,
            args.poisson_ratio,
        ),
        open_top=args.open_top,
        base_N_per_m=args.base_N_per_m,
        around=args.around,
        variant=args.variant,
        seed=args.seed,
        convention=MeshConvention(args.unit, args.up, args.remesh),
    )
