"""Determinism: with other hash seeds, numbers of threads and cores, every verb has to write the same bytes.

python -m benchmarks.reliability --items 11 --scale 3 --report rows.jsonl    prints the number of runs that differ
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from .house import ROOT

__all__ = ["VERBS", "cases"]

#: A room of 6 x 4 m with a wall, a door and a box in it, in cells of 5 cm; 0 is occupied.
_OBJECTS = """objects:
- {id: box, footprint_m: [[2.9, 1.7], [3.3, 1.7], [3.3, 2.1], [2.9, 2.1]], haptic_tag: {static_friction_N: 8.1}}
"""
_ROBOT = "{radius_m: 0.2, v_max_m_s: 0.4, v_min_m_s: 0.05, v_push_m_s: 0.1, push_force_max_N: 20, setup_time_s: 5}\n"
_CLASSES = "{seed: 1, around: 32, states: [{closed: false}], classes: [{class: bottle, variants: 4}, {class: cup, variants: 4}]}\n"
_GLASS = "example glass --out try"
_FUSE = "--voxel-m 0.006 --space -0.4 -0.4 -0.02 0.4 0.4 0.3"

#: Preparation, verb, and the files that it writes; ``{out}`` is a new name each time, and without files it is the
#: JSON output of the verb.
VERBS: dict[str, tuple[tuple[str, ...], str, tuple[str, ...]]] = {
    "sense foam": (
        (
            "example foam --out try",
            "calibrate foam try/strain_stress.csv --width 0.02 --height 0.01 --out try/foam.yaml",
            "sense foam --config try/sensor.yaml --source try/rest.mp4 --zero",
        ),
        "sense foam --config try/sensor.yaml --source try/push.mp4 --csv {out}.csv",
        ("{out}.csv",),
    ),
    "sense beam": (
        ("example beam --out try", "sense beam --config try/sensor.yaml --source try/rest.mp4 --zero"),
        "sense beam --config try/sensor.yaml --source try/push.mp4 --csv {out}.csv",
        ("{out}.csv",),
    ),
    "map graph": ((), "map graph room.yaml --radius 0.2 --out {out}", ("{out}",)),
    "plan": ((), "plan room.yaml --objects objects.yaml --robot robot.yaml --start 1 2 --goal 5 2 --prove --json", ()),
    "stiffness": ((), "stiffness bottle --material PET --thickness 0.0005 --out {out}.npz", ("{out}.npz",)),
    "squeeze": ((), "squeeze bottle --at 0.035 0 0.1 --force 10 --out {out}.csv", ("{out}.csv",)),
    "grasp": ((), "grasp cup-rim --force 20 --json", ()),
    "objects build": ((), "objects build classes.yaml --out {out} --workers 2", ("{out}",)),
    "classify train": (
        ("objects build classes.yaml --out objects --workers 2",),
        "classify train --objects objects --classes bottle,cup --out {out}.json",
        ("{out}.json",),
    ),
    "reconstruct": ((_GLASS,), f"reconstruct try/scan --out {{out}} {_FUSE}", ("{out}/surface.ply", "{out}/regions.json")),
    "complete": (
        (_GLASS, f"reconstruct try/scan --out model {_FUSE}"),
        "complete model/surface.ply --region model/regions.json --out {out}.ply",
        ("{out}.ply",),
    ),
}  # fmt: skip


def cases(scale: int) -> Iterator[tuple[str, Callable[[], dict[str, int]]]]:
    """Name of each verb, and what runs it 2 + 2 ``scale`` times."""
    for name in VERBS:
        yield name, partial(_compare, name, 2 + 2 * scale)


def _compare(name: str, tried: int) -> dict[str, int]:
    prepared, words, files = VERBS[name]
    with tempfile.TemporaryDirectory() as root:
        here = Path(root)
        _write_inputs(here)
        for command in prepared:
            _run(command, here, 0)
        digests = set()
        for number in range(tried):
            said = _run(words.format(out=f"out{number}"), here, number)
            paths = [here / file.format(out=f"out{number}") for file in files]
            digests.add(_digest(paths) if paths else hashlib.sha256(_without_times(said)).hexdigest())
    return {"tried": tried, "wrong": len(digests) - 1}


def _write_inputs(here: Path) -> None:
    cells = np.full((80, 120), 254, np.uint8)
    cells[[0, -1]] = cells[:, [0, -1]] = 0
    cells[:, 60:62] = 0
    cells[34:50, 60:62] = 254  # a door of 80 cm
    cells[38:46, 58:66] = 0  # the box stands in it
    (here / "room.pgm").write_bytes(b"P5 120 80 255\n" + cells.tobytes())
    meta = {"image": "room.pgm", "resolution": 0.05, "origin": [0, 0, 0], "negate": 0}
    meta |= {"occupied_thresh": 0.65, "free_thresh": 0.2}
    (here / "room.yaml").write_text(json.dumps(meta))
    for file, text in (("objects", _OBJECTS), ("robot", _ROBOT), ("classes", _CLASSES)):
        (here / f"{file}.yaml").write_text(text)


def _digest(paths: list[Path]) -> str:
    """Digest of the names and bytes of files, also in folders; a build's durations are left out."""
    digest = hashlib.sha256()
    for path in paths:
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.is_file():
                data = file.read_bytes()
                digest.update(file.name.encode() if file != path else b"")
                digest.update(_without_times(data) if file.suffix in (".json", ".jsonl") else data)
    return digest.hexdigest()


def _without_times(data: bytes) -> bytes:
    """JSON lines without data about the run itself: durations, and the names of output files."""
    kept = []
    for line in (
        [data] if data.lstrip()[:1] in (b"{", b"[") and data.count(b"\n}") <= 1 else data.splitlines()
    ):
        kept.append(json.dumps(_timeless(json.loads(line)), sort_keys=True).encode())
    return b"\n".join(kept)


def _timeless(item: object) -> object:
    if isinstance(item, dict):
        return {key: _timeless(value) for key, value in item.items() if key not in _OF_THE_RUN}
    return [_timeless(value) for value in item] if isinstance(item, list) else item


#: Entries of JSON that say how long a run took.
_OF_THE_RUN = ("search_s", "duration_s", "seconds", "elapsed_s", "cpu_s", "time_s")


def _run(words: str, folder: Path, number: int) -> bytes:
    """With another hash seed, one to three threads, on one core or all."""
    threads = str(1 + number % 3)
    names = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    cores = sorted(os.sched_getaffinity(0))
    done = subprocess.run(
        [sys.executable, "-m", "visuohaptic", *words.split()],
        cwd=folder,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), *sys.path]),
            "PYTHONHASHSEED": str(number),
            **dict.fromkeys(names, threads),
        },
        preexec_fn=partial(os.sched_setaffinity, 0, cores[: 1 + number % 2]),
        capture_output=True,
        timeout=900,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(f"{words}: exit {done.returncode}: {done.stderr.decode()[-400:]}")
    return done.stdout
