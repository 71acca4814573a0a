"""The table of the robustness tests of this library and their results.

    python -m benchmarks.reliability                            a slice of every row, in minutes
    python -m benchmarks.reliability --items 1 5 --scale 10 --report rows.jsonl    ten times as many cases of two rows
    python -m benchmarks.reliability --items 1 16 --first 40 --report rows.jsonl   other random cases than before
    python -m benchmarks.reliability --report rows.jsonl --also fuzz.jsonl bare.jsonl --page docs/reliability.md

Campaigns with their own report (:data:`TAKEN`, ``mutants``, ``branch_coverage``) are included by ``--also``.

Each case is saved in the report as it is completed, and an interrupted run is continued. A row that was not run is marked.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from . import (
    determinism,
    foam_faults,
    golden,
    hostile_arrays,
    hostile_files,
    kill_faults,
    mission_faults,
    mutants,
    ros_soak,
    soak,
)
from ._journal import Journal
from ._page_attacks import serve_and_attack

Rng = np.random.Generator
#: Behind the remark on a row, or the name of a package, whose figures are those of an earlier page.
EARLIER = " (earlier code)"
ROOT = Path(__file__).resolve().parents[1]
#: Files that caused faults; they are moved to ``tests/corpus`` when the fault is fixed.
KEPT = ROOT / "results" / "hostile"
#: Figures of a case; a case of a row has those that apply.
FIGURES = ("tried", "crashed", "hung", "wrong", "lost")
Case = tuple[str, Callable[[], dict[str, int]]]


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the table."""

    number: int
    title: str
    target: str  #: how many are owed, and what may come of them
    cases: Callable[[range], Iterator[Case]] | None = None  #: by numbers of slices; None: run elsewhere
    elsewhere: str = ""  #: the command, or why it is not run
    note: Callable[[dict[str, dict[str, Any]]], str] = lambda _: ""  #: remark on the cases, by key


def _files(slices: range) -> Iterator[Case]:
    # The first case is a slice of seconds; the others keep one process busy for many files.
    for number in slices:
        per_case = (4 if number == slices[0] else 20) * len(hostile_files.READERS)

        def run(number: int = number, per_case: int = per_case) -> dict[str, int]:
            journal = Journal(None, {})
            hostile_files.campaign(per_case, 2 * number, journal, KEPT, batch=per_case)
            found = hostile_files.summary(journal)
            wrong = found.get("unclear", 0)
            return {
                "tried": found["tried"],
                "crashed": found.get("crashed", 0),
                "hung": found.get("hung", 0),
            } | {"wrong": wrong}

        yield f"mutations, seed {2 * number}", run


def _arrays(slices: range) -> Iterator[Case]:
    names = list(hostile_arrays.public_functions())
    for start in range(0, min(len(names), 40 * len(slices)), 20):

        def run(part: list[str] = names[start : start + 20]) -> dict[str, int]:
            journal = Journal(None, {})
            hostile_arrays.campaign(part, slices[0], journal)
            found = hostile_arrays.summary(journal)
            return {name: found[name] for name in ("tried", "crashed", "wrong")}

        yield f"functions from {names[start]}, seed {slices[0]}", run


def _kills(slices: range) -> Iterator[Case]:
    for number in range(4 * slices.start, 4 * slices.stop):
        for row in (kill_faults.killed_row, kill_faults.full_disk_row):

            def run(number: int = number, row: Any = row) -> dict[str, int]:
                with tempfile.TemporaryDirectory() as root:
                    found = row(number, Path(root))
                return {"tried": 1, "wrong": found.get("wrong", 0), "lost": found["lost"]}

            yield f"{row.__name__} {number}", run


def _cuts(slices: range) -> Iterator[Case]:
    count = 30 * len(slices)

    def run() -> dict[str, int]:
        rows = kill_faults.cut_rows(count)
        return {"tried": len(rows), "lost": sum(row["lost"] for row in rows)}

    yield f"cut at {count} places", run


def _tested(*words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Results of test files, run in a separate process."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *words]
    env = {**os.environ, **environment}
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT, env=env)


def _counted(*words: str, **environment: str) -> dict[str, int]:
    """Tests as cases: each one that passes was tried."""
    done = _tested(*words, **environment)
    passed, failed = (re.search(rf"(\d+) {word}", done.stdout) for word in ("passed", "failed"))
    wrong = int(failed[1]) if failed else int(done.returncode != 0)
    return {"tried": (int(passed[1]) if passed else 0) + wrong, "wrong": wrong}


