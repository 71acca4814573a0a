"""Run experiments by name, one folder each."""

from __future__ import annotations

import importlib
import json
import logging
import os
import platform
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from .._version import __version__
from ..core import InputError, VisuohapticError, write_text
from .output import Output

#: Figures and tables of each chapter, in the dissertation's order.
_NUMBERS = (
    ("figure", 3, (2, 4, 7, 8, 10, 11, 12, 13)), ("table", 3, (1,)),
    ("figure", 4, (1, 2, 3, 4)), ("table", 4, (1,)), ("figure", 4, (6,)),
    ("figure", 5, (3, 4, 6, 7, 8)),
    ("figure", 6, (2, 4, 5, 6, 7)), ("table", 6, (1,)), ("figure", 6, (10,)), ("table", 6, (2,)), ("figure", 6, (11, 12)),
)  # fmt: skip
#: Name -> module.
EXPERIMENTS: Mapping[str, str] = {
    f"{kind}-{chapter}.{number}": f"{kind}_{chapter}_{number}"
    for kind, chapter, numbers in _NUMBERS
    for number in numbers
}

#: Dependencies beyond the core that an experiment imports; all of them use matplotlib.
NEEDS: Mapping[str, tuple[str, ...]] = {
    "figure-3.10": ("mujoco",),
    "figure-3.12": ("sklearn",),
    "figure-3.13": ("sklearn",),
    "figure-4.4": ("mujoco",),
    "table-4.1": ("mujoco",),
    "figure-5.4": ("skimage",),
    "figure-5.7": ("robust_laplacian", "skimage"),
    "figure-5.8": ("robust_laplacian", "skimage"),
}

log = logging.getLogger(__name__)

_LIBRARIES = ("numpy", "scipy", "numba", "opencv-python-headless", "mujoco", "scikit-learn")


@dataclass(frozen=True, slots=True)
class ExperimentOutcome:
    """Outcome of one experiment."""

    name: str
    folder: Path
    seconds: float  #: of wall time; of the original run, if the result was kept
    cpu_seconds: float = 0.0  #: of all threads and child processes
    kept: bool = False  #: not run: the same result exists already
    problem: str = ""  #: why there is no result; empty if there is one


def reproduce(
    name: str, folder: Path | str, *, seed: int = 0, quick: bool = False, force: bool = False
) -> ExperimentOutcome:
    """Run one experiment into ``folder / name``.

    Parameters
    ----------
    name
        Of :data:`EXPERIMENTS`; ``fig3.2`` and ``3.2`` are accepted as well.
    folder
        Created if it does not exist.
    seed, quick
        See :class:`.Output`.
    force
        Run even if the same result exists.

    Returns
    -------
    ExperimentOutcome
        Contains the problem if the experiment failed with an error of the library.

    Raises
    ------
    InputError
        Unknown experiment.
    """
    key = known_name(name)
    target = Path(folder) / key
    target.mkdir(parents=True, exist_ok=True)
    if not force and (before := cached_outcome(key, folder, seed=seed, quick=quick)) is not None:
        return before
    (target / "result.json").unlink(missing_ok=True)  # so that an incomplete result does not look complete
    out = Output(target, seed, quick)
    begin, begin_cpu = time.perf_counter(), _cpu_s()

    def ended(problem: str = "") -> ExperimentOutcome:
        return ExperimentOutcome(
            key, target, time.perf_counter() - begin, _cpu_s() - begin_cpu, problem=problem
        )

    try:
        module = _module(key)
        title, caption = title_and_caption(module)
        module.run(out)
    except VisuohapticError as error:
        return ended(str(error))
    except Exception as error:
        # The other experiments continue after an error in one.
        log.debug("%s", key, exc_info=True)
        return ended(f"unexpected {type(error).__name__}: {error}")
    if not (out.rows and (out.pictures or out.comparisons)):
        return ended("it wrote no data")
    outcome = ended()
    result = {
        "name": key,
        "title": title,
        "caption": caption,
        **_made_of(seed, quick),
        "seconds": round(outcome.seconds, 2),
        "cpu_seconds": round(outcome.cpu_seconds, 2),
        "versions": _versions(),
        **out.summary(),
    }
    write_text(target / "result.json", json.dumps(result, indent=1, ensure_ascii=False) + "\n")
    return outcome


def cached_outcome(
    name: str, folder: Path | str, *, seed: int = 0, quick: bool = False
) -> ExperimentOutcome | None:
    """The outcome of an earlier run with the same result; ``None`` if there is none.

    Parameters
    ----------
    name
        Of :data:`EXPERIMENTS`.
    folder, seed, quick
        See :func:`reproduce`.
    """
    target, made_of = Path(folder) / name, _made_of(seed, quick)
    before = read_result(target)
    if before is None or {k: before.get(k) for k in made_of} != made_of:
        return None
    took = float(before.get("seconds", 0.0)), float(before.get("cpu_seconds", 0.0))
    return ExperimentOutcome(name, target, *took, kept=True)


def _made_of(seed: int, quick: bool) -> dict[str, Any]:
    return {"seed": seed, "quick": quick, "version": __version__}


def _cpu_s() -> float:
    """CPU time of this process and its finished child processes [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def read_result(folder: Path | str) -> dict[str, Any] | None:
    """Result of an experiment in its folder; ``None`` if it is missing or incomplete.

    Parameters
    ----------
    folder
        Of the experiment.
    """
    folder = Path(folder)
    try:
        result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(result, dict):
        return None
    named = [*result.get("tables", []), *result.get("pictures", [])]
    return result if named and all((folder / str(one)).is_file() for one in named) else None


def known_name(name: str) -> str:
    """Canonical name of an experiment, as in :data:`EXPERIMENTS`.

    Parameters
    ----------
    name
        ``figure-3.2``, ``fig3.2``, ``3.2`` ...

    Raises
    ------
    InputError
        Unknown experiment.
    """
    plain = name.lower().replace("_", "-").replace(" ", "-")
    for key in EXPERIMENTS:
        kind, number = key.split("-")
        if plain in {key, number, f"{kind}{number}", f"{kind[:3]}-{number}", f"{kind[:3]}{number}"}:
            return key
    raise InputError(name, f"is not an experiment, expected all or one of {', '.join(EXPERIMENTS)}")


def _module(key: str) -> ModuleType:
    chapter = key.split("-")[1].split(".")[0]
    return importlib.import_module(f".chapter_{chapter}.{EXPERIMENTS[key]}", __package__)


def title_and_caption(module: ModuleType) -> tuple[str, str]:
    """Title and caption of an experiment: from its docstring ``TITLE (Fig. 3.2).`` and the paragraphs below.

    Parameters
    ----------
    module
        Of the experiment.
    """
    first, _, caption = (module.__doc__ or "").partition("\n\n")
    return first.partition(" (")[0], " ".join(caption.split())


def _versions() -> dict[str, str]:
    from importlib import metadata

    found = {"python": platform.python_version(), "visuohaptic": __version__}
    for name in _LIBRARIES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found
