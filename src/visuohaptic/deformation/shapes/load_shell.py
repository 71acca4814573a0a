"""Load one container from any source: a description, a shipped class, or a mesh; and its outline."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ...io.meshes.mesh import FORMATS
from .container import ContainerDescription, class_names, load_container
from .import_mesh import import_container
from .mesher import ShellObject, mesh_container, with_elastic_base
from .posture import MeshConvention
from .resample import ANGLES, LEVELS, find_wall
from .variants import draw_variant
from .wall_properties import WallProperties


def load_object(
    source: Path | str,
    *,
    wall: WallProperties | None = None,
    open_top: bool = False,
    base_N_per_m: float | None = None,
    around: int | None = None,
    variant: int | None = None,
    seed: int = 0,
    convention: MeshConvention | None = None,
) -> ShellObject:
    """Read a container and create its shell.

    Parameters
    ----------
    source
        YAML description, name of a shipped class, or mesh (STL, PLY, OBJ, GLB, DAE).
    wall
        Properties of the wall that override those of the description. A mesh is PET by default, with the distance of
        its two surfaces as thickness; with one surface it is 0.5 mm, with 10 % uncertainty.
    open_top
        Remove the cap.
    base_N_per_m
        Stiffness of an elastic base [N/m]; clamped by default.
    around
        Vertices around the wall, a multiple of 4; 72 by default, 96 for a mesh.
    variant, seed
        Number and seed of a member of a class, see :func:`.draw_variant`; the centre of its ranges by default.
    convention
        Unit, height axis and remeshing of a mesh; by default the unit is guessed and z points up.

    Raises
    ------
    InputError
        File or class does not exist or cannot be used, with the reason.

    Examples
    --------
    >>> cup = load_object("cup", around=32)
    >>> cup.name, 0.05 < cup.height_m < 0.3
    ('cup', True)
    """
    wall = wall or WallProperties()
    kind = Path(source).suffix.lower()
    if kind in FORMATS:
        found = import_container(
            source,
            wall=wall,
            convention=convention,
            open_top=open_top,
            around=96 if around is None else around,
        )
    elif kind in {".yaml", ".yml", ""}:
        if convention not in (None, MeshConvention()):
            raise InputError(source, "is not a mesh: it has neither --unit nor --up nor --remesh")
        description = load_container(source)
        one = description.middle() if variant is None else draw_variant(description, variant, seed)
        found = mesh_container(
            _changed(one, wall, open_top=open_top), around=72 if around is None else around
        )
        constants, spread = wall.elastic_constants(found.material, found.youngs_modulus_spread)
        found = replace(found, material=constants, youngs_modulus_spread=spread)
    else:
        known = ", ".join((".yaml", *FORMATS))
        raise InputError(
            source,
            f"found suffix {kind!r}, expected one of {known}",
            remedy=f"or a class: {', '.join(class_names())}",
        )
    return found if base_N_per_m is None else with_elastic_base(found, base_N_per_m)


def round_outline(container: ShellObject, oval_m: float) -> Float[np.ndarray, "k 2"]:
    """Mean radius and height above the foot of a round container, from the bottom up [m].

    Parameters
    ----------
    container
        Of any source.
    oval_m
        Largest amplitude of an ellipse that is round enough, as a mean over the heights [m].

    Raises
    ------
    InputError
        It is not round.
    """
    surface = container.mesh.vertices_m, container.surface_faces
    wall = find_wall(*surface, container.name)
    height = np.linspace(wall.low_m, wall.high_m, LEVELS)
    radius = wall.radius_m(height, ANGLES)
    oval = float(np.mean(2 * np.abs(np.fft.rfft(radius, axis=1)[:, 2]) / ANGLES))
    if oval > oval_m:
        raise InputError(
            container.name,
            f"is not round: its half-axes differ by {2e3 * oval:.2g} mm, expected up to {2e3 * oval_m:.2g} mm",
        )
    above = height - surface[0][:, 2].min()
    above[[0, -1]] = 0.0, container.height_m
    return np.column_stack([radius.mean(axis=1), above])


def _changed(
    container: ContainerDescription, wall: WallProperties, *, open_top: bool
) -> ContainerDescription:
    """The description with the given properties replaced."""
    changes: dict[str, object] = {}
    if open_top:
        changes["top"] = container.top.model_copy(update={"kind": "open", "wall": None})
    if (whole_m := wall.whole_m) is not None:
        # The whole wall: a mesh has only one, so both behave the same.
        sections = [section.model_copy(update={"wall": None}) for section in container.sections]
        changes |= {"wall": (whole_m, whole_m), "sections": sections}
    if wall.thickness_spread is not None:
        changes["wall_spread"] = (wall.thickness_spread, wall.thickness_spread)
    return container.model_copy(update=changes)