def _golden(_slices: range) -> Iterator[Case]:
    def run() -> dict[str, int]:
        done = _tested("tests/test_golden.py")
        versions = len(list((ROOT / "tests/golden").iterdir()))
        return {"tried": versions * (len(golden.NAMES) + 4), "wrong": int(done.returncode != 0)}

    yield "files of every format", run


def _passing(*places: str) -> Callable[[range], Iterator[Case]]:
    """Cases of tests, by file: each one that passes was tried."""

    def cases(_slices: range) -> Iterator[Case]:
        for place in places:
            for path in (
                sorted((ROOT / place).rglob("test_*.py")) if (ROOT / place).is_dir() else [ROOT / place]
            ):
                file = path.relative_to(ROOT).as_posix()

                yield file, partial(_counted, file)

    return cases


#: Tests that compare kernels with plain code, and those of what is made of many kernels.
_KERNELS = (
    "tracking/test_block_kernels.py", "tracking/test_kernels.py", "tracking/test_pose_kernels.py",
    "sensing/test_object_kernels.py", "sensing/foam/test_profile.py", "sensing/test_floor_motion.py",
    "navigation/test_push_search_kernels.py", "navigation/test_mapper.py", "navigation/test_passages.py",
    "deformation/test_kernels.py", "reconstruction/test_fusion.py", "io/test_local_remesh.py",
)  # fmt: skip
#: Packages whose tests are run in random orders.
_SHUFFLED = ("io", "database", "viewer", "report")


def _bounds(_slices: range) -> Iterator[Case]:
    for file in _KERNELS:
        words = f"tests/{file}", "-m", "not slow and not data"
        yield file, partial(_counted, *words, NUMBA_BOUNDSCHECK="1")


def _orders(slices: range) -> Iterator[Case]:
    folders = [f"tests/{name}" for name in _SHUFFLED]
    for seed in range(slices.start + 1, slices.stop + 1):
        words = *folders, "-m", "not slow and not data", "--shuffle", str(seed)
        yield f"{', '.join(_SHUFFLED)}, seed {seed}", partial(_counted, *words)


def _server(slices: range) -> Iterator[Case]:
    for number in slices:

        def run(number: int = number) -> dict[str, int]:
            return serve_and_attack(1000, np.random.default_rng([16, 2 * number]))

        yield f"requests, seed {2 * number}", run


def _minutes_each(cases: dict[str, dict[str, Any]]) -> str:
    """Shortest and longest time that a parser was fuzzed."""
    spent: Counter[str] = Counter()
    for key, case in cases.items():
        spent[key.partition(",")[0]] += case["seconds"]
    minutes = [second / 60.0 for second in sorted(spent.values())]
    return f"{len(minutes)} parsers, {minutes[0]:.1f} to {minutes[-1]:.1f} min each"


def _hours_each(cases: dict[str, dict[str, Any]]) -> str:
    """Hours of each loop, in its own time."""
    spent: Counter[str] = Counter()
    for key, case in cases.items():
        spent[key.partition(",")[0]] += case["hours"]
    return ", ".join(f"{name} {hours:.1f} h" for name, hours in spent.items())


def _pythons(cases: dict[str, dict[str, Any]]) -> str:
    """The installed versions."""
    return ", ".join(dict.fromkeys(key.partition(" ")[0] for key in cases))


def _messages(slices: range) -> Iterator[Case]:
    """Addresses with a password in every place that a driver reads it from: none comes back."""
    from visuohaptic.core import VisuohapticError
    from visuohaptic.database import ObjectDatabase

    def run() -> dict[str, int]:
        shown = 0
        schemes = ("postgresql", "postgres", "mysql", "postgresql+pg8000", "postgres+x", "http")
        texts = (
            "://bob:{}@h/n",
            "://h/n?user=bob&password={}",
            "://bob:{}@h:port/n",
            "://b:{}@[::1/n",
            "://:{}@/",
        )
        words = [f"s3cr3t{n}{end}" for n in slices for end in ("", "@x", "/y", "?z", ":q")]
        cases = [scheme + text.format(word) for scheme in schemes for text in texts for word in words]
        for address in cases:
            try:
                ObjectDatabase(address)
            except VisuohapticError as error:
                shown += "s3cr3t" in str(error)
        return {"tried": len(cases), "wrong": shown}

    yield "passwords in addresses", run


