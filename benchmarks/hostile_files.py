"""Damaged and hostile files for every reader: structured mutation of valid files with limited memory and time.

A reader accepts a file or rejects it with one line that names it; any other exception, a crash, more than 2 GB beyond
the interpreter or more than 20 s are faults. Whether the contents of an accepted file are correct is not tested here: the
campaigns of single readers (``map_fuzz``, ``sequence_faults``, ``objects_faults``) know by construction what is wrong.
Files that revealed faults are kept in ``tests/corpus``.

    python -m benchmarks.hostile_files --count 500 --seeds open --report files.jsonl    prints files, refusals and faults
"""

from __future__ import annotations

import argparse
import json
import os
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ._journal import Journal

#: Address space beyond what the interpreter with its libraries has taken [bytes], and time of one file [s].
ROOM_BYTES, LIMIT_S = 2 << 30, 20
#: Larger files are not generated: headers test the handling of sizes as well.
MAX_LENGTH = 2_000_000
CORPUS = Path(__file__).resolve().parents[1] / "tests" / "corpus"

Rng = np.random.Generator
Build = Callable[[Path], None]

#: Texts in place of a number or word.
TOKENS = (
    *(
        "nan",
        ".nan",
        "inf",
        "-1",
        "0",
        "1e400",
        "-1e308",
        "1e-320",
        "9" * 30,
        "9" * 5000,
        "59:59:59",
        "0x",
        "1_0",
    ),
    *(
        "",
        "null",
        "true",
        "[]",
        "{}",
        "[[[[",
        "*a",
        "&a",
        "!!python/object:os.system",
        "!!binary aaa",
        "'",
        '"',
        "\0",
    ),
    *(
        "../../../etc/passwd",
        "/dev/zero",
        "x" * 300,
        "\u202e",
        "\ud7ff",
        "1e",
        "--1",
        "1,5",
        "NaN",
        "Infinity",
    ),
)
NESTED = "[" * 3000 + "]" * 3000
ALIASES = "\n".join(
    ["a0: &a0 [x, y, z, x, y, z, x, y]"]
    + [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 8)}]" for n in range(1, 9)]
)


def _text(text: str) -> Build:

    def build(path: Path) -> None:
        path.write_text(text, encoding="utf-8")

    return build


def _camera(path: Path) -> None:
    from visuohaptic.core.camera import Camera

    Camera.simple(64, 48, 60.0).save(path)


def _image(path: Path) -> None:
    rng = np.random.default_rng(0)
    pixels = cv2.GaussianBlur(rng.integers(0, 256, (40, 50, 3), dtype=np.uint8), (5, 5), 0)
    path.write_bytes(cv2.imencode(path.suffix, pixels)[1].tobytes())


def _depth(path: Path) -> None:
    from visuohaptic.io import write_depth

    write_depth(path, np.random.default_rng(0).uniform(0.5, 3.0, (30, 40)))


def _exr(path: Path) -> None:
    values = np.random.default_rng(0).uniform(0.5, 3.0, (6, 8)).astype("<f4")

    def attribute(name: str, kind: str, data: bytes) -> bytes:
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(data)) + data

    box = struct.pack("<4i", 0, 0, 7, 5)
    head = struct.pack("<ii", 20000630, 2)
    head += attribute("channels", "chlist", b"Z\0" + struct.pack("<iB3xii", 2, 0, 1, 1) + b"\0")
    head += attribute("compression", "compression", b"\0") + attribute("dataWindow", "box2i", box)
    head += attribute("displayWindow", "box2i", box) + attribute("lineOrder", "lineOrder", b"\0")
    head += attribute("pixelAspectRatio", "float", struct.pack("<f", 1)) + b"\0"
    rows = [struct.pack("<ii", y, values[y].nbytes) + values[y].tobytes() for y in range(6)]
    start = len(head) + 8 * 6
    places = [start + sum(map(len, rows[:y])) for y in range(6)]
    path.write_bytes(head + struct.pack("<6Q", *places) + b"".join(rows))


