"""Find the constants of a module, and import a module with one of them multiplied.

Copied as ``sitecustomize.py`` into a folder on ``PYTHONPATH``, it acts in a process that calls :func:`start`, and in every
process that this one's tests start, as defined by the environment variable ``CONSTANTS_RUN`` (JSON):

- ``{"module", "name", "up", "marks"}``: when the module is imported, every number of the constant is multiplied in
  its syntax tree, so that ``from module import NAME``, default arguments and compiled functions use the new value.
  A file in the folder ``marks`` records whether the import succeeded (``loaded``) or failed (``crashed``).
- ``{"source", "marks", "quick", "seconds"}``: a file in ``marks`` lists, for each test, the files below ``source`` of which a
  function was called, with the duration and the outcome of the test, and the modules that were imported (JSON; as a plugin of
  pytest, ``-p sitecustomize``). Calls during the set-up of a test may come from shared fixtures and count for all tests of
  its file. A test fails that takes more CPU time than ``quick``; after ``seconds`` of CPU time no other test starts.

Uses only the standard library and no other file of this folder.
"""

from __future__ import annotations

import ast
import atexit
import json
import os
import re
import signal
import sys
import tempfile
import threading
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import partial
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.util import spec_from_file_location
from types import FrameType, ModuleType
from typing import Any

__all__ = ["VARIABLE", "Finder", "find_constants", "multiplied", "start", "with_constant_multiplied"]

VARIABLE = "CONSTANTS_RUN"

#: Calls that make a number or an array of numbers: their result is multiplied, not their arguments.
_CONVERSIONS = re.compile(
    r"float|int|math\.\w+|np\.(array|asarray|deg2rad|radians|sqrt|exp|log|u?int\d+|float\d+|linalg\.norm)"
)
#: Numbers of a file format are labels.
_LABEL = re.compile(r"(FORMAT|VERSION)$")


def find_constants(tree: ast.Module) -> dict[str, int]:
    """Names of the constants of a module, with their lines.

    Parameters
    ----------
    tree
        The module.

    Returns
    -------
    dict
        Line of the (first) assignment by name. The rule is in :mod:`benchmarks.constants`.
    """
    found: dict[str, int] = {}
    for statement in tree.body:
        for name, value in _assigned(statement):
            if any(_numbers(value)):
                found.setdefault(name, statement.lineno)
    return found


def with_constant_multiplied(tree: ast.Module, name: str) -> ast.Module:
    """The module with ``__multiplied__(...)`` around every number of one constant; changes ``tree``."""
    chosen = {
        id(node)
        for statement in tree.body
        for title, value in _assigned(statement)
        if title == name
        for node in _numbers(value)
    }
    _Wrapper(chosen).visit(tree)
    return ast.fix_missing_locations(tree)


def multiplied(value: Any, up: bool) -> Any:
    """A number or NumPy array times 1.25 (``up``) or 0.8; integers are rounded away from the old value.

    Raises
    ------
    OverflowError
        If the type of an array cannot hold the new value.
    """
    if isinstance(value, int):
        size = -(-abs(value) * 5 // 4) if up else abs(value) * 4 // 5
        return size if value >= 0 else -size
    if isinstance(value, float):
        return value * (1.25 if up else 0.8)
    if value.dtype.kind == "f":
        return (value * (1.25 if up else 0.8)).astype(value.dtype)
    if not value.shape:
        return type(value)(multiplied(int(value), up))
    new = value.copy()
    new.flat = [value.dtype.type(multiplied(one, up)) for one in value.ravel().tolist()]
    return new


def _assigned(statement: ast.stmt) -> Iterator[tuple[str, ast.expr]]:
    """Names and values of an assignment, without labels and special names."""
    if isinstance(statement, ast.AnnAssign) and statement.value is not None:
        pairs: list[tuple[ast.expr, ast.expr]] = [(statement.target, statement.value)]
    elif isinstance(statement, ast.Assign):
        pairs = [(target, statement.value) for target in statement.targets]
    else:
        return
    for target, value in pairs:
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple) and not _are_labels(value.elts):
            singles = list(zip(target.elts, value.elts, strict=False))
        else:
            singles = [(target, value)]
        for one, expression in singles:
            if isinstance(one, ast.Name) and not one.id.startswith("__") and not _LABEL.search(one.id):
                yield one.id, expression