ROWS = (
    Row(1, "damaged and hostile files, all readers, 2 GB and 20 s each", "10,100: 0 / 0 / 0", _files),
    Row(
        2,
        "coverage-guided fuzzing of own parsers",
        "1 h each: 0",
        elsewhere="`python -m benchmarks.parser_fuzz --minutes 60 --report fuzz.jsonl` (needs atheris)",
        note=_minutes_each,
    ),
    Row(
        3,
        "stream faults, 20 kinds, two renderers",
        "6,000: 0 wrong",
        elsewhere="`python -m benchmarks.foam_faults 6000 70000 --report foam.jsonl`",
    ),
    Row(
        4,
        "stale and frozen sources, clocks that stop or jump",
        "500: stop in 200 ms",
        elsewhere="`python -m benchmarks.mission_faults`",
    ),
    Row(5, "public functions, hostile arrays", "2,000: 0 foreign exceptions", _arrays),
    Row(6, "kill -9 and full disk, recordings and databases", "500: 0 lost, 0 half-written", _kills),
    Row(
        7,
        "builds and cluster workers killed",
        "50: same hash",
        elsewhere="`python -m benchmarks.build_faults --report builds.jsonl`",
    ),
    Row(8, "cut recordings", "300: all whole messages", _cuts),
    Row(9, "laws (property tests)", "10^4 examples each", elsewhere="`python -m benchmarks.laws`"),
    Row(10, "golden files of every format", "all read", _golden),
    Row(
        11,
        "determinism of 11 verbs: hash seeds, threads, cores",
        "50: same bytes",
        lambda slices: determinism.cases(len(slices)),
    ),
    Row(
        12,
        "soak: chain, bridge, page, tasks, node over DDS (tried: frames, images, redraws, tasks)",
        "4 h: flat",
        elsewhere="`python -m benchmarks.soak --what chain bridge page mission --hours 4 --report soak.jsonl`, `benchmarks.ros_soak`",
        note=_hours_each,
    ),
    Row(
        13,
        "bare installations, `demo --quick`: read-only, no home, C locale",
        "12: both commands of the README",
        elsewhere="`python -m benchmarks.bare`",
        note=_pythons,
    ),
    Row(14, "docs, examples, help", "all run", _passing("tests/docs", "tests/cli/test_help_examples.py")),
    # Archives that unpack to more than they should, links and names that lead out of their folder, devices.
    Row(15, "archives, links, traversal, devices", "100: refused", _passing("tests/test_security.py")),
    Row(16, "servers: hosts, origins, malformed requests", "10,000: 0", _server),
    Row(17, "messages without secrets", "all", _messages),
    Row(18, "every index of kernels checked (`make bounds`), tests", "all: 0 outside", _bounds),
    Row(19, "tests in random orders (`make shuffle`)", "20 orders: 0 fail", _orders),
)


def _read_other(path: Path) -> tuple[str, dict[str, Any]]:
    """Campaign and rows of another report."""
    about, *lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return about["campaign"], {line["key"]: line["row"] for line in lines}


def _of_foam(row: dict[str, Any]) -> dict[str, int]:
    frames = zip(row["valid"], row["error_N"], row["sigma_N"], strict=True)
    wrong = sum(valid and abs(error) > 5.0 * sigma + foam_faults.ALLOWED_N for valid, error, sigma in frames)
    return {"tried": 1, "wrong": wrong}


def _of_mission(row: dict[str, Any]) -> dict[str, int]:
    late = (row.get("motion_s") or 0.0) > mission_faults.STOPPED_S + 1e-9
    return {"tried": 1, "crashed": int("crash" in row), "wrong": int(late)}


