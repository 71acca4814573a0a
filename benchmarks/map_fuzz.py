"""Malformed maps: each has to be rejected with one clear line, in limited memory, and none accepted silently.

Each file is wrong by construction (a changed pixel of a PGM is a different map,
and not an error). The files are read in a separate process with a limit on its
address space, and its growth is measured.

    python -m benchmarks.map_fuzz --count 200    prints how many were rejected, accepted, unclear, and the peak memory
"""

from __future__ import annotations

import argparse
import json
import struct
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

SEED = 20261121
#: Address space beyond what the interpreter with its libraries has taken [bytes].
ROOM_BYTES = 512 << 20

Rng = np.random.Generator

FIELDS = {
    "image": "map.pgm",
    "resolution": "0.05",
    "origin": "[-1.5, 2.0, 0.1]",
    "negate": "0",
    "occupied_thresh": "0.65",
    "free_thresh": "0.196",
}


def _pixels(rng: Rng) -> np.ndarray:
    cells = rng.choice(
        np.array([0, 205, 254], np.uint8), (int(rng.integers(40, 200)), int(rng.integers(40, 200)))
    )
    return np.asarray(cv2.medianBlur(cells, 5))


def _yaml(folder: Path, **changes: str | None) -> None:
    fields = {key: value for key, value in {**FIELDS, **changes}.items() if value is not None}
    (folder / "map.yaml").write_text("".join(f"{key}: {value}\n" for key, value in fields.items()))


def _pgm(
    pixels: np.ndarray, *, text: bool = False, size: tuple[int, int] | None = None, top: int = 255
) -> bytes:
    rows, columns = size or pixels.shape
    head = f"{'P2' if text else 'P5'}\n# made here\n{columns} {rows}\n{top}\n".encode()
    if not text:
        return head + pixels.tobytes()
    return head + b"\n".join(b" ".join(str(v).encode() for v in row) for row in pixels.tolist()) + b"\n"


def _encoded(pixels: np.ndarray, suffix: str) -> bytes:
    return bytes(cv2.imencode(suffix, pixels)[1].tobytes())


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def _bare_png(columns: int, rows: int, packed: bytes) -> bytes:
    header = struct.pack(">IIBBBBB", columns, rows, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", header) + _chunk(b"IDAT", packed) + _chunk(b"IEND", b"")


def cut_picture(folder: Path, rng: Rng) -> None:
    """A truncated image of any format."""
    suffix = str(rng.choice([".pgm", ".txt.pgm", ".png", ".bmp", ".jpg"]))
    pixels = _pixels(rng)
    whole = _pgm(pixels, text=suffix == ".txt.pgm") if suffix.endswith(".pgm") else _encoded(pixels, suffix)
    # The last number of a text file may be cut to another number, and its line end is no loss.
    keep = int(rng.integers(0, len(whole) - 8))
    (folder / f"map{suffix}").write_bytes(whole[:keep])
    _yaml(folder, image=f"map{suffix}")


def wrong_size(folder: Path, rng: Rng) -> None:
    """Header and pixels do not agree."""
    pixels = _pixels(rng)
    rows, columns = pixels.shape
    size = (rows + int(rng.choice([-7, -1, 1, 30])), columns + int(rng.choice([0, 1, 5])))
    if size[0] * size[1] == rows * columns:
        size = (rows + 1, columns)
    (folder / "map.pgm").write_bytes(_pgm(pixels, text=bool(rng.random() < 0.4), size=size))
    _yaml(folder)


def huge_header(folder: Path, rng: Rng) -> None:
    """A header that requests all available memory."""
    rows, columns = [(100_000, 100_000), (2**31 - 1, 2**31 - 1), (10**9, 1), (99_999_999_999, 3)][
        rng.integers(4)
    ]
    kind = int(rng.integers(3))
    if kind == 0 and rows < 2**31:
        data = _bare_png(columns, rows, zlib.compress(bytes(1000)))
    else:
        data = f"{'P5' if kind == 1 else 'P2'} {columns} {rows} 255\n".encode() + b"0 1 2 3"
    name = "map.png" if data[:1] == b"\x89" else "map.pgm"
    (folder / name).write_bytes(data)
    _yaml(folder, image=name)


def bomb(folder: Path, rng: Rng) -> None:
    """A small PNG that unpacks to far more, or less, than its header says; YAML that multiplies itself."""
    kind = int(rng.integers(3))
    if kind == 0:
        (folder / "map.png").write_bytes(_bare_png(50, 50, zlib.compress(bytes(200_000_000), 9)))
        _yaml(folder, image="map.png")
    elif kind == 1:
        (folder / "map.png").write_bytes(_bare_png(9999, 9999, zlib.compress(bytes(5000))))
        _yaml(folder, image="map.png")
    else:
        lines = ["a0: &a0 [x, y]"]
        lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 12)}]" for i in range(1, 14)]
        text = "\n".join([*lines, "image: *a13", "resolution: *a13", "origin: *a13"])
        if rng.random() < 0.5:
            lines = ["m0: &m0 {k: 1}"]
            lines += [f"m{i}: &m{i}\n  <<: [{', '.join([f'*m{i - 1}'] * 12)}]" for i in range(1, 12)]
            text = "\n".join(lines)
        (folder / "map.yaml").write_text(text + "\n")


