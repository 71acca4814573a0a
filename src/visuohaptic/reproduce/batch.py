"""Run many experiments in parallel, locally or on a cluster, with a table of their run times."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from ..core.files import atomic_path, write_csv
from ..core.map_tasks import map_tasks
from .runner import EXPERIMENTS, ExperimentOutcome, cached_outcome, known_name, reproduce

#: Experiments that share a long computation: they run sequentially, the first one computes it for all.
SHARED_COMPUTATIONS: tuple[tuple[str, ...], ...] = (("figure-6.6", "figure-6.7", "table-6.1", "table-6.2"),)
#: The longest experiments start first, so that none runs alone at the end.
EXPENSIVE: tuple[str, ...] = (
    "figure-5.8",
    "table-4.1",
    "figure-6.6",
    "figure-3.8",
    "figure-5.6",
    "figure-5.7",
    "figure-3.13",
)
#: File contents by name.
Files = dict[str, bytes]


@dataclass(frozen=True, slots=True)
class Unit:
    """Experiments that one process runs sequentially."""

    names: tuple[str, ...]
    folder: Path | None  #: folder of the results; ``None`` on a machine without access to it
    seed: int
    quick: bool


def reproduce_all(
    names: Sequence[str],
    folder: Path | str,
    *,
    seed: int = 0,
    quick: bool = False,
    force: bool = False,
    workers: int | str = 1,
    on_done: Callable[[ExperimentOutcome], None] | None = None,
) -> list[ExperimentOutcome]:
    """Run experiments into ``folder`` and write ``experiments.csv`` there.

    Parameters
    ----------
    names
        See :func:`.reproduce`.
    folder, seed, quick, force
        As there.
    workers
        See :func:`.map_tasks`. An experiment whose process dies does not stop the others.
    on_done
        Called in this process with each finished experiment.

    Returns
    -------
    list of ExperimentOutcome
        In the order of ``names``.

    Raises
    ------
    InputError
        Unknown name, ``workers`` less than one, or no reachable cluster.
    """
    selected = list(dict.fromkeys(known_name(name) for name in names))
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    found: dict[str, ExperimentOutcome] = {}

    def finished(outcome: ExperimentOutcome) -> None:
        found[outcome.name] = outcome
        # After each one, so that the results of an interrupted run are kept.
        write_costs(folder, found)
        if on_done is not None:
            on_done(outcome)

    for name in selected:
        if not force and (outcome := cached_outcome(name, folder, seed=seed, quick=quick)) is not None:
            finished(outcome)
    units = _units([name for name in selected if name not in found])
    # Other machines may not have access to this folder: their files are returned with the outcome.
    here = None if isinstance(workers, str) else folder
    tasks = [Unit(tuple(unit), here, seed, quick) for unit in units]
    runs = map_tasks(_run_unit, tasks, name="reproduce", workers=workers, on_death=_dead)
    for _, outcomes in runs:
        for outcome, files in outcomes:
            finished(_received(outcome, files, folder))
    return [found[name] for name in selected]


def _dead(unit: Unit, reason: str) -> list[tuple[ExperimentOutcome, Files]]:
    return [(ExperimentOutcome(name, Path(name), 0.0, problem=reason), {}) for name in unit.names]


def write_costs(folder: Path | str, found: Mapping[str, ExperimentOutcome]) -> Path:
    """Write ``experiments.csv``: name, wall and CPU time, whether there is a result, and the reason if not.

    Parameters
    ----------
    folder
        Of the results.
    found
        How each experiment went, by name.
    """
    rows = [
        (one.name, f"{one.seconds:.2f}", f"{one.cpu_seconds:.2f}", not one.problem, one.kept, one.problem)
        for one in (found[name] for name in EXPERIMENTS if name in found)
    ]
    path = Path(folder) / "experiments.csv"
    write_csv(path, ("name", "wall_s", "cpu_s", "ok", "kept", "problem"), rows)
    return path


def _units(names: Sequence[str]) -> list[list[str]]:
    """Groups for the processes: single experiments, or those with shared data; the most expensive first."""
    units: list[list[str]] = [[name for name in group if name in names] for group in SHARED_COMPUTATIONS]
    grouped = {name for unit in units for name in unit}
    units = [unit for unit in units if unit] + [[name] for name in names if name not in grouped]
    rank = {name: place for place, name in enumerate(EXPENSIVE)}
    return sorted(units, key=lambda unit: min(rank.get(name, len(rank)) for name in unit))


def _run_unit(unit: Unit) -> list[tuple[ExperimentOutcome, Files]]:
    """Outcomes, and the files of experiments that ran in their own folder."""
    with ExitStack() as stack:
        folder = unit.folder or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        found = []
        for name in unit.names:
            outcome = reproduce(name, folder, seed=unit.seed, quick=unit.quick, force=True)
            files = sorted(outcome.folder.iterdir()) if unit.folder is None else []
            found.append((outcome, {path.name: path.read_bytes() for path in files}))
    return found


def _received(outcome: ExperimentOutcome, files: Files, folder: Path) -> ExperimentOutcome:
    """Write the files of an experiment; ``result.json``, which marks them as complete, is written last."""
    target = folder / outcome.name
    target.mkdir(parents=True, exist_ok=True)
    for name in sorted(files, key=lambda name: (name == "result.json", name)):
        with atomic_path(target / name) as temporary:
            temporary.write_bytes(files[name])
    return replace(outcome, folder=target)