def _of_node(rows: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """A case of each process of a node: images, and whether it ended or grew after its first minutes."""
    cases = {}
    for process in dict.fromkeys(row["process"] for row in rows.values()):
        path = [row for row in rows.values() if row["process"] == process]
        warm = path[ros_soak.WARM :]
        growth = {
            name: max(row[name] for row in warm) - warm[0][name] for name in ("memory_MB", "handles") if warm
        }
        cases[f"node, process {process}"] = {
            "tried": sum(row["sent"] for row in path),
            "crashed": sum(not row["alive"] for row in path),
            "wrong": int(growth.get("memory_MB", 0.0) > soak.FLAT_MB) + int(growth.get("handles", 0) > 0),
            "hours": len(path) / 60.0,
        }
    return cases


def _each(case: Callable[[dict[str, Any]], dict[str, Any]]) -> Taken:
    """The same for each row of a report."""
    return lambda rows: {key: case(row) for key, row in rows.items()}


Taken = Callable[[dict[str, dict[str, Any]]], dict[str, dict[str, Any]]]
#: Rows of the table that have a campaign and a report of their own, and the cases that its rows are in the table.
TAKEN: dict[str, tuple[int, Taken]] = {
    "parser fuzz": (
        2,
        _each(
            lambda row: {
                "tried": row["tried"], "crashed": int(bool(row["trouble"])), "wrong": 0, "seconds": row["seconds"],
            }
        ),
    ),
    "foam_faults": (3, _each(_of_foam)),
    "mission_faults": (4, _each(_of_mission)),
    "objects faults": (
        6,
        _each(
            lambda row: {
                "tried": row["tried"], "wrong": row["problems"] + row.get("half-written", 0), "lost": row["lost"],
            }
        ),
    ),
    "build_faults": (7, _each(lambda row: {"tried": row.get("kills", 0), "lost": row.get("lost", 0)})),
    "laws": (9, _each(lambda row: {"tried": row["tried"], "wrong": row["wrong"]})),
    "soak": (
        12,
        _each(
            lambda row: {
                "tried": row["frames"],
                "wrong": row["faults"] + int(row["growth_MB"] > soak.FLAT_MB) + int(row["handles"] > 0),
                "hours": row["hours"],
            }
        ),
    ),
    "ros soak": (12, _of_node),
    "bare": (13, _each(lambda row: {name: row.get(name, 0) for name in ("tried", "hung", "wrong")})),
}  # fmt: skip


def take_in(paths: list[Path], journal: Journal) -> dict[str, dict[str, Any]]:
    """Add the cases of other reports to their rows; returns those that have their own table."""
    apart: dict[str, dict[str, Any]] = {}
    for path in paths:
        campaign, rows = _read_other(path)
        if campaign not in TAKEN:
            apart.setdefault(campaign, {}).update(rows)
            continue
        number, cases = TAKEN[campaign]
        found = cases({key: row for key, row in rows.items() if row is not None})
        journal.rows |= {f"{number}: {key}": case for key, case in found.items()}
    return apart


def _of_tests(apart: dict[str, dict[str, Any]], before: str = "") -> list[str]:
    """Tables about the tests: mutants that they kill, and branches that they cover; packages without report as before."""
    mistakes, covered = (
        {
            f"{row[0].removesuffix(EARLIER)}{EARLIER}": row[1:]
            for row in _cells(before, title)
            if row[0] != "all"
        }
        for title in ("mistakes", "branches")
    )
    for package, count in mutants.counts(apart.get("mutants", {})).items():
        figures = [count[name] for name in ("killed", "survived", "uncovered")]
        if package != "all":
            mistakes.pop(f"{package}{EARLIER}", None)
            mistakes[package] = [str(one) for one in (sum(figures), *figures)]
    for package, row in apart.get("coverage", {}).items():
        covered.pop(f"{package}{EARLIER}", None)
        covered[package] = [
            f"{row['branches']:,}", f"{row['taken'] / row['branches']:.1%}", f"{row['lines']:,}",
            f"{row['executed'] / row['lines']:.1%}", f"{row['files']} of {row['of files']}",
        ]  # fmt: skip
    lines = []
    if mistakes:
        numbers = {
            package: [int(cell.replace(",", "")) for cell in row[:4]] for package, row in mistakes.items()
        }
        numbers["all"] = [sum(column) for column in zip(*numbers.values(), strict=True)]
        lines += [
            "",
            "## Whether the tests notice mistakes",
            "",
            "Small mistakes drawn at random and put into the code one at a time (`python -m benchmarks.mutants`); the score",
            "is killed of all, by the tests of the package alone, so a lower bound. Owed: 0.75. *Near*: only by files of tests",
            "that name the module, what it defines or what uses it, a still lower bound. Changes that no correct test can tell from",
            "the original are not drawn, by four rules (boundaries of computed numbers, guards against zero, budgets, looks of figures).",
            "",
            "| package | mistakes | killed | survived | not executed | score |",
            "|---|---|---|---|---|---|",
        ]
        lines += [
            f"| {package} | {' | '.join(map(str, row))} | {row[1] / max(row[0], 1):.2f} |"
            for package, row in numbers.items()
        ]
    if covered:
        lines += [
            "",
            "Branches that the tests of a package take (`python -m benchmarks.branch_coverage`), kernels left out; a lower bound",
            "where not all files of tests were run. Owed: 90 %.",
            "",
            "| package | branches | taken | lines | executed | files of tests |",
            "|---|---|---|---|---|---|",
        ]
        lines += [
            f"| {package} | {' | '.join([*row, '-'][:5])} |" for package, row in sorted(covered.items())
        ]
    return lines


def _cells(page: str, title: str) -> list[list[str]]:
    """Cells of the rows of the table whose second column has a title."""
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in page.splitlines()]
    start = next((number for number, row in enumerate(rows) if len(row) > 1 and row[1] == title), len(rows))
    found = []
    for row in rows[start + 2 :]:
        if len(row) < 2:
            break
        found.append(row)
    return found