def _force(path: Path) -> None:
    from visuohaptic.core import ErrorBudget, ForceProfile, Reason
    from visuohaptic.io import TableWriter

    s_m = np.linspace(0, 0.1, 9)
    with TableWriter(path) as table:
        for n in range(4):
            values = (s_m, s_m * 1e-3, s_m * 1e-5, s_m, s_m, np.ones(9, bool))
            table.write(ForceProfile(0.1 * n, True, Reason.OK, float(n), ErrorBudget(image_N=0.1), *values))


def _mcap(path: Path) -> None:
    from visuohaptic.core import Event, EventKind, Reason, Wrench
    from visuohaptic.core.camera import Frame
    from visuohaptic.io import MeasurementWriter

    with MeasurementWriter(path, chunk_bytes=2000) as writer:
        for n in range(6):
            wrench = Wrench(0.1 * n, True, Reason.OK, np.ones(3), np.zeros(3), 1e-4 * np.eye(6))
            writer.write_wrench(wrench)
            writer.write_event(Event(EventKind.CONTACT, 0.1 * n))
            writer.write_frame(Frame(np.full((12, 16), 9 * n, np.uint8), 0.1 * n, n))


def _npz(path: Path) -> None:
    from visuohaptic.deformation.maps import object_map, save_map
    from visuohaptic.deformation.shapes import load_object

    save_map(path, object_map(load_object("cup", around=32)))


def _ply(path: Path) -> None:
    from visuohaptic.io.meshes import PlyMesh, write_ply

    points = np.random.default_rng(0).uniform(0, 1, (12, 3))
    faces = np.stack([np.arange(10), np.arange(1, 11), np.arange(2, 12)], axis=1)
    write_ply(path, PlyMesh(points, faces, np.full((12, 3), 9, np.uint8), {"sigma_m": points[:, 0]}))


def _mesh(path: Path) -> None:
    import trimesh

    trimesh.creation.icosphere(subdivisions=1).export(path)


def _video(path: Path) -> None:
    import av

    with av.open(str(path), "w") as out:
        stream = out.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for n in range(8):
            image = np.full((48, 64, 3), 20 * n, np.uint8)
            out.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        out.mux(stream.encode())


def _scans(path: Path) -> None:
    from visuohaptic.core.laser_scan import LaserScan
    from visuohaptic.io import write_scans

    scan = LaserScan(0.0, np.ones(20), -1.0, 0.1)
    write_scans(path, [(scan, (0.0, 0.0, 0.0))] * 3)


def _container(path: Path) -> None:
    from visuohaptic.deformation import shapes

    path.write_bytes((Path(shapes.__file__).parent / "classes" / "cup.yaml").read_bytes())


def _beam(path: Path) -> None:
    from visuohaptic.sensing.beam import Beam, save_beam

    save_beam(path, Beam())


def _occupancy(path: Path) -> None:
    _pgm(path.with_name("cells.pgm"))
    path.write_text("image: cells.pgm\nresolution: 0.05\norigin: [-1.5, 2.0, 0.1]\nnegate: 0\n" + _LIMITS)


def _pgm(path: Path) -> None:
    path.write_bytes(_PGM)


def _bag(path: Path) -> None:
    import sqlite3
    from contextlib import closing

    with closing(sqlite3.connect(path)) as bag:
        bag.executescript(_BAG)
        for n in range(5):
            text = f"{n}".encode()
            data = b"\0\1\0\0" + struct.pack("<I", len(text) + 1) + text + b"\0"
            bag.execute("INSERT INTO messages VALUES (?, 1, ?, ?)", (n + 1, 10**9 * n, data))
        bag.commit()


def _card(path: Path) -> None:
    from visuohaptic.core import Estimate, HapticTag, VisuoHapticObject
    from visuohaptic.database import export_object

    tag = HapticTag(dynamic_friction_N=Estimate(3.2, 0.1))
    with tempfile.TemporaryDirectory() as folder:
        card = export_object(VisuoHapticObject(id="box", tag=tag), folder, licence="CC0-1.0")
        path.write_bytes((card / "card.yaml" if card.is_dir() else card).read_bytes())