def bad_number(folder: Path, rng: Rng) -> None:
    """A field that is not a usable number."""
    (folder / "map.pgm").write_bytes(_pgm(_pixels(rng)))
    changes: list[dict[str, str]] = [
        {"origin": "[.nan, 0, 0]"},
        {"origin": "[0, 0, .inf]"},
        {"origin": "[0, 0]"},
        {"origin": "[0, 0, 0, 0]"},
        {"origin": "[a, b, c]"},
        {"origin": "7"},
        {"origin": "[1.0e+300, 0, 0]"},
        {"resolution": ".nan"},
        {"resolution": "0"},
        {"resolution": "-0.05"},
        {"resolution": ".inf"},
        {"resolution": "1.0e-300"},
        {"resolution": "yes"},
        {"resolution": "five"},
        {"occupied_thresh": "0.1"},
        {"occupied_thresh": "65"},
        {"free_thresh": ".nan"},
        {"free_thresh": "-1"},
        {"negate": "perhaps"},
        {"mode": "ternary"},
    ]
    _yaml(folder, **changes[rng.integers(len(changes))])


def lost_field(folder: Path, rng: Rng) -> None:
    """A missing line of the YAML file, or a truncated file."""
    (folder / "map.pgm").write_bytes(_pgm(_pixels(rng)))
    names = list(FIELDS)
    place = int(rng.integers(len(names)))
    lost = names[place:] if rng.random() < 0.5 else [names[place]]
    _yaml(folder, **dict.fromkeys(lost))


def traversal(folder: Path, rng: Rng) -> None:
    """An image outside the folder of the map."""
    outside = folder.parent / f"outside_{folder.name}.pgm"
    outside.write_bytes(_pgm(_pixels(rng)))
    names = [
        f"../{outside.name}",
        str(outside),
        f"sub/../../{outside.name}",
        "/etc/passwd",
        "../../../../../../etc/passwd",
        f"..\\{outside.name}",
        "link.pgm",
        '"a\\0b"',
        ".",
        "..",
        "map.yaml",
        "x" * 5000,
    ]
    name = names[rng.integers(len(names))]
    if name == "link.pgm":
        (folder / name).symlink_to(outside)
    _yaml(folder, image=name)


def bad_bytes(folder: Path, rng: Rng) -> None:
    """Noise in a file whose every byte counts."""
    pixels = _pixels(rng)
    kind = int(rng.integers(4))
    if kind == 0:  # any changed byte of a PNG
        data = bytearray(_encoded(pixels, ".png"))
        data[rng.integers(len(data))] ^= int(rng.integers(1, 256))
        (folder / "map.png").write_bytes(bytes(data))
        _yaml(folder, image="map.png")
    elif kind == 1:
        words = _pgm(pixels, text=True).split(b" ")
        words[rng.integers(30, len(words))] = bytes(
            rng.choice([b"x", b"-3", b"1e3", b"70000", b"12 13", b"0x1f"])
        )
        (folder / "map.pgm").write_bytes(b" ".join(words))
        _yaml(folder)
    elif kind == 2:
        top = int(rng.choice([0, 100, 70000, 253]))
        pixels[0, 0] = 254
        (folder / "map.pgm").write_bytes(_pgm(pixels, top=top))
        _yaml(folder)
    else:
        name = str(rng.choice(["map.pgm", "map.yaml"]))
        (folder / "map.pgm").write_bytes(_pgm(pixels))
        _yaml(folder)
        (folder / name).write_bytes(rng.bytes(int(rng.choice([0, 1, 20, 3000]))))


