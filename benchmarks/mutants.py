"""Mutation test of the code: which small mistakes are not noticed by any test.

    python -m benchmarks.mutants --packages database recognition --sample 80 --report mutants.jsonl
                                      prints the score of each package, and the mutants that survived
    python -m benchmarks.mutants --packages sensing.beam --list

First the test files below ``tests/PACKAGE`` run once under ``coverage``, and the report records which test executes which
line of the package. Then mutants (:mod:`benchmarks._mutations`) are drawn at random and created one at a time, in a fork of a
process that has the libraries loaded, and the tests that execute the line run, fastest first, until one fails:

- *killed*: a test fails, the module cannot be imported, or the tests take ten times their CPU time;
- *survived*: no test fails. Tests that would exceed ``--seconds`` together are left out, the slowest first,
  and so are those of other packages, those marked slow and those that need real data: the score is a lower bound;
- *uncovered*: no test executes the line in its own process.

The score is the fraction that was killed. Changes that no correct test can notice are not drawn; how many, and by which rule of
:mod:`benchmarks._mutations`, is printed. Other survivors may still be equivalent to the original code. A larger ``--sample`` with the
same seed contains the smaller one, and continues it.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import os
import random
import re
import resource
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from . import _mutant
from ._journal import Journal
from ._mutations import Mutation, mutate, mutations
from .house import ROOT, Module, imported_modules, read_modules

__all__ = ["counts", "judge", "main", "map_tests", "score"]

#: What tests import anyway; loaded once, not once for each mistake.
_LIBRARIES = (
    "numpy",
    "scipy.optimize",
    "scipy.ndimage",
    "scipy.spatial",
    "scipy.sparse.linalg",
    "cv2",
    "numba",
)
_LIBRARIES += ("pydantic", "yaml", "rich", "jaxtyping", "shapely", "trimesh", "hypothesis", "pytest")
_LIBRARIES += ("pyarrow.parquet", "sqlalchemy", "skimage.measure", "sklearn.ensemble", "matplotlib.pyplot")
_OPTIONS = ["-q", "-p", "no:cacheprovider", "-m", "not slow and not data", "--no-header"]
#: Tests that become slower than this factor notice a mistake.
_SLOWER = 10.0
_START_S = 30.0  #: for imports and for kernels that are not in the cache


def _forked(work: Callable[[], int], folder: Path, seconds: float) -> tuple[int | None, str]:
    """Exit code (None when the time of the processor was over) and output of work in a fork of this process."""
    output = folder / "output"
    child = os.fork()
    if not child:
        code = 70
        try:
            with output.open("w") as stream:
                for number in (1, 2):
                    os.dup2(stream.fileno(), number)
            os.setsid()
            resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds) + 1))
            os.environ.update(CI="1", HYPOTHESIS_STORAGE_DIRECTORY=str(folder), TMPDIR=str(folder))
            for name in [one for one in sys.modules if one.partition(".")[0] in ("visuohaptic", "tests")]:
                del sys.modules[name]
            code = work()
        finally:
            sys.stdout.flush()
            os._exit(code)
    # Tests that wait for each other use no CPU time.
    limit = time.monotonic() + 10.0 * seconds
    while not (done := os.waitpid(child, os.WNOHANG))[0]:
        if time.monotonic() > limit:
            os.killpg(child, signal.SIGKILL)
        time.sleep(0.02)
    code = os.waitstatus_to_exitcode(done[1])
    return (None if code in (-signal.SIGXCPU, -signal.SIGKILL) else code), output.read_text(errors="replace")


class _Watch:
    """A plugin of pytest that tells coverage which test is running."""

    def __init__(self, coverage: Any) -> None:
        self.coverage = coverage
        self.tests: dict[str, float] = {}

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.when == "call" and report.passed:
            self.tests[report.nodeid] = time.process_time() - self.started

    def pytest_runtest_setup(self, item: Any) -> None:
        self.coverage.switch_context("*")  # fixtures count for every test of the file

    def pytest_runtest_call(self, item: Any) -> None:
        self.started = time.process_time()
        self.coverage.switch_context(item.nodeid)

    def pytest_runtest_teardown(self, item: Any) -> None:
        self.coverage.switch_context("*")


def map_tests(test: str, source: Path, root: Path = ROOT, seconds: float = 600.0) -> dict[str, Any]:
    """Which tests of a file execute which lines below a folder.

    Returns
    -------
    dict
        ``tests``: those that pass, with their time of the processor [s]; ``lines``: by file and line their numbers, -1
        for all of them.
    """

    def work() -> int:
        import coverage
        import pytest

        cover = coverage.Coverage(data_file=None, config_file=False, source=[str(source)])
        watch = _Watch(cover)
        cover.start()
        pytest.main([*_OPTIONS, str(root / test)], plugins=[watch])
        cover.stop()
        names = {name: number for number, name in enumerate(watch.tests)} | {"*": -1}
        data = cover.get_data()
        lines = {
            Path(file).relative_to(root).as_posix(): {
                line: sorted({names[one] for one in contexts if one in names})
                for line, contexts in data.contexts_by_lineno(file).items()
                if any(one in names for one in contexts)
            }
            for file in data.measured_files()
        }
        (place / "map").write_text(json.dumps({"tests": watch.tests, "lines": lines}))
        return 0

    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        code, output = _forked(work, place, seconds)
        if code == 0:
            return json.loads((place / "map").read_text())
    return {"tests": {}, "lines": {}, "trouble": output[-500:] or "longer than its time"}


def _tests_of(mutation: Mutation, file: str, maps: list[dict[str, Any]], seconds: float) -> dict[str, float]:
    """Tests that execute a mistake, the quickest first; of one at the level of a module, those that use the module."""
    found: dict[str, float] = {}
    for row in maps:
        lines = row["lines"].get(file, {})
        # A statement of several lines is executed where its parts are.
        own = [str(line) for line in range(mutation.statement, mutation.line + 1)]
        used = [lines[line] for line in (own if mutation.function else lines) if line in lines]
        numbers = {number for one in used for number in one}
        tests = list(row["tests"].items())
        found |= dict(tests) if -1 in numbers else dict(tests[number] for number in sorted(numbers))
    chosen, spent = {}, 0.0
    for name, duration in sorted(found.items(), key=lambda item: item[1]):
        if not chosen or spent + duration <= seconds:
            chosen[name], spent = duration, spent + duration
    return chosen


def judge(module: Module, number: int, tests: dict[str, float], root: Path = ROOT) -> tuple[str, str]:
    """Result of a mistake, and the test that noticed it.

    Parameters
    ----------
    module
        The module.
    number
        Place of the mistake in :func:`mutations`.
    tests
        Tests that execute it, with their time of the processor [s].
    root
        Folder of the project.
    """
    if not tests:
        return "uncovered", ""

    def work() -> int:
        import pytest

        run = {"module": module.name, "change": partial(mutate, number=number), "marks": str(marks)}
        sys.meta_path.insert(0, _mutant.Finder(run))
        return int(pytest.main([*_OPTIONS, "-x", "--tb=line", *(str(root / name) for name in tests)]))

    with tempfile.TemporaryDirectory() as folder:
        marks = Path(folder, "marks")
        marks.mkdir()
        code, output = _forked(work, Path(folder), _START_S + _SLOWER * sum(tests.values()))
        left = [path.read_text() for path in marks.iterdir()]
    if code is None:
        return "killed", "took too long"
    if "crashed" in left:
        return "killed", "the module is not imported"
    if "loaded" not in left:
        return "undecided", output[-300:]
    by = next((line for line in output.splitlines() if line.startswith(("FAILED", "ERROR"))), f"code {code}")
    return ("survived", "") if code == 0 else ("killed", by[:200])


def _own(package: str, modules: dict[str, Module]) -> list[Module]:
    """Modules of a package."""
    return [one for name, one in modules.items() if f"{name}.".startswith(f"visuohaptic.{package}.")]


def _sample(packages: list[str], modules: dict[str, Module], count: int, seed: int) -> Iterator[Any]:
    """Random mistakes of the modules of each package, without replacement."""
    for package in packages:
        own = _own(package, modules)
        places = [(one, number, found) for one in own for number, found in enumerate(mutations(one.tree))]
        random.Random(f"{seed} {package}").shuffle(places)
        drawn = [place for place in places if not place[2].rule]
        rules = Counter(found.rule for *_, found in places if found.rule)
        told = ", ".join(f"{rules[rule]} {rule}" for rule in sorted(rules))
        print(f"{package}: {len(places)} changes, {rules.total()} of them no mistakes ({told})", flush=True)
        for module, number, found in drawn[:count]:
            yield package, module, number, found


def counts(rows: dict[str, dict[str, Any]]) -> dict[str, Counter[str]]:
    """Results by package, and of all."""
    found: dict[str, Counter[str]] = {}
    for name in [*dict.fromkeys(row["package"] for row in rows.values()), "all"]:
        found[name] = Counter(row["result"] for row in rows.values() if name in ("all", row["package"]))
    return found


def score(rows: dict[str, dict[str, Any]]) -> str:
    """Figures by package, and what survived."""
    names = ("killed", "survived", "uncovered", "undecided")
    lines = [f"{'package':16}{'mistakes':>10}" + "".join(f"{name:>10}" for name in names) + f"{'score':>8}"]
    for package, count in counts(rows).items():
        decided = count.total() - count["undecided"]
        lines.append(
            f"{package:16}{count.total():>10}"
            + "".join(f"{count[name]:>10}" for name in names)
            + f"{count['killed'] / max(decided, 1):>8.2f}"
        )
    for result in names[1:]:
        lines += [
            f"{result}: {key.rpartition(' ')[0]}" for key, row in rows.items() if row["result"] == result
        ]
    return "\n".join(lines)


def _digest(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:12]


def _maps(
    package: str, modules: dict[str, Module], journal: Journal, named: set[str] | None = None
) -> list[dict[str, Any]]:
    """Rows of all test files of a package, or of those that contain one of the names."""
    folder = package.replace(".", "/")
    own = _digest(*(one.text for one in _own(package, modules)))
    found = []
    for path in sorted((ROOT / "tests" / folder).rglob("test_*.py")):
        if named is not None and named.isdisjoint(re.findall(r"\w+", path.read_text(encoding="utf-8"))):
            continue
        test = path.relative_to(ROOT).as_posix()
        key = f"{test} {_digest(path.read_text(encoding='utf-8'), own)}"
        if key not in journal:
            journal.put(key, map_tests(test, ROOT / "src/visuohaptic" / folder))
            row = journal.rows[key]
            print(f"{test}: {len(row['tests'])} tests, {sum(row['tests'].values()):.1f} s", flush=True)
        found.append(journal.rows[key])
    return found


def _names(module: Module, modules: dict[str, Module]) -> set[str]:
    """Names of a module and its functions and classes, and of those of its folder that import it.

    What is private to a folder is tested through its public functions.
    """
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    users = [
        one
        for one in modules.values()
        if one.path.parent == module.path.parent and module.name in imported_modules(one, modules)
    ]
    return {
        name
        for one in (module, *users)
        for name in (one.path.stem, *(part.name for part in one.tree.body if isinstance(part, kinds)))
    }


def main() -> None:
    """Run, or continue, a sample."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--packages", nargs="+", required=True)
    parser.add_argument("--sample", type=int, default=20, help="mistakes per package")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=30.0, metavar="S", help="of tests for one mistake")
    near = "only test files that name the mistake's module, what it defines, or what uses it: cheaper, and a lower score"
    parser.add_argument("--near", action="store_true", help=near)
    parser.add_argument("--report", type=Path, default=Path("results/mutants.jsonl"))
    parser.add_argument("--list", action="store_true", help="only say which mistakes there are")
    args = parser.parse_args()
    modules = read_modules()
    if args.list:
        for _, module, _, found in _sample(args.packages, modules, 10**9, args.seed):
            print(f"{module.name}:{found.line} {found.title}")
        return
    for name in _LIBRARIES:
        import_module(name)
    journal = Journal(args.report, {"campaign": "mutants", "seed": args.seed})
    calls = Journal(args.report.with_suffix(".tests.jsonl"), {"campaign": "mutants"})
    sample = list(_sample(args.packages, modules, args.sample, args.seed))
    maps = {}
    for name in args.packages:
        named = {one for package, module, *_ in sample if package == name for one in _names(module, modules)}
        maps[name] = _maps(name, modules, calls, named if args.near else None)
    rows = {}
    for package, module, number, found in sample:
        tests = _tests_of(found, module.path.relative_to(ROOT).as_posix(), maps[package], args.seconds)
        title = f"{module.name}:{found.line} {found.title}"
        key = f"{title} {_digest(module.text, str(number), *tests)}"
        if key not in journal:
            result, by = judge(module, number, tests)
            label = f"{package} (near)" if args.near else package
            journal.put(key, {"package": label, "result": result, "by": by, "tests": len(tests)})
            print(f"{result:10}{title}", flush=True)
        rows[key] = journal.rows[key]
    print(score(rows))


if __name__ == "__main__":
    main()
