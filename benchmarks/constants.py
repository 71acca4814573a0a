"""Mutation test of constants: which constants can change without a failing test.

    python -m benchmarks.constants --list                 list the constants, run nothing
    python -m benchmarks.constants --only 'sensing.*'     constants of matching modules (or module:NAME)
    python -m benchmarks.constants --jobs 2               all constants: takes many hours
    python -m benchmarks.constants --near 2 --seconds 6    all of them by quick tests; can be resumed

Prints the constants of each package by result, and the list of those that are not noticed.

A constant is a name at module level that is assigned a number, a tuple, list, set or dict with numbers, an array
made of literals, or the call of a constructor with numbers among its arguments. Arithmetic of literals and
conversions (``np.deg2rad(8.0)``, ``2.0 * math.pi``) are one number; values computed from other names are derived and
not constants. All numbers of one name are multiplied together; the keys of a dict are labels and remain unchanged. Not
constants: zeros, enumerated names (``A, B, C = 0, 1, 2`` or ``range(3)``), type aliases, shapes
(``np.zeros((2, 3))``), versions of formats (``..._FORMAT``), and special names (``__all__``).

One constant at a time is multiplied by 0.8 and by 1.25 when its module is imported (integers are rounded away from
the value), and the tests that execute the module run, fastest first, until one fails. They are determined by
running every test file once and recording which functions of the package each test calls, also in processes that it
starts; a module is executed if one of its functions, or of a module that imports it (also through packages, compiled
modules and modules without functions), is called, or by a test that calls nothing if its file imports the module. Tests
that fail without any change are excluded. Compiled functions have a cache of their own, which starts as a copy of the
user's: only those that depend on the constant are recompiled. Each test run is a fork of a process that has imported
the libraries and those modules that do not need the changed one; the tests must pass there without a change.

- *noticed*: a test fails, or the test run crashes;
- *crashed*: the module cannot be imported with the value;
- *undecided*: the tests took more than ``--seconds`` of CPU time, or never imported the module with the new value;
- *unnoticed*: no test fails, or no test executes the module.

``--seconds`` limits a test file, too; a test that takes more than a quarter of it is left out, and so are all but the
fastest of a module that take a quarter together, or the first ``--most``. With ``--near N``, only the N test files are
used that import a module, or a module of its folder that imports it, those first that import the fewest modules. Other
tests may notice what these do not. ``--sample`` draws constants with a seed.

In the table, the less noticed of its two changes counts for a constant. Each change is a line in the report, with
digests of its module and of its tests; after an edit of either, it is tested again.
"""

from __future__ import annotations

import argparse
import ast
import bisect
import hashlib
import itertools
import json
import random
import re
import threading
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from . import _mutant
from ._journal import Journal
from ._warm_process import Server
from .house import ROOT, Module, imported_modules, is_compiled, read_modules

__all__ = ["Change", "Project", "main"]

#: From the least to the best noticed.
RESULTS = ("unnoticed", "undecided", "noticed", "crashed")


@dataclass(frozen=True, slots=True)
class Change:
    """One constant, multiplied."""

    module: str
    name: str
    line: int
    up: bool  #: times 1.25, else times 0.8

    @property
    def title(self) -> str:
        return f"{self.module}:{self.name}"

    @property
    def factor(self) -> str:
        return "x1.25" if self.up else "x0.8"


