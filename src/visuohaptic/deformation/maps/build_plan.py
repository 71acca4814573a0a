"""Build plans of data sets: classes, number of variants, states (Alt 2016, Sec. 6.4.1)."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, field_validator

from ..._version import __version__
from ...core import InputError, load_yaml_model
from ...core.objects import HEIGHTS
from ..shapes import ContainerDescription, class_names, draw_variant, load_container

#: Format version; incremented when the meaning of the results changes, so that older results are recomputed.
BUILD_FORMAT = 2


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ClassEntry(_Part):
    """One class of the plan."""

    source: str = Field(alias="class", max_length=4096)  #: shipped class, or YAML file in the plan's folder
    variants: int = Field(50, ge=1, le=100_000)  #: random members of the class


class State(_Part):
    """Contents of the container."""

    closed: bool = True  #: whether air and liquid are enclosed
    fill: float = Field(0.0, ge=0, le=1)  #: fill level


class Curves(_Part):
    """Features from force-deformation curves instead of linear elasticity."""

    around: int = Field(32, ge=16, le=512, multiple_of=4)  #: vertices around the wall, for the curves
    heights: tuple[int, ...] = tuple(range(1, HEIGHTS + 1))  #: out of 1 .. 16; the others are interpolated

    @field_validator("heights")
    @classmethod
    def _on_the_grid(cls, heights: tuple[int, ...]) -> tuple[int, ...]:
        if not heights or not all(1 <= height <= HEIGHTS for height in heights):
            raise ValueError(f"expected numbers from 1 to {HEIGHTS}")
        return tuple(sorted(set(heights)))


class BuildPlan(_Part):
    """Description of a data set to build; read from YAML."""

    classes: list[ClassEntry] = Field(min_length=1, max_length=1000)  #: containers to compute
    seed: int = Field(0, ge=0, lt=2**63)  #: seed of the random variants
    around: int = Field(48, ge=16, le=512, multiple_of=4)  #: vertices around the wall; a multiple of 4
    band: bool = True  #: maps with a standard deviation; takes twice as long
    #: of the features
    states: list[State] = Field([State(closed=False, fill=0.0)], min_length=1, max_length=16)
    nonlinear: Curves | None = None  #: linear features by default


@dataclass(frozen=True, slots=True)
class BuildJob:
    """One object to compute; plain data, so that it can be sent to another process."""

    name: str  #: of the class
    variant: int
    seed: int
    container: str  #: description without ranges, as JSON
    around: int
    band: bool
    states: tuple[tuple[bool, float], ...]
    curve_around: int = 0  #: vertices around the wall for force-deformation curves; 0: linear features
    curve_heights: tuple[int, ...] = ()

    @property
    def file(self) -> str:
        """Path of the result relative to the build folder."""
        return f"{self.name}/{self.name}-{self.variant:05d}.npz"

    def description(self) -> ContainerDescription:
        """The container, without ranges."""
        return ContainerDescription.model_validate(json.loads(self.container))

    @property
    def key(self) -> str:
        """Hash of everything that the result depends on, including the library's version."""
        text = json.dumps([BUILD_FORMAT, __version__, asdict(self)], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


def load_plan(path: Path | str, *, nonlinear: bool = False) -> tuple[BuildPlan, list[ContainerDescription]]:
    """Read a plan and the descriptions of its classes.

    Parameters
    ----------
    path
        YAML file; classes are shipped ones, or YAML files in the same folder.
    nonlinear
        Compute features from curves, with default settings if the plan has none.

    Raises
    ------
    InputError
        An invalid plan or description, a duplicate class, or a class name that is not a valid folder name.
    """
    plan = load_yaml_model(path, BuildPlan)
    if nonlinear and plan.nonlinear is None:
        plan = plan.model_copy(update={"nonlinear": Curves.model_validate({})})
    found = []
    for entry in plan.classes:
        is_file = Path(entry.source).suffix in {".yaml", ".yml"}
        if not is_file and entry.source not in class_names():
            problem = f"found {entry.source!r}, expected a YAML file or one of: {', '.join(class_names())}"
            raise InputError(path, problem, field="classes")
        found.append(load_container(Path(path).parent / entry.source if is_file else entry.source))
    names = [description.name for description in found]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(path, f"class {twice!r} is named twice", field="classes")
    if bad := [name for name in names if not name.strip(".")]:
        raise InputError(path, f"{bad[0]!r} cannot be the name of a folder", field="classes")
    return plan, found


def plan_jobs(plan: BuildPlan, descriptions: Sequence[ContainerDescription]) -> list[BuildJob]:
    """All objects of a plan, grouped by class.

    Parameters
    ----------
    plan
        Settings and number of variants.
    descriptions
        Descriptions of the plan's classes, in its order.
    """
    states = tuple((state.closed, state.fill) for state in plan.states)
    curves = (plan.nonlinear.around, plan.nonlinear.heights) if plan.nonlinear else (0, ())
    jobs = []
    for entry, description in zip(plan.classes, descriptions, strict=True):
        for variant in range(entry.variants):
            container = draw_variant(description, variant, plan.seed)
            jobs.append(
                BuildJob(
                    description.name,
                    variant,
                    plan.seed,
                    container.model_dump_json(exclude_none=True),
                    plan.around,
                    plan.band,
                    states,
                    *curves,
                )
            )
    return jobs
