"""Mutation test of constants: which constants can change without a failing test.

    python -m benchmarks.constants --list                 list the constants, run nothing
    python -m benchmarks.constants --only 'sensing.*'     constants of matching modules (or module:NAME)
    python -m benchmarks.constants --jobs 2               all constants: takes many hours; can be resumed
    python -m benchmarks.constants --near 4 --sample 12 --only '^visuohaptic.core'    a dozen, in minutes
    python -m benchmarks.constants --near 4 --most 12    all of them, at most a dozen tests each

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
modules and modules without functions), is called. Tests that fail without any change are excluded, and files without
any other tests are listed. Compiled functions are kept in a separate cache, which starts as a copy of the user's: only
functions that depend on the constant are recompiled. ``--most N`` stops after the N fastest tests of a constant.

- *noticed*: a test fails, or the test run crashes;
- *crashed*: the module cannot be imported with the value;
- *undecided*: the tests took longer than ``--seconds``, or never imported the module with the new value;
- *unnoticed*: no test fails, or no test executes the module.

With ``--near N``, calls are not recorded: a constant is tested with the N test files that import its
module, or a module of its folder that imports it, the most specific first (those that import the fewest modules). A
constant that they do not notice may still be noticed by other tests. With ``--most`` as well, calls are recorded only for
the test files near the constants. ``--sample`` draws constants with a seed.

In the table, the less noticed of its two changes counts for a constant. Each change is a line in the report, with
digests of its module and of its tests; after an edit of either, it is tested again.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from visuohaptic.core import cache_folder

from . import _mutant
from ._journal import Journal
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
        self._passed_on = compiled | {
            name for name, module in self.modules.items() if module.is_package or not any(module.functions())
        }
        self._compiled_in = _closure(compiled, imports, lambda _: True)

    def changes(self, pattern: str) -> list[Change]:
        """The changes of all constants whose module or ``module:NAME`` matches (anywhere)."""
        return [
            Change(module.name, name, line, up)
            for module in self.modules.values()
            for name, line in _mutant.find_constants(module.tree).items()
            if re.search(pattern, f"{module.name}:{name}")
            for up in (False, True)
        ]

    def run(self, tests: Iterable[str], order: dict[str, Any], private: bool = False) -> dict[str, Any]:
        """Run test files with an instruction for :mod:`benchmarks._mutant`; returns the result.

        Returns
        -------
        dict
            ``code`` of pytest (None when the time was over), ``output``, ``seconds`` and ``marks``, the texts that
            the processes left.
        """
        with tempfile.TemporaryDirectory() as place:
            folder, marks, cache = (Path(place, name) for name in ("site", "marks", "cache"))
            for made in (folder, marks, cache):
                made.mkdir()
            shutil.copy(_mutant.__file__, folder / "sitecustomize.py")
            paths = [str(folder), str(self.root / "src"), os.environ.get("PYTHONPATH", "")]
            environment = os.environ | {
                _mutant.VARIABLE: json.dumps(order | {"marks": str(marks)} if order else {}),
                "PYTHONPATH": os.pathsep.join(filter(None, paths)),
                "HYPOTHESIS_STORAGE_DIRECTORY": str(cache / "hypothesis"),
            }
            if private:
                environment |= dict.fromkeys(("NUMBA_CACHE_DIR", "VISUOHAPTIC_CACHE_DIR"), str(cache))
                _link_kernels(cache)
            options = ["-q", "-rfE", "-p", "no:cacheprovider"]
            options += ["-p", "sitecustomize"] if "source" in order else ["-x"]
            started = time.monotonic()
            code, output = _finish(
                [sys.executable, "-m", "pytest", *options, *tests], self.root, environment, self.seconds
            )
            left = [path.read_text(encoding="utf-8") for path in marks.iterdir()]
            if (
                code in (3, 4) and "crashed" not in left
            ):  # a test is not found, too, where its file cannot be imported
                raise SystemExit(f"pytest cannot run in {self.root}:\n{output[-2000:]}")
            seconds = round(time.monotonic() - started, 1)
            return {"code": code, "output": output, "seconds": seconds, "marks": left}

    def explore(self, test: str) -> dict[str, Any]:
        """Seconds of each test of a file that passes, the modules that it calls, and those that any of them may call."""
        seen = self.run([test], {"source": str(self.root / "src")})
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
        passed = bool(tests) or seen["code"] == 5  # it has no tests
        return {"passed": passed, "seconds": seen["seconds"], "called": sorted(calls[""]), "tests": tests}

    def judge(self, change: Change, tests: list[str]) -> dict[str, Any]:
        """Whether a change is noticed by test files."""
        row = {"title": change.title, "factor": change.factor, "line": change.line, "tests": len(tests)}
        if not tests:
            return row | {"result": "unnoticed", "by": "no test executes the module"}
        order = {"module": change.module, "name": change.name, "up": change.up}
        seen = self.run(tests, order, private=change.module in self._compiled_in)
        by = re.search(r"^(?:FAILED|ERROR) (\S+)", seen["output"], re.MULTILINE)
        red = by.group(1).partition("::")[0] if by else ""
        if red in tests and self.run([red], {})["code"] not in (0, 5):  # a file that was not run before
            return self.judge(change, [test for test in tests if test != red])
        if "crashed" in seen["marks"]:
            result, why = "crashed", "import"
        elif seen["code"] is None:
            result, why = "undecided", f"longer than {self.seconds:g} s"
        elif "loaded" not in seen["marks"]:
            result, why = "undecided", "the tests did not import the changed module"
        elif seen["code"] in (0, 5):
            result, why = "unnoticed", ""
        else:
            result, why = "noticed", by.group(1) if by else f"exit code {seen['code']}"
        return row | {"result": result, "by": why, "seconds": seen["seconds"]}

    def executing(self, name: str, known: dict[str, dict[str, Any]], most: int | None) -> list[str]:
        """Tests that pass and execute a module, fastest first, up to a maximum number."""
        users = _closure({name}, self._importers, lambda other: other == name or other in self._passed_on)
        found = {
            node: test["seconds"]
            for row in known.values()
            for node, test in row["tests"].items()
            if users & {*row["called"], *test["called"]}
        }
        return sorted(found, key=found.__getitem__)[:most]

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


def _link_kernels(cache: Path) -> None:
    """The user's compiled functions in a cache folder: each is kept under a digest of what its code depends on."""
    source = cache_folder()
    if source is not None and source.is_dir():
        shutil.copytree(source, cache / source.parent.name / source.name, copy_function=_linked)