MUTATIONS: tuple[Callable[[Path, Rng], None], ...] = (
    cut_picture,
    wrong_size,
    huge_header,
    bomb,
    bad_number,
    lost_field,
    traversal,
    bad_bytes,
)

_WORKER = """
import json, resource, sys, time
from pathlib import Path
import cv2, yaml, pydantic
from visuohaptic.core.errors import InputError
from visuohaptic.io import OccupancyMap
OccupancyMap.load(Path(sys.argv[1]) / "good" / "map.yaml")
pages = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (pages + int(sys.argv[2]),) * 2)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for folder in sorted(Path(sys.argv[1]).glob("[0-9]*")):
    started = time.process_time()
    try:
        OccupancyMap.load(folder / "map.yaml")
        outcome, text = "accepted", ""
    except InputError as error:
        outcome, text = "refused", str(error)
    except BaseException as error:
        outcome, text = "crashed", f"{type(error).__name__}: {error}"
    print(json.dumps([folder.name, outcome, text, time.process_time() - started]))
print(json.dumps((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024))
"""


def campaign(count: int, seed: int = SEED) -> dict[str, Any]:
    """Write ``count`` malformed maps and read them in another process."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as root:
        good = Path(root) / "good"
        good.mkdir()
        (good / "map.pgm").write_bytes(_pgm(_pixels(rng)))
        _yaml(good)
        kinds = []
        for number in range(count):
            folder = Path(root) / f"{number:05d}"
            folder.mkdir()
            mutate = MUTATIONS[number % len(MUTATIONS)]
            mutate(folder, rng)
            kinds.append(mutate.__name__)
        done = subprocess.run(
            [sys.executable, "-c", _WORKER, root, str(ROOM_BYTES)],
            capture_output=True,
            text=True,
            check=False,
        )
        lines = [json.loads(line) for line in done.stdout.splitlines()]
        if len(lines) != count + 1:
            raise RuntimeError(f"the reader died after {len(lines)} of {count} files: {done.stderr[-300:]}")
        files = [
            {"kind": kind, "outcome": outcome, "text": text.replace(root, ""), "cpu_s": cpu_s}
            for kind, (_, outcome, text, cpu_s) in zip(kinds, lines[:-1], strict=True)
        ]
    return {"files": files, "growth_MB": lines[-1]}


def run(count: int = 200, seed: int = SEED) -> list[dict[str, Any]]:
    """Rows of the table."""
    found = campaign(count, seed)
    files = found["files"]
    # Clear: one line that names the file and does not dump its contents.
    unclear = [
        f
        for f in files
        if f["outcome"] == "refused"
        and not ("/map" in f["text"] and "\n" not in f["text"] and len(f["text"]) <= 1000)
    ]
    slowest = max(files, key=lambda f: f["cpu_s"])
    return [
        _row("malformed maps accepted silently", sum(f["outcome"] == "accepted" for f in files), count),
        _row("malformed maps that crash the reader", sum(f["outcome"] == "crashed" for f in files), count),
        _row("malformed maps without a clear line", len(unclear), count),
        {
            "name": "memory that malformed maps take",
            "ours": found["growth_MB"],
            "unit": "MB",
            "floor": ROOM_BYTES / 2**20,
            "higher_is_better": False,
            "note": "growth of the peak resident size; the limit is enforced",
        },
        {
            "name": "slowest malformed map",
            "ours": slowest["cpu_s"],
            "unit": "s CPU",
            "note": slowest["kind"],
        },
    ]


def _row(name: str, ours: int, count: int) -> dict[str, Any]:
    row = {"name": name, "ours": float(ours), "unit": f"of {count}", "floor": 0.0, "aim": 0.0}
    return {**row, "higher_is_better": False}


def fuzz_arguments(description: str | None) -> argparse.Namespace:
    """Command line of a campaign: how many, from which seed, and whether each is shown."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--verbose", action="store_true")
    return parser.parse_args()


if __name__ == "__main__":
    arguments = fuzz_arguments(__doc__)
    if arguments.verbose:
        for file in campaign(arguments.count, arguments.seed)["files"]:
            print(f"{file['kind']:<14}{file['outcome']:<10}{file['cpu_s']:.3f} s  {file['text'][:160]}")
    for line in run(arguments.count, arguments.seed):
        print(line)