def _layer(path: Path) -> None:
    from visuohaptic.io import OccupancyMap
    from visuohaptic.navigation.files import save_layer

    grid = OccupancyMap(np.zeros((9, 12), np.int8), 0.05, (0.0, 0.0, 0.0))
    save_layer(path, np.ones((9, 12)), grid)


def _unfinished(path: Path) -> None:
    import shutil

    whole = path.with_suffix("")
    from visuohaptic.core import Reason, Wrench
    from visuohaptic.io import TableWriter

    with TableWriter(whole) as table:
        for n in range(3):
            table.write(Wrench(0.1 * n, True, Reason.OK, np.ones(3), np.zeros(3), np.eye(6)))
        shutil.copy(table.part, path.with_name("copy"))
    whole.unlink()
    path.with_name("copy").rename(path)


_PGM = b"P5\n# cells\n4 3\n255\n" + bytes([254, 0, 205, 254] * 3)
_LIMITS = "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
_BAG = """
CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, offered_qos_profiles TEXT);
CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
CREATE TABLE message_definitions (id INTEGER PRIMARY KEY, topic_type TEXT, encoding TEXT,
                                  encoded_message_definition TEXT, type_description_hash TEXT);
INSERT INTO topics VALUES (1, '/said', 'std_msgs/msg/String', 'cdr', '');
INSERT INTO message_definitions VALUES (1, 'std_msgs/msg/String', 'ros2msg', 'string data', '');
"""
_POSES = "# t x y z q\n" + "".join(f"{0.1 * n:.3f} {n} 0 0 0 0 0 1\n" for n in range(5))
_ROBOT = "radius_m: 0.17\nv_max_m_s: 0.3\nv_min_m_s: 0.05\nv_push_m_s: 0.05\npush_force_max_N: 20.0\n"
_OBJECTS = (
    "objects:\n- id: box\n  footprint_m: [[0, 0], [0.4, 0], [0.4, 0.4], [0, 0.4]]\n"
    "  haptic_tag: {static_friction_N: 8.1}\n"
)
_CURVES = "height,side,force_N,deformation_m\n" + "".join(
    f"{h},x+,{n}.5,0.00{n}1\n" for h in (1, 5) for n in range(5)
)
_TOUCHES = "x_m,y_m,z_m,sigma_m\n" + "".join(f"0.{n},0.1,0.2,0.001\n" for n in range(5))
_LOADS = "fx_N,fy_N,fz_N,mx_Nm,my_Nm,mz_Nm,x_m,y_m,z_m,rx_rad,ry_rad,rz_rad\n" + "".join(
    f"{n},0.1,0.2,0.01,0.02,0.03,0.00{n},0,0,0,0.0{n},0\n" for n in range(8)
)
_REGION = '{"unit": "m", "clusters": [{"hull": [[0,0,0],[1,0,0],[0,1,0],[0,0,1]], "faces": [[0,1,2]]}]}'
_GLASS = '{"clusters": [], "panes": [{"corners": [[0,0,0],[1,0,0],[1,0,1],[0,0,1]], "sigma": 0.002}]}'

