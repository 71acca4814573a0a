"""Invalid arguments of public functions: crashes, hangs and wrong results.

Walks ``__all__`` of all packages, builds arguments of every function that takes an array from the shapes in the annotations,
and replaces one array after another by NaN, infinity, huge numbers, empty arrays, other types, byte orders, strides and
shapes. Of these functions, and of all functions and classes of ``visuohaptic`` itself, each other argument is
replaced by values of other types. A function may return a result or raise one of the library's errors; any other
exception, a crash, a hang, and a result that changes with the memory layout of the same numbers are faults. Functions whose
other arguments cannot be built here are listed; of the names of ``visuohaptic`` these are ``None``.

    python -m benchmarks.hostile_arrays --count 40     prints functions, cases, and faults by kind
    python -m benchmarks.hostile_arrays --names visuohaptic.core.so3_exp --verbose    and every case of one function
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import json
import math
import os
import pkgutil
import re
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ._journal import Journal

#: A function whose cases together take longer hangs [s]; includes the compilation of kernels.
LIMIT_S = 120.0
_ARRAY = re.compile(r"(Float|Float32|Int|Int8|UInt8|Bool)\[np\.ndarray, ['\"]([^'\"]*)['\"]\]")
_SIZES = {"rows": 24, "columns": 32, "height": 24, "width": 32, "h": 24, "w": 32, "f": 20, "q": 20}
_SIZES |= {"R": 24, "C": 32, "x": 8, "y": 9, "z": 10, "corners": 3, "s": 3, "*colour": 0, "*colours": 0}

Rng = np.random.Generator
#: Keeps any exception with its call.
_RUNNER = ThreadPoolExecutor(1)


def public_functions() -> dict[str, Callable[..., Any]]:
    """Every function of a package's ``__all__`` that takes an array, and what the library offers first, by shortest name."""
    import visuohaptic

    found: dict[tuple[str, str], tuple[str, Any]] = {}
    for info in pkgutil.walk_packages(visuohaptic.__path__, "visuohaptic."):
        if not info.ispkg or "._" in info.name:
            continue
        package = importlib.import_module(info.name)
        for name in getattr(package, "__all__", ()):
            thing = getattr(package, name)
            if inspect.isfunction(thing) and _arrays(thing):
                whole = f"{info.name}.{name}"
                key = (inspect.unwrap(thing).__module__, name)
                if key not in found or len(whole) < len(found[key][0]):
                    found[key] = (whole, thing)
    for name in getattr(visuohaptic, "__all__", ()):
        thing = getattr(visuohaptic, name)
        makes = inspect.isclass(thing) and not issubclass(thing, Exception)
        usable = inspect.isfunction(thing) or (makes and not getattr(thing, "_is_protocol", False))
        if usable and inspect.signature(thing).parameters:
            found[(inspect.unwrap(thing).__module__, name)] = (f"visuohaptic.{name}", thing)
    return dict(sorted(found.values()))


def _arrays(thing: Callable[..., Any]) -> dict[str, re.Match[str]]:
    """Parameters that are arrays, or may be."""
    matches = {
        name: _ARRAY.match(str(one.annotation)) for name, one in inspect.signature(thing).parameters.items()
    }
    return {name: match for name, match in matches.items() if match}


def _array(kind: str, shape: str, rng: Rng) -> np.ndarray:
    sizes: list[int] = []
    for word in shape.split():
        if word.isdigit():
            sizes.append(int(word))
        elif word.startswith("*"):
            sizes += [_SIZES[word]] if _SIZES.get(word) else []
        else:
            sizes.append(_SIZES.get(word, 12))
    if kind == "UInt8":
        return rng.integers(0, 256, sizes, dtype=np.uint8)
    if kind == "Bool":
        return rng.random(sizes) < 0.5
    if kind in ("Int", "Int8"):
        if len(sizes) == 2 and sizes[1] in (3, 4):  # faces: corners that differ
            first = np.arange(sizes[0]) % 9
            return np.stack([(first + k) % 12 for k in range(sizes[1])], axis=1)
        return rng.integers(0, 3, sizes, dtype=np.int8 if kind == "Int8" else np.int64)
    if len(sizes) >= 2 and sizes[-1] == sizes[-2]:  # rotations, covariances, homographies
        return np.broadcast_to(np.eye(sizes[-1]), sizes) * (1.0 if sizes[-1] == 3 else 1e-4)
    values = rng.uniform(0.1, 1.0, sizes)
    if len(sizes) == 1 and not shape.isdigit():
        values = np.sort(values)
    return values.astype(np.float32) if kind == "Float32" else values