def table(journal: Journal) -> list[dict[str, Any]]:
    """Figures of all rows from the cases in a journal."""
    found = []
    for row in ROWS:
        start = f"{row.number}: "
        own = {key.removeprefix(start): case for key, case in journal.rows.items() if key.startswith(start)}
        cases = list(own.values())
        figures = (
            {name: sum(case[name] for case in cases if name in case) for name in FIGURES} if cases else {}
        )
        given = {name for case in cases for name in case}
        found.append(
            {
                "row": row,
                "note": row.note(own),
                **{name: figures.get(name) if name in given else None for name in FIGURES},
            }
            if cases
            else {"row": row}
        )
    return found


def _figures(figures: dict[str, Any], kept: list[str]) -> list[str]:
    """Cells of a row behind its target: from the reports, or from the page before, which the remark says."""
    row = figures["row"]
    if "tried" not in figures:
        if not kept[0]:
            return [*[""] * len(FIGURES), row.elsewhere or "not run"]
        return [*kept[:-1], f"{kept[-1].removesuffix(EARLIER.strip()).strip()}{EARLIER}".strip()]
    note = figures["note"]
    before = [int(cell.replace(",", "")) if cell.strip("-") else 0 for cell in kept[: len(FIGURES)]]
    # The largest sample so far: that of the page before, or one that it names.
    told = re.findall(r"with earlier code ([\d,]+) tried, (\d+) failed", kept[-1])
    tried, failed = max(
        [(before[0], sum(before[1:])), *((int(one.replace(",", "")), int(other)) for one, other in told)]
    )
    if tried > figures["tried"]:
        note = f"{note}; " * bool(note) + f"with earlier code {tried:,} tried, {failed} failed"
    return [*("-" if figures[name] is None else f"{figures[name]:,}" for name in FIGURES), note]


def markdown(
    journal: Journal, apart: dict[str, dict[str, Any]] | None = None, before: str = "", commit: str = ""
) -> str:
    """The page of the table; rows that are not in the reports are those of the page ``before``, and say so."""
    others = f" The others were measured up to commit {commit}." if commit else ""
    kept = {row[0].partition(" ")[0]: row[2:] for row in _cells(before, "owed")}
    lines = [
        "# Reliability",
        "",
        "What was tried against the library from outside, and what came of it. Made by",
        "`python -m benchmarks.reliability --report rows.jsonl --also OTHER.jsonl ... --page docs/reliability.md`, with the",
        "reports of the commands in the last column; a dash stands for a figure that a row does not have. *Wrong* are wrong",
        "results, refusals that are not one clear line, and attacks that were not refused. *Earlier code*: the figures are of",
        f"an earlier state of the library and were not measured again for this page.{others}",
        "",
        "| item | owed | tried | crashed | hung | wrong | lost | remarks |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for figures in table(journal):
        row = figures["row"]
        cells = " | ".join(_figures(figures, kept.get(str(row.number), [""])))
        lines.append(f"| {row.number} {row.title} | {row.target} | {cells} |")
    return "\n".join([*lines, *_of_tests(apart or {}, before)]) + "\n"


def main() -> None:
    """Run, or continue, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--items", type=int, nargs="*", default=[row.number for row in ROWS])
    parser.add_argument("--scale", type=int, default=1, help="how many times the slice")
    parser.add_argument("--first", type=int, default=0, help="number of the first slice: other random cases")
    parser.add_argument("--report", type=Path)
    parser.add_argument("--page", type=Path, help="update the table in a page")
    parser.add_argument("--also", type=Path, nargs="*", default=[], help="reports of other campaigns")
    args = parser.parse_args()
    journal = Journal(args.report, {"campaign": "reliability"})
    for row in ROWS:
        if row.number not in args.items or row.cases is None:
            continue
        for name, run in row.cases(range(args.first, args.first + args.scale)):
            if (key := f"{row.number}: {name}") not in journal:
                journal.put(key, run())
                print(key, journal.rows[key], flush=True)
    before = args.page.read_text(encoding="utf-8") if args.page is not None and args.page.exists() else ""
    words = ["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip()
    text = markdown(journal, take_in(args.also, journal), before, commit)
    if args.page is not None:
        args.page.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
