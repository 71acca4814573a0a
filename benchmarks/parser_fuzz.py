"""Coverage-guided fuzzing, with atheris, of the parsers that this library implements itself.

    python -m benchmarks.parser_fuzz --minutes 60 --corpus results/corpus --report fuzz.jsonl
                                      slices of a minute, each parser in turn, until each has had an hour; resumable
    python -m benchmarks.parser_fuzz --targets ply bag --minutes 2 --seconds 20

Each target starts from a valid file, or from the corpus of an earlier run, and mutates inputs that reach new
branches of the library's Python code (compiled kernels and C libraries are not instrumented). An input is accepted
or rejected by an error of the library with one line; any other exception, 2 GB, or 20 s for one input end the target,
and the input is saved beside the corpus as ``TARGET-crash-...``. The rows report the number of inputs and of
branches reached. atheris is not a dependency of this project: ``pip install atheris``.
"""

from __future__ import annotations

import argparse
import math
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from importlib import import_module, util
from pathlib import Path
from types import FunctionType
from typing import Any

from ._journal import Journal
from .hostile_files import LIMIT_S, READERS, ROOM_BYTES
from .house import is_compiled, read_modules

#: Readers with our own parser, from the first byte or after a library that returns plain data.
FILES = (
    "camera", "robot", "objects", "container", "beam", "plan", "png", "tiff", "webp", "exr", "forces", "mcap",
    "stiffness map", "ply", "stl", "poses", "scans", "curves", "touches", "loads", "hole regions", "tree", "layer",
    "map", "map image", "bag", "card", "unfinished table",
)  # fmt: skip
_DEFINITION = "int32[<=3] a\nstring b\nHead c\n===\nMSG: a/Head\nfloat64 x\n"


def _bytes_targets() -> dict[str, tuple[Callable[[], bytes], str]]:
    """Seed and call, with ``data`` for the bytes, of parsers that read no file."""

    def message() -> bytes:
        from visuohaptic.ros.wire import encode, message_type

        point = {"x": 1.0, "y": 2.0, "z": 3.0}
        return encode(point, message_type("geometry_msgs/msg/Point"))

    def packed() -> bytes:
        import numpy as np

        from visuohaptic.core.camera import Pose
        from visuohaptic.io.remote.wire import pack

        return pack({"pose": (Pose(np.eye(3), np.ones(3)), float("nan"), 1, None)})

    token = b"@ros2_lv/0/z/1/2/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/h/::,10:,:,:,,"
    decode = "ros.wire:decode(data[1:], message_type(KINDS[(data or b'0')[0] % 3]))"
    return {
        "cdr": (lambda: b"\0" + message(), decode),
        "definition": (
            _DEFINITION.encode,
            "ros.wire:parse_definition('a/msg/B', data.decode('utf-8', 'replace'))",
        ),
        "token": (lambda: token, "ros.wire:Entity.parse(data.decode('utf-8', 'replace'))"),
        "attachment": (lambda: bytes(33), "ros.wire:Attachment.unpack(data)"),
        "remote message": (packed, "io.remote.wire:unpack(data)"),
        "yaml": (lambda: b"a: [1, {b: c}]\n", "core.files.yaml_text:parse_yaml(data, 'f')"),
    }


def targets() -> list[str]:
    """Names of all parsers."""
    return [*FILES, *_bytes_targets()]