@cache
def _things() -> dict[str, Callable[[], Any]]:
    """Arguments of the library's own types, by the name of the type."""
    import visuohaptic.core.camera as camera
    from visuohaptic import deformation, grasping, io
    from visuohaptic.deformation.shapes import load_object

    cells = np.zeros((40, 50), np.int8)
    cells[0] = cells[-1] = cells[:, 0] = cells[:, -1] = 100

    def cup() -> Any:
        return load_object("cup", around=32)

    return {
        "float": lambda: 0.3,
        "int": lambda: 3,
        "bool": lambda: True,
        "str": lambda: "x",
        "object": lambda: "x",
        "np.random.Generator": lambda: np.random.default_rng(0),
        "Sequence[float]": lambda: [0.1, 0.2],
        "tuple[float, float]": lambda: (0.1, 0.2),
        "tuple[float, float, float]": lambda: (0.1, 0.2, 0.3),
        "tuple[int, int]": lambda: (4, 5),
        "Pose": lambda: camera.Pose(np.eye(3), np.array([0.0, 0.0, 1.0])),
        "Camera": lambda: camera.Camera.simple(32, 24, 30.0),
        "OccupancyMap": lambda: io.OccupancyMap(cells, 0.05, (0.0, 0.0, 0.0)),
        "ShellObject": cup,
        "ShellMesh": lambda: cup().mesh,
        "StiffnessMap": lambda: deformation.object_map(cup()),
        "GripperModel": lambda: grasping.GripperModel(),
        "Load": lambda: grasping.Load(0.5, (0.0, 0.0, 0.05)),
        "ScoreParameters": lambda: grasping.ScoreParameters(),
    }


def _arguments(name: str, thing: Callable[..., Any], seed: int) -> dict[str, Any] | None:
    """Sound arguments; None where one of them is of a type that is not known here.

    Of the names that the library offers first, such an argument is None instead.
    """
    rng = np.random.default_rng(seed)
    arrays = _arrays(thing)
    known = _things()
    chosen: dict[str, Any] = {}
    for key, parameter in inspect.signature(thing).parameters.items():
        if key in arrays:
            chosen[key] = _array(arrays[key][1], arrays[key][2], rng)
        elif parameter.default is not inspect.Parameter.empty:
            continue
        elif str(parameter.annotation) == "Path | str":
            chosen[key] = Path(tempfile.gettempdir()) / f"{name}.out"
        elif (text := str(parameter.annotation)) in known:
            try:
                chosen[key] = known[text]()
            except (AttributeError, TypeError, ValueError):
                return None
        elif name.count(".") > 1:
            return None
        elif parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            chosen[key] = None
    return chosen


def _strided(array: np.ndarray) -> np.ndarray:
    wide = np.repeat(array, 2, axis=-1)
    return wide[..., ::2]


def _read_only(array: np.ndarray) -> np.ndarray:
    copy = array.copy()
    copy.flags.writeable = False
    return copy


#: The same numbers in another memory layout: the result has to be the same.
SAME: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "big endian": lambda a: a.astype(a.dtype.newbyteorder(">")),
    "read only": _read_only,
    "strided": _strided,
    "by columns": np.asfortranarray,
}


def _filled(value: float, where: slice | None = None) -> Callable[[np.ndarray], np.ndarray | None]:
    def fill(array: np.ndarray) -> np.ndarray | None:
        if array.dtype.kind != "f" or not array.size:
            return None
        copy = array.copy()
        with np.errstate(over="ignore"):
            copy.reshape(-1)[where or slice(None)] = value
        return copy

    return fill


OTHER: dict[str, Callable[[np.ndarray], Any]] = {
    "NaN": _filled(np.nan),
    "one NaN": _filled(np.nan, slice(1)),
    "infinite": _filled(np.inf),
    "huge": _filled(1e300),
    "zero": _filled(0.0),
    "empty": lambda a: a[:0],
    "one row": lambda a: a[:1],
    "no last axis": lambda a: a[..., :0],
    "wider": lambda a: np.concatenate([a, a], axis=-1),
    "flat": lambda a: a.reshape(-1),
    "an axis more": lambda a: a[None],
    "one number": lambda a: np.array(a.reshape(-1)[0]),
    "float32": lambda a: a.astype(np.float32),
    "integers": lambda a: a.astype(np.int64),
    "negative": lambda a: -a if a.dtype.kind in "fi" else None,
    "complex": lambda a: a + 1j if a.dtype.kind == "f" else None,
    "texts": lambda a: a.astype(str),
    "objects": lambda a: a.astype(object),
}


#: In place of an argument that is no array.
VALUES: dict[str, Any] = {
    "None": None, "true": True, "a negative number": -1.5, "no number": math.nan, "a text": "x", "bytes": b"x", "a list": [],
    "a mapping": {}, "an object": object(), "an empty array": np.zeros(0), "an array of NaN": np.full((2, 3), np.nan),
}  # fmt: skip


def _close(first: Any, second: Any) -> bool:
    """Whether two results are equal; true if they cannot be compared."""
    if isinstance(first, tuple | list):
        return len(first) == len(second) and all(_close(a, b) for a, b in zip(first, second, strict=True))
    if isinstance(first, np.ndarray | float | int) and not isinstance(first, bool):
        try:
            return bool(
                np.allclose(np.asarray(first), np.asarray(second), rtol=1e-6, atol=1e-9, equal_nan=True)
            )
        except (TypeError, ValueError):
            return first.dtype.kind not in "fi" if isinstance(first, np.ndarray) else False
    return True