class Project:
    """A package in ``src`` with tests in ``tests``, and how its tests are run.

    Parameters
    ----------
    root
        Folder of the project.
    seconds
        Limit of one test run, in seconds.
    """

    def __init__(self, root: Path, seconds: float) -> None:
        self.root, self.seconds = root.resolve(), seconds
        self.modules = read_modules(self.root / "src")
        self.tests = {
            path.relative_to(self.root).as_posix(): _digest(path.read_text(encoding="utf-8"))
            for path in sorted((self.root / "tests").rglob("test_*.py"))
        }
        compiled = {
            name for name, module in self.modules.items() if any(map(is_compiled, module.functions()))
        }
        imports = {name: set(imported_modules(module, self.modules)) for name, module in self.modules.items()}
        importers: dict[str, set[str]] = defaultdict(set)
        for name, others in imports.items():
            for other in others:
                importers[other].add(name)
        self._importers = importers
        self._servers: dict[int, Server] = {}
        self._passed_on = compiled | {
            name for name, module in self.modules.items() if module.is_package or not any(module.functions())
        }

    def changes(self, pattern: str) -> list[Change]:
        """The changes of all constants whose module or ``module:NAME`` matches (anywhere)."""
        return [
            Change(module.name, name, line, up)
            for module in self.modules.values()
            for name, line in _mutant.find_constants(module.tree).items()
            if re.search(pattern, f"{module.name}:{name}")
            for up in (False, True)
        ]

    def run(
        self, runs: list[dict[str, Any]], hidden: str | None = None, modules: Iterable[str] = ()
    ) -> list[dict[str, Any]]:
        """Run tests, each run in a fork of this thread's process that has the libraries.

        Parameters
        ----------
        runs
            ``tests`` of each, and the ``order`` for :mod:`benchmarks._mutant`.
        hidden, modules
            Module that the runs change, and those that may be imported before unless they need it.

        Returns
        -------
        list of dict
            The answers of :mod:`benchmarks._warm`; after a run without an order that fails, no other is made.
        """
        server = self._servers.get(threading.get_ident())
        if server is None:
            server = self._servers[threading.get_ident()] = Server(self.root, self.modules)
        for run in runs:
            explores = "source" in run["order"]
            run["options"] = ["-q", "-rfE", "-p", "no:cacheprovider"]
            run["options"] += ["-p", "sitecustomize"] if explores else ["-x"] if run["order"] else []
            run["seconds"] = (3.0 if explores else 1.0) * self.seconds
        answers = server.answers({"hidden": hidden, "modules": [*modules], "runs": runs})
        for answer in answers:
            # A test is not found, too, where its file cannot be imported, as for an error inside of pytest (code 3).
            if answer["code"] == 4 and explores:
                raise SystemExit(f"pytest cannot run in {self.root}:\n{answer['output'][-2000:]}")
        return answers

    def explore(self, test: str) -> dict[str, Any]:
        """Seconds of each quick test of a file that passes, the modules that it calls, and those that any of them may call."""
        order = {"source": str(self.root / "src"), "quick": self.seconds / 4.0, "seconds": self.seconds}
        (seen,) = self.run([{"tests": [test], "order": order}])
        marks = [json.loads(text) for text in seen["marks"]]
        names = {str(module.path): name for name, module in self.modules.items()}
        calls: dict[str, set[str]] = defaultdict(set)
        for mark in marks:
            for place, files in mark["calls"].items():
                calls[place if "::" in place else ""] |= {names[file] for file in files if file in names}
        failed = {node for mark in marks for node in mark["failed"]}
        tests = {
            node: {"seconds": round(seconds, 3), "called": sorted(calls[node] - calls[""])}
            for mark in marks for node, seconds in mark["seconds"].items() if node not in failed
        }  # fmt: skip
        found = {file for mark in marks for file in mark["imported"]}
        return {
            "passed": bool(tests) or seen["code"] == 5,  # it has no tests
            "seconds": seen["seconds"],
            "called": sorted(calls[""]),
            "imported": sorted(names[file] for file in found if file in names),
            "tests": tests,
        }

    def judge(self, changes: list[Change], tests: list[str], modules: Iterable[str]) -> list[dict[str, Any]]:
        """Whether changes of one module are noticed by tests, which pass without them; modules that these import."""
        orders = [{}, *({"module": one.module, "name": one.name, "up": one.up} for one in changes)]
        answers: list[dict[str, Any]] = [{"code": 5}, *({} for _ in changes)]
        if tests:
            runs = [{"tests": tests, "order": order} for order in orders]
            answers = self.run(runs, changes[0].module, modules)
        first, *seen_with = answers
        if first["code"] not in (0, 5):
            # Tests that pass in their file only; without any, all of them take too long.
            red = tuple(_failed(first["output"]))  # up to a space in a parameter
            green = [test for test in tests if not test.startswith(red)]
            return self.judge(changes, green if red else tests[: len(tests) // 2], modules)
        rows = []
        for change, seen in zip(changes, seen_with, strict=True):
            row = {"title": change.title, "factor": change.factor, "line": change.line, "tests": len(tests)}
            if not tests:
                rows.append(row | {"result": "unnoticed", "by": "no quick test executes the module"})
                continue
            by = next(_failed(seen["output"]), "")
            if "crashed" in seen["marks"]:
                result, why = "crashed", "import"
            elif seen["code"] in (None, 3, 4):
                result, why = "undecided", f"no tests, or longer than {self.seconds:g} s"
            elif "loaded" not in seen["marks"]:
                result, why = "undecided", "the tests did not import the changed module"
            elif seen["code"] in (0, 5):
                result, why = "unnoticed", ""
            else:
                result, why = "noticed", by or f"exit code {seen['code']}"
            rows.append(row | {"result": result, "by": why, "seconds": seen["seconds"]})
        return rows

    def executing(self, name: str, known: dict[str, dict[str, Any]], most: int | None) -> list[str]:
        """Tests that pass and execute a module, fastest first, up to a number or a quarter of the time."""
        users = _closure({name}, self._importers, lambda other: other == name or other in self._passed_on)
        found = {}
        for file, row in known.items():
            reads = name in self._test_imports[file]  # its tests may compare the constants themselves
            for node, test in row["tests"].items():
                if users & {*row["called"], *test["called"]} or (reads and not test["called"]):
                    found[node] = test["seconds"]
        tests = sorted(found, key=found.__getitem__)[:most]
        until = list(itertools.accumulate(found[test] for test in tests))
        return tests[: 1 + bisect.bisect(until, 0.25 * self.seconds)]

    def importing(self, name: str, count: int) -> list[str]:
        """Test files that import a module or what imports it in its folder, at most ``count``, the most specific first."""
        folder = name.rpartition(".")[0]

        def beside(other: str) -> bool:  # in its folder, or the package itself where it imports its modules
            return folder in (other, other.rpartition(".")[0])

        users = set(filter(beside, _closure({name}, self._importers, beside)))
        found = [test for test, imports in self._test_imports.items() if users & imports]
        own = f"tests/{'/'.join(folder.split('.')[1:2])}/"

        def distance(test: str) -> tuple[bool, bool, int]:
            return (
                not test.startswith(own),
                name not in self._test_imports[test],
                len(self._test_imports[test]),
            )

        return sorted(found, key=distance)[:count]

    @cached_property
    def _test_imports(self) -> dict[str, set[str]]:
        """Modules of the package that each test file imports."""
        found = {}
        for test in self.tests:
            path = self.root / test
            text = path.read_text(encoding="utf-8")
            tree = ast.parse(text)
            own = Module(test.removesuffix(".py").replace("/", "."), path, text, tree, tuple(ast.walk(tree)))
            found[test] = set(imported_modules(own, self.modules))
        return found

    def key(self, change: Change, tests: list[str]) -> str:
        """Name of a change in the report."""
        files = sorted({test.partition("::")[0] for test in tests})
        texts = [self.modules[change.module].text, *(self.tests[file] for file in files)]
        return f"{change.title} {change.factor} {_digest(*texts)}"


def _closure(start: set[str], edges: dict[str, set[str]], followed: Callable[[str], bool]) -> set[str]:
    """All nodes reached along edges, through nodes that are followed."""
    found: set[str] = set()
    waiting = list(start)
    while waiting:
        if (name := waiting.pop()) not in found:
            found.add(name)
            waiting += edges.get(name, ()) if followed(name) else ()
    return found


def _digest(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:12]


def _failed(output: str) -> Iterator[str]:
    """The tests that pytest's output says to have failed."""
    return (found.group(1) for found in re.finditer(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE))


def _fill(
    journal: Journal, work: dict[tuple[str, ...], Callable[[], list[dict[str, Any]]]], jobs: int
) -> None:
    """Add the rows that a journal lacks, as they are computed, several at a time."""
    pool = ThreadPoolExecutor(jobs)
    try:
        waiting = {
            pool.submit(job): keys for keys, job in work.items() if not all(key in journal for key in keys)
        }
        for count, done in enumerate(as_completed(waiting), 1):
            for key, row in zip(waiting[done], done.result(), strict=True):
                journal.put(key, row)
                print(f"{count}/{len(waiting)} {key.rpartition(' ')[0]} {_told(row)}", flush=True)
    finally:
        pool.shutdown(cancel_futures=True)


def _told(row: dict[str, Any]) -> str:
    if "result" in row:
        return f"{row['result']} {row['by']}".strip()
    return f"{row['seconds']} s, {len(row['tests'])} tests" + ("" if row["passed"] else ", fails")


def table(rows: list[dict[str, Any]]) -> str:
    """Constants of each package by result, and the list of those that are not noticed."""
    changes: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for row in rows:
        changes[row["title"]].append(row)
    packages: dict[str, Counter] = defaultdict(Counter)
    lines = []
    for title, both in changes.items():
        worst = min((row["result"] for row in both), key=RESULTS.index)
        package = title.partition(":")[0].split(".")[1:2]
        for name in (*package, "all"):
            packages[name][worst] += 1
        if worst in ("unnoticed", "undecided"):
            told = [f"{row['factor']} {row['result']} {row['by']}".strip() for row in both]
            lines.append(f"  {title} (line {both[0]['line']}): {', '.join(told)}")
    head = f"{'package':24}{'constants':>11}" + "".join(f"{name:>11}" for name in RESULTS)
    body = [
        f"{name:24}{count.total():>11}" + "".join(f"{count[result]:>11}" for result in RESULTS)
        for name, count in sorted(packages.items(), key=lambda item: (item[0] == "all", item[0]))
    ]
    return "\n".join([head, *body, "", "not noticed:", *lines])


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--list", action="store_true", help="only say which constants there are")
    parser.add_argument("--only", default="", metavar="PATTERN", help="regular expression, of module:NAME")
    parser.add_argument("--report", type=Path, default=Path("results/constants.jsonl"), metavar="FILE")
    parser.add_argument("--jobs", type=int, default=1, help="test runs at a time")
    parser.add_argument("--seconds", type=float, default=900.0, metavar="S", help="limit of one test run")
    parser.add_argument("--near", type=int, metavar="N", help="judge by N test files that import the module")
    parser.add_argument(
        "--most", type=int, metavar="N", help="judge by the N quickest tests that execute the module"
    )
    parser.add_argument("--sample", type=int, metavar="N", help="so many constants, drawn with --seed")
    parser.add_argument("--seed", type=int, default=0, help="of the sample (%(default)s)")
    parser.add_argument("--root", type=Path, default=ROOT, help="folder with src and tests")
    args = parser.parse_args(arguments)
    project = Project(args.root, args.seconds)
    changes = project.changes(args.only)
    if args.sample is not None:
        titles = sorted({change.title for change in changes})
        drawn = set(random.Random(args.seed).sample(titles, min(args.sample, len(titles))))
        changes = [change for change in changes if change.title in drawn]
    if args.list:
        listed = [f"{change.title} (line {change.line})" for change in changes if change.up]
        print(*listed, f"{len(listed)} constants", sep="\n")
        return
    about = {"campaign": "constants", "seconds": args.seconds}
    known = _explored(project, args, about, sorted({change.module for change in changes}))
    journal = Journal(args.report, about)
    work: dict[tuple[str, ...], Callable[[], list[dict[str, Any]]]] = {}
    for module, group in itertools.groupby(changes, key=lambda change: change.module):
        members = list(group)
        tests = project.executing(module, known, args.most)
        used = {test.partition("::")[0] for test in tests}
        imported = {name for test in used for name in known[test]["imported"]}
        keys = tuple(project.key(change, tests) for change in members)
        work[keys] = partial(project.judge, members, tests, sorted(imported))
    _fill(journal, work, args.jobs)
    print(table([journal.rows[key] for keys in work for key in keys]))


def _explored(
    project: Project, args: argparse.Namespace, about: dict[str, Any], modules: list[str]
) -> dict[str, Any]:
    """What the tests of every file call, or of those near some modules: each file is run once."""
    calls = Journal(args.report.with_suffix(".tests.jsonl"), about)
    names = _digest(*project.modules)  # when modules move, tests call others
    near = partial(project.importing, count=args.near)
    chosen = {*project.tests} if args.near is None else {test for module in modules for test in near(module)}
    keys = {test: f"{test} {_digest(text, names)}" for test, text in project.tests.items() if test in chosen}
    _fill(
        calls,
        {(key,): partial(lambda test: [project.explore(test)], test) for test, key in keys.items()},
        args.jobs,
    )
    known = {test: calls.rows[key] for test, key in keys.items()}
    if failing := [test for test, row in known.items() if not row["passed"]]:
        print("left out, they fail without any change:", *failing)
    return known


if __name__ == "__main__":
    main()
