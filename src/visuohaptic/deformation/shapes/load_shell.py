"""One container from whatever names it: a description, a shipped class, or a mesh."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

from ...core.errors import InputError
from ...io.meshes.mesh import FORMATS
from ..shells.shell_material import IsotropicMaterial, material
from .container import class_names, load_container
from .import_mesh import import_object
from .mesher import ShellObject, mesh_container, with_elastic_base

__all__ = ["load_object"]


def load_object(
    source: Path | str,
    *,
    material_name: str | None = None,
    thickness_m: float | None = None,
    wall_spread: float | None = None,
    youngs_modulus_Pa: float | None = None,
    poisson_ratio: float | None = None,
    open_top: bool = False,
    base_N_per_m: float | None = None,
    around: int | None = None,
    variant: int | None = None,
    seed: int = 0,
    unit: str | None = None,
    up: Literal["x", "y", "z", "-x", "-y", "-z"] = "z",
) -> ShellObject:
    """Read a container and make a shell of it.

    Parameters
    ----------
    source
        YAML description, name of a shipped class, or mesh (STL, PLY, OBJ, GLB, DAE).
    material_name, thickness_m, wall_spread
        Instead of what the description says. A mesh is of PET by default, as thick as its two surfaces are
        apart; with one surface it is 0.5 mm, known to 10 %.
    youngs_modulus_Pa, poisson_ratio
        Instead of the material's.
    open_top
        Without a cap.
    base_N_per_m
        Stiffness of an elastic base; clamped by default.
    around
        Vertices round the wall.
    variant, seed
        Of a class; its middle by default.
    unit, up
        Of a mesh, see :func:`.import_object`.

    Examples
    --------
    >>> cup = load_object("cup", around=32)
    >>> cup.name, 0.05 < cup.height_m < 0.3
    ('cup', True)
    """
    kind = Path(source).suffix.lower()
    for name, value in (("thickness", thickness_m), ("youngs-modulus", youngs_modulus_Pa)):
        if value is not None and not 0 < value < float("inf"):
            raise InputError(name, f"found {value}, expected > 0")
    if wall_spread is not None and not 0 <= wall_spread <= 0.5:
        raise InputError("thickness-spread", f"found {wall_spread}, expected 0 to 0.5")
    if kind in FORMATS:
        found = import_object(
            source,
            wall_material=material_name or "PET",
            thickness_m=thickness_m,
            wall_spread=wall_spread,
            unit=unit,
            up=up,
            open_top=open_top,
            around=96 if around is None else around,
        )
    elif kind in {".yaml", ".yml", ""}:
        if unit is not None or up != "z":
            raise InputError(source, "is no mesh: it has neither --unit nor --up")
        description = load_container(source)
        container = description.middle() if variant is None else description.variant(variant, seed)
        changes: dict[str, object] = {}
        if open_top:
            changes["top"] = container.top.model_copy(update={"kind": "open", "wall": None})
        if material_name is not None:
            material(material_name)
            changes |= {"material": material_name, "youngs_modulus": None}
        if thickness_m is not None:
            # The whole wall: a mesh has no other, and so it is the same for both.
            sections = [section.model_copy(update={"wall": None}) for section in container.sections]
            changes |= {"wall": (thickness_m, thickness_m), "sections": sections}
        if wall_spread is not None:
            changes["wall_spread"] = (wall_spread, wall_spread)
        container = container.model_copy(update=changes)
        found = mesh_container(container, around=72 if around is None else around)
    else:
        known = ", ".join((".yaml", *FORMATS))
        raise InputError(
            source,
            f"found suffix {kind!r}, expected one of {known}",
            remedy=f"or a class: {', '.join(class_names())}",
        )
    if youngs_modulus_Pa is not None or poisson_ratio is not None:
        old = found.material
        found = replace(
            found,
            material=IsotropicMaterial(
                youngs_modulus_Pa or old.youngs_modulus_Pa,
                old.poisson_ratio if poisson_ratio is None else poisson_ratio,
                # A material that was named keeps its name, and with it its density.
                "given" if youngs_modulus_Pa and material_name is None else old.name,
            ),
            youngs_modulus_spread=0.0 if youngs_modulus_Pa else found.youngs_modulus_spread,
        )
    return found if base_N_per_m is None else with_elastic_base(found, base_N_per_m)