def cases(name: str, thing: Callable[..., Any], seed: int) -> Iterator[tuple[str, str, str]]:
    """Each case of one function with its outcome and, of a fault, what was raised."""
    from visuohaptic.core import VisuohapticError

    def call(arguments: dict[str, Any]) -> tuple[str, str, Any]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            future = _RUNNER.submit(thing, **arguments)
            error = future.exception()
        if error is None:
            return "result", "", future.result()
        if isinstance(error, VisuohapticError) and "\n" not in str(error):
            return "refused", "", None
        return "foreign", f"{type(error).__name__}: {error}"[:160], None

    sound = _arguments(name, thing, seed)
    if sound is None:
        yield "sound", "not tried", ""
        return
    outcome, text, expected = call(sound)
    yield "sound", outcome, text
    for key in _arrays(thing):
        for title, change in (SAME | OTHER).items():
            arguments = _arguments(name, thing, seed)
            assert arguments is not None
            changed = change(arguments[key])
            if changed is None:
                continue
            found, text, result = call(arguments | {key: changed})
            if title in SAME and found == "result" == outcome and not _close(expected, result):
                found, text = "wrong", "another result for the same numbers"
            elif title == "read only" and found == "refused":
                pass  # would be modified in place
            elif title in SAME and found != outcome:
                found, text = "wrong", f"{found}, expected {outcome}: {text}"
            yield f"{key}: {title}", found, text
    for key, parameter in inspect.signature(thing).parameters.items():
        if key in _arrays(thing) or parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        for title, value in VALUES.items():
            arguments = _arguments(name, thing, seed)
            assert arguments is not None
            found, text, _ = call(arguments | {key: value})
            yield f"{key}: {title}", found, text


def _work(names: list[str], seed: int) -> None:
    """Print one line before and after each function; a crash takes this process with it."""
    lines = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # separate the output of functions from ours
    os.chdir(tempfile.mkdtemp())  # some write files
    functions = public_functions()
    for name in names:
        print(json.dumps([name]), file=lines, flush=True)
        started = time.process_time()
        rows = list(cases(name, functions[name], seed))
        print(json.dumps([name, rows, time.process_time() - started]), file=lines, flush=True)


def campaign(names: list[str], seed: int, journal: Journal) -> None:
    """Rows of all functions into the journal; a function that kills its process is a row as well."""
    left = [name for name in names if name not in journal]
    while left:
        with subprocess.Popen(
            [
                sys.executable,
                "-m",
                "benchmarks.hostile_arrays",
                "--work",
                "--seed",
                str(seed),
                "--names",
                *left,
            ],
            stdout=subprocess.PIPE,
            text=True,
        ) as worker:
            running = _listen(worker, journal)
        if running and running not in journal:
            journal.put(running, [["?", "crashed or hung", ""]])
        remaining = [name for name in left if name not in journal]
        if len(remaining) == len(left):
            raise RuntimeError(f"no case of {left[0]} could be started")
        left = remaining


def _listen(worker: subprocess.Popen[str], journal: Journal) -> str:
    """Read the lines of a worker; returns the function that was running when it ended."""
    import threading

    running = ""
    assert worker.stdout is not None
    watch: threading.Timer | None = None
    for line in worker.stdout:
        name, *done = json.loads(line)
        if watch is not None:
            watch.cancel()
        if done:
            journal.put(name, done[0])
        else:
            running = name
            watch = threading.Timer(LIMIT_S, worker.kill)
            watch.daemon = True
            watch.start()
    if watch is not None:
        watch.cancel()
    return running


def summary(journal: Journal) -> dict[str, Any]:
    """Figures of the row: how many functions and cases, and faults by kind."""
    outcomes = Counter(row[1] for rows in journal.rows.values() for row in rows)
    untried = sorted(name for name, rows in journal.rows.items() if rows[0][1] == "not tried")
    tried = sum(count for outcome, count in outcomes.items() if outcome != "not tried")
    return {
        "functions": len(journal.rows) - len(untried),
        "not tried": untried,
        "tried": tried,
        "crashed": outcomes["foreign"] + outcomes["crashed or hung"],
        "wrong": outcomes["wrong"],
        "refused": outcomes["refused"],
        "results": outcomes["result"],
    }


def main() -> None:
    """Run, or continue, a campaign."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, help="functions, the first ones by name")
    parser.add_argument("--names", nargs="*", default=[])
    parser.add_argument("--report", type=Path)
    parser.add_argument("--verbose", action="store_true", help="print every fault")
    parser.add_argument("--work", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.work:
        _work(args.names, args.seed)
        return
    names = args.names or list(public_functions())[: args.count]
    journal = Journal(args.report, {"campaign": "hostile arrays", "seed": args.seed})
    campaign(names, args.seed, journal)
    for name, rows in journal.rows.items():
        for case, outcome, text in rows:
            if args.verbose and outcome in ("foreign", "wrong", "crashed or hung"):
                print(f"{name}({case}): {outcome}: {text}")
    print(json.dumps(summary(journal), indent=1))


if __name__ == "__main__":
    main()