def _are_labels(values: list[ast.expr]) -> bool:
    """Whether names are an enumeration: three or more consecutive integers, or 0 and 1, or 1 and 2."""
    integers = sorted(
        node.value for node in values if isinstance(node, ast.Constant) and type(node.value) is int
    )
    if len(integers) < max(len(values), 2) or integers != list(
        range(integers[0], integers[0] + len(integers))
    ):
        return False
    return len(integers) > 2 or integers[0] in (0, 1)


def _numbers(node: ast.expr) -> Iterator[ast.expr]:
    """The largest parts of an expression that are numbers or arrays of numbers, and not zero."""
    parts: list[ast.expr] = []
    if _is_number(node):
        if any(isinstance(one, ast.Constant) and one.value for one in ast.walk(node)):
            yield node
    elif isinstance(node, ast.Tuple | ast.List | ast.Set):
        parts = node.elts
    elif isinstance(node, ast.Dict):
        parts = node.values
    elif isinstance(node, ast.Starred):
        parts = [node.value]
    elif isinstance(node, ast.ListComp | ast.SetComp | ast.GeneratorExp | ast.DictComp):
        parts = [generator.iter for generator in node.generators]
    elif isinstance(node, ast.Call):
        title = ast.unparse(node.func)
        if title != "range" and (_CONVERSIONS.fullmatch(title) or not title.startswith("np.")):
            parts = [*node.args, *(keyword.value for keyword in node.keywords)]
    for part in parts:
        yield from _numbers(part)


def _is_number(node: ast.expr) -> bool:
    """Whether an expression is a number, or an array of numbers, without any other name."""
    if isinstance(node, ast.Constant):
        return type(node.value) in (int, float)
    if isinstance(node, ast.UnaryOp):
        return not isinstance(node.op, ast.Not) and _is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return _is_number(node.left) and _is_number(node.right)
    if isinstance(node, ast.Call) and node.args and _CONVERSIONS.fullmatch(ast.unparse(node.func)):
        types = [*node.args[1:], *(keyword.value for keyword in node.keywords)]
        return _is_data(node.args[0]) and all(_is_type(one) or _is_data(one) for one in types)
    return ast.unparse(node) in ("math.pi", "np.pi")


def _is_data(node: ast.expr) -> bool:
    return all(map(_is_data, node.elts)) if isinstance(node, ast.Tuple | ast.List) else _is_number(node)


def _is_type(node: ast.expr) -> bool:
    return re.fullmatch(r"float|int|np\.(u?int|float)\d+", ast.unparse(node)) is not None


class _Wrapper(ast.NodeTransformer):
    """Puts a call around chosen nodes."""

    def __init__(self, chosen: set[int]) -> None:
        self._chosen = chosen

    def visit(self, node: ast.AST) -> ast.AST:
        if id(node) in self._chosen and isinstance(node, ast.expr):
            return ast.Call(func=ast.Name("__multiplied__", ast.Load()), args=[node], keywords=[])
        return self.generic_visit(node)


class _Loader(SourceFileLoader):
    """Reads one module from its source with a constant multiplied; writes no bytecode."""

    def __init__(self, fullname: str, path: str, run: dict[str, Any]) -> None:
        super().__init__(fullname, path)
        self._run = run

    def get_code(self, fullname: str) -> Any:
        change = self._run.get("change") or partial(with_constant_multiplied, name=self._run["name"])
        tree = change(ast.parse(self.get_data(self.path)))
        return compile(tree, self.path, "exec", dont_inherit=True)

    def exec_module(self, module: ModuleType) -> None:
        vars(module)["__multiplied__"] = partial(multiplied, up=self._run.get("up", False))
        try:
            super().exec_module(module)
        except ImportError:  # a library is missing, with or without the change
            raise
        except BaseException:
            _mark(self._run["marks"], "crashed")
            raise
        _mark(self._run["marks"], "loaded")