#: Name, suffix and writer of a valid file, and the expression that reads ``path``: "module:expression".
READERS: tuple[tuple[str, str, Build, str], ...] = (
    ("camera", ".yaml", _camera, "core.camera:Camera.load(path)"),
    ("robot", ".yaml", _text(_ROBOT), "navigation.problem:load_robot(path)"),
    ("objects", ".yaml", _text(_OBJECTS), "navigation.problem:load_objects(path)"),
    ("container", ".yaml", _container, "deformation.shapes:load_container(path)"),
    (
        "beam",
        ".yaml",
        _beam,
        "sensing.beam:load_beam(path)",
    ),
    ("plan", ".yaml", _text("classes: [{class: cup, variants: 2}]\n"), "deformation.maps:load_plan(path)"),
    ("png", ".png", _image, "core.files:read_image(path)"),
    ("jpeg", ".jpg", _image, "core.files:read_image(path)"),
    ("tiff", ".tiff", _image, "core.files:read_image(path)"),
    ("bmp", ".bmp", _image, "core.files:read_image(path)"),
    ("webp", ".webp", _image, "core.files:read_image(path)"),
    ("ppm", ".ppm", _image, "core.files:read_image(path)"),
    ("depth", ".png", _depth, "io:read_depth(path, DepthEncoding(1e-3))"),
    ("exr", ".exr", _exr, "io:read_depth(path, DepthEncoding(1.0))"),
    ("forces", ".csv", _force, "io:read_force_table(path)"),
    ("forces parquet", ".parquet", _force, "io:read_force_table(path)"),
    ("mcap", ".mcap", _mcap, "io:[McapFile(path).topics(), McapFile(path).damage]"),
    ("mcap frames", ".mcap", _mcap, "io:[frame for frame in McapSource(path)]"),
    ("stiffness map", ".npz", _npz, "deformation.maps:load_map(path)"),
    ("ply", ".ply", _ply, "io.meshes:read_ply(path)"),
    ("stl", ".stl", _mesh, "io.meshes:load_mesh(path)"),
    ("obj", ".obj", _mesh, "io.meshes:load_mesh(path)"),
    ("glb", ".glb", _mesh, "io.meshes:load_mesh(path)"),
    ("poses", ".txt", _text(_POSES), "io:read_poses(path)"),
    ("scans", ".csv", _scans, "io:list(read_scans(path))"),
    ("curves", ".csv", _text(_CURVES), "recognition.data:read_curves(path)"),
    ("touches", ".csv", _text(_TOUCHES), "reconstruction.completion:read_touches(path)"),
    ("loads", ".csv", _text(_LOADS), "sensing.beam:read_loads(path)"),
    ("hole regions", ".json", _text(_REGION), "reconstruction.completion:load_hole_regions(path)"),
    ("glass", ".json", _text(_GLASS), "reconstruction.completion:load_glass_hulls(path)"),
    (
        "tree",
        ".json",
        _text('{"format": 1, "nodes": [[0, 1.5, 1, 2]]}'),
        "recognition.trees:load_tree(path)",
    ),
    ("layer", ".yaml", _layer, "navigation.files:load_layer(path)"),
    ("map", ".yaml", _occupancy, "io:OccupancyMap.load(path)"),
    (
        "map image",
        ".pgm",
        _pgm,
        "io.maps._map_image:read_map_image(path)",
    ),
    (
        "bag",
        ".db3",
        _bag,
        "io.ros.sqlite_bag:[(bag.decode(one), bag.topics()) for bag in [open_bag(path)] for one in bag.messages()]",
    ),
    ("card", ".yaml", _card, "database:import_object(path)"),
    ("video", ".mp4", _video, "io:[frame for frame in VideoSource(path)]"),
    ("unfinished table", ".parquet.part", _unfinished, "io:recover(path, path.with_suffix('.whole'))"),
)
_BINARY = {
    ".png",
    ".jpg",
    ".tiff",
    ".bmp",
    ".webp",
    ".ppm",
    ".exr",
    ".parquet",
    ".mcap",
    ".npz",
    ".ply",
    ".stl",
}
_BINARY |= {".glb", ".mp4", ".part", ".pgm", ".db3"}


def mutated(data: bytes, suffix: str, rng: Rng) -> bytes:
    """A file with one to three errors specific to its format."""
    for _ in range(int(rng.integers(1, 4))):
        binary = suffix in _BINARY and rng.random() < 0.95
        data = _mutated_bytes(data, rng) if binary or rng.random() < 0.15 else _mutated_text(data, rng)
    return data