def _linked(source: str, target: str) -> None:
    try:
        os.link(source, target)
    except OSError:  # another file system
        shutil.copy2(source, target)


def _digest(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:12]


def _finish(
    command: list[str], folder: Path, environment: dict[str, str], seconds: float
) -> tuple[int | None, str]:
    """Exit code (None after the limit, when all its processes are ended) and output of a command."""
    process = subprocess.Popen(
        command,
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        start_new_session=True,
    )
    try:
        output, _ = process.communicate(timeout=seconds)
        return process.returncode, output
    except subprocess.TimeoutExpired:
        return None, ""
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()


def _fill(journal: Journal, work: dict[str, Callable[[], dict[str, Any]]], jobs: int) -> None:
    """Add the rows that a journal lacks, as they are computed."""
    pool = ThreadPoolExecutor(jobs)
    try:
        rows = {pool.submit(job): key for key, job in work.items() if key not in journal}
        for count, row in enumerate(as_completed(rows), 1):
            journal.put(rows[row], row.result())
            print(f"{count}/{len(rows)} {rows[row].rpartition(' ')[0]} {_told(row.result())}", flush=True)
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
        print(*(f"{change.title} (line {change.line})" for change in changes if change.up), sep="\n")
        print(f"{len(changes) // 2} constants")
        return
    about = {"campaign": "constants", "seconds": args.seconds}
    judges: Callable[[str], list[str]] = partial(project.importing, count=args.near)
    if args.near is None or args.most is not None:
        modules = sorted({change.module for change in changes})
        near = None if args.near is None else {test for module in modules for test in judges(module)}
        judges = _calling(project, args, about, near)
    journal = Journal(args.report, about)
    work: dict[str, Callable[[], dict[str, Any]]] = {}
    for change in changes:
        tests = judges(change.module)
        work[project.key(change, tests)] = partial(project.judge, change, tests)
    _fill(journal, work, args.jobs)
    print(table([journal.rows[key] for key in work]))


def _calling(
    project: Project, args: argparse.Namespace, about: dict[str, Any], near: set[str] | None
) -> Callable[[str], list[str]]:
    """The tests that execute a module, after every test file, or each of those near, was run once."""
    calls = Journal(args.report.with_suffix(".tests.jsonl"), about)
    names = _digest(*project.modules)  # when modules move, tests call others
    texts = {test: text for test, text in project.tests.items() if near is None or test in near}
    keys = {test: f"{test} {_digest(text, names)}" for test, text in texts.items()}
    _fill(calls, {key: partial(project.explore, test) for test, key in keys.items()}, args.jobs)
    known = {test: calls.rows[key] for test, key in keys.items()}
    if failing := [test for test, row in known.items() if not row["passed"]]:
        print("left out, they fail without any change:", *failing)
    return partial(project.executing, known=known, most=args.most)


if __name__ == "__main__":
    main()
