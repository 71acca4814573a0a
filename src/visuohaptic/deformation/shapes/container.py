"""Parametric containers: base, sections, cap, rim, rings, dents (Alt 2016, Sec. 6.1.2).

A description is YAML. Every number may be a range, ``[30 mm, 40 mm]``; a description with ranges is
a class, from which variants are sampled. The shape is ``(r_x(z) c(a), shift(z) + r_y(z) s(a))`` over the
height z, where (c, s) is on a unit circle or, flattened, on ``|x|^n + |y|^2 = 1``.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from ...core import InputError, load_yaml_model
from ..shells.shell_material import MATERIALS
from .quantities import Angle, Fraction, Length, Pressure


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Base(_Part):
    """The foot."""

    shape: Literal["circle", "ellipse", "flattened"] = "circle"
    radius: Length  #: half-axis along x
    radius_y: Length | None = None  #: half-axis along y; for a circle, the radius
    flatness: Fraction = (0.0, 0.0)  #: 0 is an ellipse; towards 1, the sides y+ and y- become planes

    @model_validator(mode="after")
    def _fits_the_shape(self) -> Base:
        if self.shape == "circle" and (self.radius_y is not None or self.flatness != (0.0, 0.0)):
            raise ValueError("a circle has neither radius_y nor flatness; take shape: ellipse or flattened")
        if self.shape != "circle" and self.radius_y is None:
            raise ValueError(f"shape: {self.shape} needs radius_y")
        if self.shape == "ellipse" and self.flatness != (0.0, 0.0):
            raise ValueError("flatness needs shape: flattened")
        if not (self.flatness[0] >= 0 and self.flatness[1] <= 0.9):
            raise ValueError("flatness: expected 0 to 0.9")
        return self


class WallSection(_Part):
    """A section of the side wall; sections are listed from below upwards."""

    height: Length  #: of this section
    radius: Length | None = None  #: half-axis x at its upper end; by default as at its lower end
    radius_y: Length | None = None  #: by default in the same proportion as below
    flatness: Fraction | None = None  #: at its upper end; by default as below
    bulge: Length = (0.0, 0.0)  #: sagitta of its arc, > 0 is convex
    shift: Length | None = None  #: of the centre along y at its upper end; by default as below
    wall: Length | None = None  #: thickness; by default that of the container


class Ring(_Part):
    """A ring around the wall; depth > 0 is a rib (reinforcement), < 0 is a groove."""

    z: Length  #: height of its centre
    depth: Length  #: > 0 is a rib, < 0 is a groove
    width: Length  #: along the height
    wall: Length | None = None  #: thickness inside the ring


class Dent(_Part):
    """A dent on one side."""

    z: Length  #: height of its centre
    angle: Angle = (0.0, 0.0)  #: angle about the height axis from x+ towards y+
    depth: Length  #: at its centre
    width: Length  #: around the wall
    height: Length  #: along the height axis


class Rim(_Part):
    """A thick band at the upper end."""

    height: Length  #: of the band
    wall: Length  #: its thickness


class Top(_Part):
    """Closure of the upper end."""

    kind: Literal["open", "closed", "stiff"] = "open"
    wall: Length | None = None  #: thickness of the cap: that of the wall when closed, 5 mm when stiff


class ContainerDescription(_Part):
    """One container, or a class of containers where numbers are ranges."""

    name: str = Field("container", pattern=r"^[A-Za-z0-9_.-]{1,64}$")  #: of the container or class
    base: Base  #: cross-section at the foot
    sections: list[WallSection] = Field(
        min_length=1, max_length=64
    )  #: of the side wall, from the foot upwards
    blend: Length = (0.0, 0.0)  #: length over which adjacent sections are blended
    top: Top = Top()  #: closure of the upper end
    rim: Rim | None = None  #: thicker band at the upper end
    rings: list[Ring] = Field(default=[], max_length=256)  #: around the wall
    dents: list[Dent] = Field(default=[], max_length=256)  #: on one side
    wall: Length = (0.0005, 0.0005)  #: thickness
    wall_spread: Fraction = (0.1, 0.1)  #: relative standard deviation of the thickness between specimens
    material: str = "PET"  #: material of the library
    youngs_modulus: Pressure | None = None  #: overrides that of the material

    @field_validator("material")
    @classmethod
    def _known(cls, name: str) -> str:
        if name.lower() not in {known.lower() for known in MATERIALS}:
            raise ValueError(f"expected one of {', '.join(MATERIALS)}")
        return name

    @model_validator(mode="after")
    def _plausible(self) -> ContainerDescription:
        for path, (low, high) in _spans(self):
            kind = path.rpartition(".")[2]
            if kind in {"height", "width", "radius", "radius_y", "wall", "youngs_modulus"} and low <= 0:
                raise ValueError(f"{path}: found {low:g}, expected more than 0")
            if kind == "wall_spread" and not (low >= 0 and high <= 0.5):
                raise ValueError(f"{path}: found {high:g}, expected 0 to 0.5")
            limit = 1e13 if kind == "youngs_modulus" else 100.0
            if max(-low, high) > limit:
                raise ValueError(f"{path}: found {high:g}, expected at most {limit:g} (SI units)")
        return self

    @property
    def free_parameters(self) -> tuple[str, ...]:
        """Paths of the parameters that are ranges."""
        return tuple(path for path, (low, high) in _spans(self) if low != high)

    def at(self, fractions: Any) -> ContainerDescription:
        """One container, each range at a given fraction between its lower and upper limit.

        Parameters
        ----------
        fractions
            One number from 0 to 1 for each of ``free_parameters``, in their order.

        Returns
        -------
        ContainerDescription
            Without ranges.

        Raises
        ------
        InputError
            Wrong number of fractions, or one outside 0 to 1.
        """
        fractions = np.asarray(fractions, dtype=float)
        names = self.free_parameters
        if fractions.shape != (len(names),) or not ((fractions >= 0) & (fractions <= 1)).all():
            raise InputError(
                f"class {self.name}", f"expected {len(names)} fractions from 0 to 1", field="fractions"
            )
        by_name = dict(zip(names, fractions, strict=True))
        return ContainerDescription.model_validate(_fixed(self, "", by_name))

    def middle(self) -> ContainerDescription:
        """The container at the centre of all ranges."""
        return self.at(np.full(len(self.free_parameters), 0.5))


def load_container(source: Path | str) -> ContainerDescription:
    """Read a description from a YAML file, or a shipped class by its name.

    Parameters
    ----------
    source
        YAML file, or one of :func:`class_names`.

    Raises
    ------
    InputError
        Lists all invalid fields.
    """
    path = Path(source)
    if not path.suffix and not path.exists() and str(source) in class_names():
        with resources.as_file(_classes() / f"{source}.yaml") as shipped:
            return load_yaml_model(shipped, ContainerDescription)
    if not path.exists():
        raise InputError(
            path, "does not exist", remedy=f"or use a built-in class: {', '.join(class_names())}"
        )
    return load_yaml_model(path, ContainerDescription)


def class_names() -> tuple[str, ...]:
    """Shipped classes (Alt 2016, Sec. 6.4.1)."""
    return tuple(
        sorted(
            entry.name.removesuffix(".yaml") for entry in _classes().iterdir() if entry.name[-5:] == ".yaml"
        )
    )


def _classes() -> Any:
    return resources.files(__package__) / "classes"


def _spans(part: BaseModel, prefix: str = "") -> list[tuple[str, tuple[float, float]]]:
    found: list[tuple[str, tuple[float, float]]] = []
    for name in type(part).model_fields:
        value, path = getattr(part, name), f"{prefix}{name}"
        if isinstance(value, BaseModel):
            found += _spans(value, f"{path}.")
        elif isinstance(value, list):
            for index, entry in enumerate(value):
                found += _spans(entry, f"{path}.{index}.")
        elif isinstance(value, tuple):
            found.append((path, value))
    return found


def _fixed(part: BaseModel, prefix: str, fractions: dict[str, float]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name in type(part).model_fields:
        value, path = getattr(part, name), f"{prefix}{name}"
        if isinstance(value, BaseModel):
            out[name] = _fixed(value, f"{path}.", fractions)
        elif isinstance(value, list):
            out[name] = [_fixed(entry, f"{path}.{index}.", fractions) for index, entry in enumerate(value)]
        elif isinstance(value, tuple):
            low, high = value
            out[name] = low + fractions[path] * (high - low) if path in fractions else low
        else:
            out[name] = value
    return out