def _mutated_bytes(data: bytes, rng: Rng) -> bytes:
    if not data:
        return rng.bytes(9)
    out = bytearray(data)
    # Headers matter most: half of the changes are in the first 100 bytes.
    place = int(rng.integers(0, min(len(out), 100) if rng.random() < 0.5 else len(out)))
    length = int(rng.integers(1, 40))
    kind = int(rng.integers(8))
    if kind == 0:
        out[place] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        out[place : place + length] = bytes([int(rng.choice([0, 255, 127, 32]))]) * length
    elif kind == 2:
        del out[place:]
    elif kind == 3:
        del out[place : place + length]
    elif kind == 4:
        out[place:place] = out[place : place + length] * int(rng.integers(1, 50))
    elif kind == 5:
        number = int(rng.choice([0, 1, 0x7FFFFFFF, 0xFFFFFFFF, 0x80000000, 0xFFFF, 100_000, 0x40000000]))
        size = int(rng.choice([2, 4, 8]))
        packed = (number % (1 << 8 * size)).to_bytes(size, "little" if rng.random() < 0.5 else "big")
        out[place : place + len(packed)] = packed
    elif kind == 6:
        out[place : place + length] = rng.bytes(length)
    else:
        other = int(rng.integers(0, len(out)))
        out[place : place + length] = out[other : other + length]
    return bytes(out)