def _work(name: str, options: list[str]) -> None:
    """Fuzz one target in this process until libFuzzer ends it."""
    import atheris

    compiled = [
        module.name for module in read_modules().values() if any(map(is_compiled, module.functions()))
    ]
    with atheris.instrument_imports(include=["visuohaptic"], exclude=compiled):
        from visuohaptic.core import VisuohapticError

        call = {one[0]: one[3] for one in READERS}
        call |= {key: text for key, (_, text) in _bytes_targets().items()}
        package, _, expression = call[name].partition(":")
        module = import_module(f"visuohaptic.{package}")
        scope = {one: getattr(module, one) for one in getattr(module, "__all__", vars(module))}
    scope["KINDS"] = (
        "geometry_msgs/msg/Point",
        "sensor_msgs/msg/Image",
        "diagnostic_msgs/msg/DiagnosticArray",
    )
    code = compile(expression, name, "eval")
    suffix = next((one[1] for one in READERS if one[0] == name), "")
    folder = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    path = folder / f"input{suffix}"

    def one_input(data: bytes) -> None:
        if suffix:
            path.write_bytes(data)
            for left in folder.glob("*.whole"):
                left.unlink()
        try:
            FunctionType(code, {**scope, "path": path, "data": data})()
        except VisuohapticError as error:
            if "\n" in str(error) or len(str(error)) > 1000:
                raise RuntimeError(f"not one line of a sensible length: {error!r}") from error

    import logging

    logging.disable(logging.CRITICAL)
    atheris.Setup([sys.argv[0], *options], one_input)
    atheris.Fuzz()


def fuzz(name: str, seconds: int, corpus: Path, seed: int) -> dict[str, Any]:
    """Run one target for some seconds; inputs tried, branches reached, size of the corpus, and what ended it."""
    place = corpus / name.replace(" ", "_")
    place.mkdir(parents=True, exist_ok=True)
    if not any(place.iterdir()):
        made = _bytes_targets()
        if name in made:
            (place / "valid").write_bytes(made[name][0]())
        else:
            _, suffix, build, _ = next(one for one in READERS if one[0] == name)
            with tempfile.TemporaryDirectory() as folder:
                build(Path(folder) / f"valid{suffix}")
                (place / "valid").write_bytes((Path(folder) / f"valid{suffix}").read_bytes())
    options = [
        str(place),
        f"-max_total_time={seconds}",
        f"-timeout={LIMIT_S}",
        "-max_len=20000",
        "-print_final_stats=1",
    ]
    options += [f"-rss_limit_mb={ROOM_BYTES >> 20}", f"-artifact_prefix={place}-", f"-seed={seed}"]
    words = [sys.executable, "-m", "benchmarks.parser_fuzz", "--work", name, *options]
    done = subprocess.run(words, capture_output=True, text=True, check=False, errors="replace")
    text = done.stdout + done.stderr
    tried = re.findall(r"stat::number_of_executed_units: (\d+)|^#(\d+)", text, re.MULTILINE)
    reached = re.findall(r"cov: (\d+)", text)
    trouble = ""
    if done.returncode:
        found = re.search(r"=== Uncaught Python exception: ===\n(.*)|ERROR: (libFuzzer.*)", text)
        trouble = (found[1] or found[2]) if found else text[-300:]
    return {
        "seconds": seconds,
        "tried": max((int(one or other) for one, other in tried), default=0),
        "branches": int(reached[-1]) if reached else 0,
        "corpus": len(list(place.iterdir())),
        "trouble": trouble[:400],
    }


def main() -> None:
    """Run the targets that are missing in a report."""
    if sys.argv[1:2] == ["--work"]:
        _work(sys.argv[2], sys.argv[3:])
        return
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--targets", nargs="*", default=targets(), choices=targets(), metavar="NAME")
    parser.add_argument("--minutes", type=float, default=1.0, help="for each target")
    parser.add_argument("--seconds", type=int, default=60, help="of a slice")
    parser.add_argument("--corpus", type=Path, default=Path("results/corpus"))
    parser.add_argument("--report", type=Path)
    args = parser.parse_args()
    if util.find_spec("atheris") is None:
        raise SystemExit("found no atheris: pip install atheris")
    journal = Journal(args.report, {"campaign": "parser fuzz", "slice_s": args.seconds})
    for number in range(math.ceil(60.0 * args.minutes / args.seconds)):
        for name in args.targets:
            if (key := f"{name}, slice {number}") not in journal:
                journal.put(key, fuzz(name, args.seconds, args.corpus, 2 + 2 * number))
                print(key, journal.rows[key], flush=True)
    rows = journal.rows.values()
    print(
        f"{len(rows)} slices, {sum(row['tried'] for row in rows):,} inputs, "
        f"{sum(bool(row['trouble']) for row in rows)} ended by a fault"
    )


if __name__ == "__main__":
    main()
