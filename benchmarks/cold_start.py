"""Cost of the first use: the start of the command, the compilation of kernels, and the safety of the cache with many writers.

``run`` times ``visuohaptic --help``: wall time of a fresh process, as the user experiences it. The
peer is a fresh process that only imports NumPy, which is the least that the command would cost without lazy imports.

Two campaigns are run by name, each with its own empty cache:

- ``python -m benchmarks.cold_start compile``: prints CPU and wall time of all kernels, of all imports, and of the first verbs;
  with ``--peer CHECKOUT``, all kernels and the first verbs, each in turn with an older checkout, and the ratios;
- ``python -m benchmarks.cold_start saves --seeds open --count 1000``: two processes save all signatures of two versions of
  one kernel at the same time while another one loads them; prints how many loads were right, wrong, of another signature
  (mixed) or of the other version (stale), and how many entries were lost.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import multiprocessing
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from visuohaptic.core import KERNELS, KernelCache, cache_folder, kernel

from ._journal import Journal
from ._seeds import add_seeds, seeds_of
from .harness import median

REPEATS = 15

#: Argument types whose code is saved concurrently; the value identifies the signature.
ARGUMENTS = (1.0, 3, np.float32(2.0), True)
#: Constants of the two versions of the kernel; exact in single precision, too.
VERSIONS = (7.0, 11.0)
#: What must not be loaded, see :func:`saves`.
FAULTS = ("wrong", "mixed", "stale", "lost")

#: Imports every module.
_IMPORT_ALL = """
import importlib, pkgutil, visuohaptic
for module in pkgutil.walk_packages(visuohaptic.__path__, "visuohaptic."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
"""


def run() -> list[dict[str, Any]]:
    """Time both in turn, so that the machine's load is the same for both."""
    ours, peer = [], []
    script = "import sys; from visuohaptic.cli.main import main; sys.exit(main(['--help']))"
    for _ in range(REPEATS):
        ours.append(_wall_s(script))
        peer.append(_wall_s("import numpy"))
    row = {
        "name": "visuohaptic --help",
        "ours": median(ours),
        "peer": median(peer),
        "peer_name": "python -c 'import numpy'",
        "unit": "s",
        "floor": 0.5,
        "aim": 0.25,
        "note": f"wall, median of {REPEATS}, slowest {max(ours):.3f}",
    }
    return [row]


def _wall_s(script: str) -> float:
    started_s = time.perf_counter()
    subprocess.run([sys.executable, "-c", script], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - started_s


def cold_rows() -> Iterator[tuple[str, tuple[float, float]]]:
    """What, and (CPU time, wall time) [s], of things done with an empty cache."""
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        import_s = _spent_s(["-c", _IMPORT_ALL], folder / "import")
        yield "import of every module", import_s
        assert not (folder / "import").exists(), "an import has compiled a kernel"
        yield (
            "all kernels, one process",
            _spent_s(["-m", "visuohaptic", "warmup", "--workers", "1"], folder / "one"),
        )
        yield (
            "all kernels, two processes",
            _spent_s(["-m", "visuohaptic", "warmup", "--workers", "2"], folder / "two"),
        )
        yield (
            "the same again, from the cache",
            _spent_s(["-m", "visuohaptic", "warmup", "--workers", "1"], folder / "two"),
        )
        for name, words in first_verbs(folder):
            yield name, _spent_s(["-m", "visuohaptic", *words], folder / name.replace(" ", "_"))


def peer_rows(peer: Path) -> Iterator[tuple[str, tuple[float, float], tuple[float, float]]]:
    """What, and (CPU time, wall time) [s] here and of another checkout, each with an empty cache, one after the other."""
    with tempfile.TemporaryDirectory() as text:
        for name, words in (*first_verbs(Path(text)), ("all kernels", ["warmup", "-q"])):
            own_s, peer_s = (
                _spent_s(["-m", "visuohaptic", *words], Path(text) / place.name / name, place)
                for place in (Path(__file__).parents[1], peer)
            )
            yield name, own_s, peer_s


def first_verbs(folder: Path) -> Iterator[tuple[str, list[str]]]:
    """Verbs that a new user runs first, each with an empty cache."""
    grid = folder / "room.pgm"
    cells = np.full((120, 160), 254, np.uint8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 0
    cells[40:60, 60:80] = 0
    grid.write_bytes(b"P5 160 120 255\n" + cells.tobytes())
    yaml = folder / "room.yaml"
    yaml.write_text(
        "image: room.pgm\nresolution: 0.05\norigin: [0.0, 0.0, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    yield "map inspect", ["map", "inspect", str(yaml), "-q"]
    yield "example foam", ["example", "foam", "--out", str(folder / "try"), "-q"]
    from visuohaptic.rigs.virtual_office import write_office_example

    office = write_office_example(folder / "office")
    files = [
        str(office / "office.yaml"),
        "--objects",
        str(office / "objects.yaml"),
        "--robot",
        str(office / "robot.yaml"),
    ]
    yield "plan", ["plan", *files, "--start", "1.5", "0.9", "--goal", "2.45", "1.5", "-q"]


def _spent_s(words: Sequence[str], cache: Path, checkout: Path | None = None) -> tuple[float, float]:
    """CPU time of a process and of those it starts, and wall time [s]; of another checkout if one is given."""
    environment = {**os.environ, "VISUOHAPTIC_CACHE_DIR": str(cache), "NUMBA_CACHE_DIR": str(cache)}
    if checkout:
        environment["PYTHONPATH"] = str(checkout / "src")
    before, started_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([sys.executable, *words], env=environment, check=True, stdout=subprocess.DEVNULL)
    after, wall_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - started_s
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall_s


def _scaled(offset: float) -> Any:
    """A dispatcher of one version of a function, as a new process has it; ``offset`` is what an update changed."""

    @kernel
    def scaled(x):
        return x / 2 + offset

    KERNELS.remove(scaled)
    return scaled


def _save(folder: str, seeds: Sequence[int], own: int, start: Any, end: Any) -> None:
    """One writer: at each start it saves all versions and signatures, in random order and with random pauses."""
    os.environ["VISUOHAPTIC_CACHE_DIR"] = f"{folder}/writer{own}"  # of the compilation
    entries = []
    for offset in VERSIONS:
        function = _scaled(offset)
        for value in ARGUMENTS:
            function(value)
        entries += [(KernelCache(_scaled(offset)), *one) for one in function.overloads.items()]
    os.environ["VISUOHAPTIC_CACHE_DIR"] = folder
    for seed in seeds:
        rng = np.random.default_rng((seed, own))
        start.wait()
        for which in rng.permutation(len(entries)):
            time.sleep(rng.exponential(2e-4))
            cache, *entry = entries[which]
            cache.save_overload(*entry)
        end.wait()


def saves(seeds: Sequence[int], folder: Path, writers: int = 2) -> Iterator[tuple[int, Counter[str]]]:
    """Save from several processes at once, and load meanwhile and afterwards; (seed, what was loaded) of each round.

    The counts are those of :func:`_loads`; ``lost`` are entries that are absent when all writers have finished.
    """
    context = multiprocessing.get_context("spawn")
    start, end = context.Barrier(writers + 1), context.Barrier(writers + 1)
    others = [
        context.Process(target=_save, args=(str(folder), seeds, own, start, end), daemon=True)
        for own in range(writers)
    ]
    for other in others:
        other.start()
    with contextlib.ExitStack() as stack:
        for other in others:
            stack.callback(other.kill)
        before = os.environ.get("VISUOHAPTIC_CACHE_DIR")
        os.environ["VISUOHAPTIC_CACHE_DIR"] = str(folder)
        stack.callback(_restore, before)
        # Loaded code is never unloaded, and each load is slower than the one before: the readers are replaced.
        forked = "fork" in multiprocessing.get_all_start_methods()
        readers = multiprocessing.get_context("fork" if forked else "spawn").Pool(1, maxtasksperchild=20)
        stack.callback(readers.terminate)
        for seed in seeds:
            for path in (cache_folder() or folder).glob("*"):
                path.unlink()
            start.wait(timeout=600)
            found = readers.apply(_loads)
            end.wait(timeout=600)
            after = readers.apply(_loads)
            after["lost"] = len(VERSIONS) * len(ARGUMENTS) - after.total()
            yield seed, found + after
        for other in others:
            other.join(timeout=60)


def _restore(before: str | None) -> None:
    os.environ.pop("VISUOHAPTIC_CACHE_DIR")
    if before is not None:
        os.environ["VISUOHAPTIC_CACHE_DIR"] = before


def _loads() -> Counter[str]:
    """How many entries in the cache are ``right``, ``mixed`` (another signature), ``stale`` (another version) or ``wrong``."""
    import numba

    found: Counter[str] = Counter()
    for offset in VERSIONS:
        for value in ARGUMENTS:
            function, arguments = _scaled(offset), (numba.typeof(value),)
            entry = function._cache.load_overload(arguments, function.targetctx)
            if entry is None:
                continue
            if tuple(entry.signature.args) != arguments:
                found["mixed"] += 1
                continue
            given = entry.entry_point(value) - value / 2
            found["right" if given == offset else "stale" if given in VERSIONS else "wrong"] += 1
    return found


def main() -> int:
    """Run one of the campaigns and print its rows."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("what", choices=("compile", "saves"))
    add_seeds(parser, 1000, "rounds of saves")
    parser.add_argument(
        "--report", type=Path, help="JSON lines, one per row; a campaign that was stopped goes on"
    )
    parser.add_argument("--peer", type=Path, help="compile: another checkout, whose times are compared")
    args = parser.parse_args()
    if args.peer:
        for name, own_s, peer_s in peer_rows(args.peer.resolve(strict=True)):
            ratios = ", ".join(
                f"{own:.1f} s {clock}, peer {peer:.1f}, ratio {own / peer:.2f}"
                for clock, own, peer in zip(("CPU", "wall"), own_s, peer_s, strict=True)
            )
            print(f"{name:<16}{ratios}", flush=True)
        return 0
    if args.what == "compile":
        for name, (cpu_s, wall_s) in cold_rows():
            print(f"{name:<36}{cpu_s:8.1f} s CPU,{wall_s:8.1f} s wall", flush=True)
        return 0
    journal = Journal(args.report, {"campaign": "saves", "seeds": args.seeds})
    seeds = [seed for seed in seeds_of(args.seeds, args.count, args.first) if str(seed) not in journal]
    # By its name as a module: the kernel's entries carry it, and the writers do not know it as ``__main__``.
    module = importlib.import_module("benchmarks.cold_start")
    with tempfile.TemporaryDirectory() as folder:
        for seed, found in module.saves(seeds, Path(folder)):
            journal.put(str(seed), found)
    total = sum(map(Counter, journal.rows.values()), Counter())
    print(
        f"{len(journal.rows)} rounds, two processes, {len(VERSIONS)} versions of {len(ARGUMENTS)} signatures: ",
        end="",
    )
    print(f"{total['right']} loads right, " + ", ".join(f"{total[what]} {what}" for what in FAULTS))
    return 1 if any(total[what] for what in FAULTS) else 0


if __name__ == "__main__":
    sys.exit(main())