def _mutated_text(data: bytes, rng: Rng) -> bytes:
    import re

    text = data.decode("utf-8", errors="replace")
    kind = int(rng.integers(8))
    if kind <= 3 and (words := list(re.finditer(r"[-+.\w]+", text))):
        word = words[int(rng.integers(len(words)))]
        text = text[: word.start()] + str(rng.choice(np.array(TOKENS, dtype=object))) + text[word.end() :]
    elif kind == 4:
        lines = text.splitlines(keepends=True) or [""]
        place = int(rng.integers(len(lines)))
        # A file without ends of lines is one line.
        count = min(int(rng.choice([0, 2, 3000])), MAX_LENGTH // (len(lines[place]) + 1))
        lines[place : place + 1] = lines[place : place + 1] * count
        text = "".join(lines)
    elif kind == 5 and (values := list(re.finditer(r": *([^\n{]+)", text))):
        value = values[int(rng.integers(len(values)))]
        hostile = NESTED if rng.random() < 0.5 else "*a8"
        text = (
            (ALIASES + "\n" if hostile == "*a8" else "")
            + text[: value.start(1)]
            + hostile
            + text[value.end(1) :]
        )
    elif kind == 6:
        text = (
            str(rng.choice(np.array(["\ufeff", "\0", "\t", "---\n", "%YAML 9\n", "{", "["], dtype=object)))
            + text
        )
    else:
        place = int(rng.integers(0, len(text) + 1))
        text = text[:place]
    return text.encode("utf-8", errors="surrogatepass")


_WORKER = """
import importlib, json, os, resource, signal, sys, time
from pathlib import Path
os.environ["OPENBLAS_NUM_THREADS"] = "1"
lines = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)
from benchmarks.hostile_files import LIMIT_S, READERS, ROOM_BYTES
from visuohaptic.core import VisuohapticError
import visuohaptic.io, logging
logging.disable(logging.CRITICAL)

class TooLong(BaseException): pass
def stop(*_): raise TooLong
for kind in (signal.SIGALRM, signal.SIGPROF):
    signal.signal(kind, stop)
def limit(seconds):
    # Of the processor, and of a clock ten times as long: other programs may run here.
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.alarm(10 * seconds)
readers = {name: call for name, _, _, call in READERS}
calls = {}
def call_of(name):
    if name not in calls:
        module, _, expression = readers[name].partition(":")
        package = importlib.import_module("visuohaptic." + module)
        scope = {n: getattr(package, n) for n in getattr(package, "__all__", vars(package))}
        calls[name] = (compile(expression, name, "eval"), scope)
    return calls[name]
names = json.loads(sys.argv[1])
for _, name, _ in names: call_of(name)
pages = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (pages + ROOM_BYTES,) * 2)
for key, name, file in names:
    path = Path(file)
    print(json.dumps([key]), file=lines, flush=True)
    code, scope = call_of(name)
    started = time.process_time()
    limit(LIMIT_S)
    try:
        eval(code, {**scope, "path": path})
        outcome, text = "accepted", ""
    except VisuohapticError as error:
        text = str(error)
        clear = path.stem in text and "\\n" not in text and len(text) < 1000
        outcome = "refused" if clear else "unclear"
    except TooLong:
        outcome, text = "hung", ""
    except BaseException as error:
        outcome, text = "crashed", f"{type(error).__name__}: {error}"
    limit(0)
    print(json.dumps([key, name, outcome, text[:300], round(time.process_time() - started, 3)]), file=lines, flush=True)
"""


def examine(files: list[tuple[str, str, Path]]) -> dict[str, list[Any]]:
    """Reader, outcome, text and CPU time by key of ``(key, reader, file)``; a crash of the process is an outcome."""
    rows: dict[str, list[Any]] = {}
    left = list(files)
    while left:
        names = json.dumps([[key, name, str(path)] for key, name, path in left])
        with subprocess.Popen(
            [sys.executable, "-c", _WORKER, names], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as worker:
            out, err = worker.communicate(timeout=10 * LIMIT_S * (len(left) + 9))
        running = None
        for line in out.splitlines():
            key, *row = json.loads(line)
            running = key if not row else None
            if row:
                rows[key] = row
        if running is not None:
            name = next(name for key, name, _ in left if key == running)
            rows[running] = [
                name,
                "crashed",
                f"the process ended with {worker.returncode}: {err[-200:]}",
                0.0,
            ]
        elif any(key not in rows for key, _, _ in left):
            raise RuntimeError(err[-2000:])
        left = [one for one in left if one[0] not in rows]
    return rows


def valid_files(root: Path) -> list[tuple[str, str, Path]]:
    """The files that mutations start from: key, reader and path."""
    files = []
    for name, suffix, build, _ in READERS:
        path = root / f"valid-{name.replace(' ', '-')}{suffix}"
        build(path)
        files.append((f"valid {name}", name, path))
    return files


def campaign(count: int, seed: int, journal: Journal, keep: Path | None = None, batch: int = 340) -> None:
    """Rows of ``count`` mutated files, by turns of all readers."""
    with tempfile.TemporaryDirectory() as root:
        valid = {name: path.read_bytes() for _, name, path in valid_files(Path(root))}
        for start in range(0, count, batch):
            files = []
            for number in range(start, min(start + batch, count)):
                key = f"{seed}-{number}"
                if key in journal:
                    continue
                name, suffix, _, _ = READERS[number % len(READERS)]
                path = Path(root) / f"f{key}{suffix}"
                path.write_bytes(
                    mutated(valid[name], Path(suffix).suffix, np.random.default_rng([seed, number]))
                )
                files.append((key, name, path))
            for key, row in examine(files).items():
                journal.put(key, row)
                if keep is not None and row[1] in ("crashed", "hung", "unclear"):
                    path = next(path for found, _, path in files if found == key)
                    keep.mkdir(parents=True, exist_ok=True)
                    (keep / f"{row[0].replace(' ', '_')}-{path.name}").write_bytes(path.read_bytes())


def summary(journal: Journal) -> dict[str, Any]:
    """Figures of the row."""
    found = Counter(row[1] for row in journal.rows.values())
    slowest = max((row[3] for row in journal.rows.values()), default=0.0)
    return {"tried": len(journal.rows), **dict(sorted(found.items())), "slowest_s": slowest}


def main() -> None:
    """Run, or continue, a campaign."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=340)
    parser.add_argument("--seeds", choices=("open", "closed"), default="open")
    parser.add_argument("--report", type=Path)
    parser.add_argument("--keep", type=Path, help="folder for files that are faults")
    args = parser.parse_args()
    seed = 0 if args.seeds == "open" else 1
    journal = Journal(args.report, {"campaign": "hostile files", "seed": seed})
    started = time.monotonic()
    campaign(args.count, seed, journal, args.keep)
    for key, (name, outcome, text, _) in journal.rows.items():
        if outcome not in ("accepted", "refused"):
            print(f"{key} {name}: {outcome}: {text}")
    print(json.dumps(summary(journal), indent=1), f"{time.monotonic() - started:.0f} s")


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    main()