class Finder:
    """Finds the one module; ``change`` in place of ``name`` and ``up`` is any change of its syntax tree."""

    def __init__(self, run: dict[str, Any]) -> None:
        self._run = run

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        spec = PathFinder.find_spec(fullname, path) if fullname == self._run["module"] else None
        if spec is None or spec.origin is None:
            return None
        loader = _Loader(fullname, spec.origin, self._run)
        folders = spec.submodule_search_locations
        return spec_from_file_location(
            fullname, spec.origin, loader=loader, submodule_search_locations=folders
        )


def _mark(folder: str, text: str) -> None:
    """A new file in a folder that every process of the run writes to; whole, also if the process is killed."""
    with tempfile.NamedTemporaryFile("w", dir=folder, delete=False, encoding="utf-8") as stream:
        stream.write(text)
    os.rename(stream.name, stream.name + ".mark")


class _Record:
    """What each test called, how long it took and how it ended; "" stands for all tests of this process."""

    def __init__(self) -> None:
        # A process that a test started has its name in this variable.
        self.now = os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" ")[0]
        self.calls: dict[str, set[str]] = defaultdict(set)
        self.seconds: dict[str, float] = {}
        self.failed: set[str] = set()
        self.quick = self.end = float("inf")  # CPU time of a test, and at which the last one starts
        self.started = 0.0


_RECORD = _Record()


def _late(*_: Any) -> None:
    raise TimeoutError("the test takes longer")


def pytest_runtest_logstart(nodeid: str) -> None:
    """During the set-up of a test, calls count for its file."""
    _RECORD.now = nodeid.partition("::")[0]
    _RECORD.started = sum(os.times()[:4])
    if _RECORD.quick < float("inf"):
        signal.setitimer(signal.ITIMER_PROF, _RECORD.quick)


def pytest_runtest_call(item: Any) -> None:
    """From now on, calls count for the test."""
    _RECORD.now = item.nodeid


def pytest_runtest_teardown(item: Any) -> None:
    """A test also takes the time of the processes that it starts; after all tests' time no other is started."""
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    now = sum(os.times()[:4])
    if now - _RECORD.started > _RECORD.quick:
        _RECORD.failed.add(item.nodeid)
    if now > _RECORD.end:
        item.session.shouldstop = "the time is over"


def pytest_runtest_logreport(report: Any) -> None:
    """Time and outcome of a phase of a test."""
    _RECORD.seconds[report.nodeid] = _RECORD.seconds.get(report.nodeid, 0.0) + report.duration
    if report.outcome != "passed":
        _RECORD.failed.add(report.nodeid)


def _record_calls(run: dict[str, Any]) -> Callable[[], None]:
    """Record which files below the source had a function called, by test; returns what writes the record."""
    source = run["source"]

    def on_event(frame: FrameType, event: str, _: Any) -> None:
        if event == "call":
            code = frame.f_code
            file, called = code.co_filename, _RECORD.calls[_RECORD.now]
            # Bodies of modules and classes run at import; they lack the flag of functions.
            if file not in called and code.co_flags & 1 and file.startswith(source):
                called.add(file)

    def finish() -> None:
        sys.setprofile(None)
        calls = {test: sorted(files) for test, files in _RECORD.calls.items()}
        files = (getattr(module, "__file__", None) or "" for module in [*sys.modules.values()])
        found = {
            "calls": calls,
            "seconds": _RECORD.seconds,
            "failed": sorted(_RECORD.failed),
            "imported": sorted(file for file in files if file.startswith(source)),
        }
        _mark(run["marks"], json.dumps(found))

    threading.setprofile(on_event)
    sys.setprofile(on_event)
    return finish


def start(run: dict[str, Any]) -> Callable[[], None]:
    """Follow an instruction in this process; returns what to call at its end."""
    if "source" in run:
        return _record_calls(run)
    if "module" in run:
        sys.meta_path.insert(0, Finder(run))
    return lambda: None


def pytest_configure() -> None:
    """Limits hold for the process that runs the tests, none of those that they start."""
    run = json.loads(os.environ.get(VARIABLE, "{}"))
    if "source" in run:
        _RECORD.quick, _RECORD.end = run["quick"], sum(os.times()[:4]) + run["seconds"]
        signal.signal(signal.SIGPROF, _late)


if __name__ == "sitecustomize":
    atexit.register(start(json.loads(os.environ.get(VARIABLE, "{}"))))
