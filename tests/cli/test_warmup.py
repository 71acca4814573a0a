"""The warm-up compiles the signatures of the list, and the list contains all signatures that the library calls."""

from __future__ import annotations

import contextlib
import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.event import install_recorder

from visuohaptic.cli import _compilation
from visuohaptic.cli import main as command
from visuohaptic.cli.verbs.planning import map_inspect
from visuohaptic.cli.verbs.system import demo, warmup
from visuohaptic.core.kernels import cache

#: Warms up, runs every part, and prints the signatures that the list did not have.
COVERAGE = """
from benchmarks.kernel_signatures import PARTS
from visuohaptic.cli.main import main
from visuohaptic.core.kernels import KERNELS
assert main(["warmup", "--workers", "1", "--json"]) == 0
warm = {one: set(one.overloads) for one in KERNELS}
for part in PARTS:
    part()
for one in KERNELS:
    for arguments in set(one.overloads) - warm.get(one, set()):
        print("MISSING", one.py_func.__module__, one.py_func.__qualname__, arguments)
"""


@pytest.fixture
def one_line(tmp_path, monkeypatch):
    """A list of one small kernel, and a cache of its own."""
    path = tmp_path / "signatures.txt"
    path.write_text(
        "visuohaptic.navigation.graph.tracing._path_kernels:longer (Array(int64, 1, 'C', False, aligned=True),)\n"
    )
    monkeypatch.setattr(_compilation, "SIGNATURES", path)
    monkeypatch.setenv("VISUOHAPTIC_CACHE_DIR", str(tmp_path / "cache"))


def test_it_times_each_package_and_compiles_nothing_twice(one_line, tmp_path, capsys):
    assert command.main(["warmup", "--json"]) == 0
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    assert list(result["seconds"]) == ["visuohaptic.navigation.graph.tracing"]
    assert result["total_s"] == pytest.approx(sum(result["seconds"].values()))
    assert "compiled or read from the cache" in captured.err
    with install_recorder("numba:compile") as recorder:
        assert command.main(["warmup"]) == 0
    assert recorder.buffer == []


def test_it_removes_what_no_kernel_can_load(one_line, tmp_path, capsys):
    from visuohaptic.core import cache_folder

    folder = cache_folder()
    folder.mkdir(parents=True)
    (folder / "visuohaptic.navigation._gone.kernel-0123-4567").touch()
    assert command.main(["warmup", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["removed"] == 1


def test_a_line_without_its_kernel_is_said(monkeypatch, tmp_path, capsys):
    path = tmp_path / "signatures.txt"
    path.write_text("visuohaptic.navigation.graph._sweep_kernels:no_such_kernel (int64,)\n")
    monkeypatch.setattr(_compilation, "SIGNATURES", path)
    assert command.main(["warmup"]) == 1
    assert "no_such_kernel" in capsys.readouterr().err


#: Two small kernels of two packages.
TWO = (
    "visuohaptic.navigation.graph.tracing._path_kernels:longer (Array(int64, 1, 'C', False, aligned=True),)",
    "visuohaptic.deformation.shells._corotational_kernels:rotation_vector "
    "(Array(float64, 2, 'C', False, aligned=True), Array(float64, 1, 'C', False, aligned=True))",
)


@pytest.fixture
def two_lines(one_line):
    _compilation.SIGNATURES.write_text("\n".join(TWO) + "\n")


def test_two_processes_compile_what_one_then_loads(two_lines, capsys):
    assert command.main(["warmup", "--workers", "2", "--json"]) == 0
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    assert result["workers"] == 2
    assert list(result["seconds"]) == [
        "visuohaptic.deformation.shells",
        "visuohaptic.navigation.graph.tracing",
    ]
    assert "compiling: 2/2 (100 %)" in captured.err
    with install_recorder("numba:compile") as recorder:
        assert command.main(["warmup", "--workers", "1"]) == 0
    assert recorder.buffer == []


def test_a_package_alone_is_compiled(two_lines, capsys):
    assert command.main(["warmup", "deformation", "--json"]) == 0
    assert list(json.loads(capsys.readouterr().out)["seconds"]) == ["visuohaptic.deformation.shells"]
    for words, text in (
        (["sensing"], "found 'sensing', expected one of navigation, deformation"),
        (["--workers", "0"], "--workers/--jobs: found 0, expected 1 to 1024"),
        (["--workers", "1025"], "--workers/--jobs: found 1025, expected 1 to 1024"),
    ):
        assert command.main(["warmup", *words]) == 2
        assert text in capsys.readouterr().err


def test_a_kernel_that_another_process_does_not_find_is_said(two_lines, capsys):
    missing = TWO[0].replace(":longer", ":no_such_kernel")
    _compilation.SIGNATURES.write_text(f"{missing}\n{TWO[1]}\n")
    assert command.main(["warmup", "--workers", "2"]) == 2
    assert "unexpected AttributeError in a worker" in capsys.readouterr().err


def test_the_work_is_shared_by_whole_packages():
    lines = _compilation.SIGNATURES.read_text().splitlines()
    parts = warmup._by_package(lines)
    assert sorted(line for part in parts.values() for line in part) == sorted(lines)
    assert all(line.startswith(f"{package}.") for package, part in parts.items() for line in part)
    # The largest is first, so that it is not left alone at the end.
    first, *others = parts.values()
    assert len(first) > sorted(map(len, others))[len(others) // 2]


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("VISUOHAPTIC_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(_compilation, "available_cores", lambda: 2)


def test_kernels_are_compiled_in_the_background_where_they_are_missing(own_cache):
    from visuohaptic.core import cache_folder

    cache_folder().mkdir(parents=True)
    # Entries of other kernels do not count, however many they are.
    for number in range(1000):
        (cache_folder() / f"visuohaptic.other.kernel-{number}-0").touch()
    with _compilation.compiling_in_background(["database"]) as process:
        assert process is not None
        assert process.wait(timeout=600) == 0
    assert any(one.name.startswith("visuohaptic.database.") for one in cache_folder().iterdir())
    with _compilation.compiling_in_background(["database"]) as process:
        assert process is None


def test_one_worker_compiles_in_the_order_of_its_arguments():
    lines = _compilation.chosen_lines(["reconstruction.surfaces", "database", "reconstruction"])
    parts = list(warmup._by_package(lines, shared=False))
    assert parts[:2] == ["visuohaptic.reconstruction.surfaces", "visuohaptic.database"]
    assert len(lines) == len(set(lines))
    assert next(iter(warmup._by_package(lines))) != parts[0]


def every_name():
    return [line.partition(" ")[0].replace(":", ".") + "-0-0" for line in _compilation.signature_lines()]


def refused(*_, **__):
    raise BlockingIOError(11, "Resource temporarily unavailable")


def test_compilation_in_the_background_ends_with_its_block(own_cache, monkeypatch):
    with _compilation.compiling_in_background() as process:
        assert process.poll() is None
    assert process.returncode is not None
    for name, value in (("cached_names", every_name), ("may_be_cached", lambda: False)):
        # Shipped entries count; and where nothing is cached, it would compile in vain at each command.
        with monkeypatch.context() as patch:
            patch.setattr(cache, name, value)
            with _compilation.compiling_in_background() as process:
                assert process is None
    with monkeypatch.context() as patch:
        patch.setattr(_compilation.subprocess, "Popen", refused)
        with _compilation.compiling_in_background() as process:
            assert process is None
    monkeypatch.setattr(_compilation, "available_cores", lambda: 1)
    with _compilation.compiling_in_background() as process:
        assert process is None


def test_a_command_names_kernels_of_the_list():
    """Verbs name modules, which move; and a call from Python starts no process."""
    named = {}
    for verb in command.VERBS:
        module = command._load(verb, command.VERBS)
        if hasattr(module, "KERNELS"):
            named[verb] = module.KERNELS
            assert _compilation.chosen_lines(module.KERNELS)  # refuses unknown names
    assert {"plan", "map inspect", "sense foam", "example foam"} <= named.keys()


def test_only_the_command_compiles_in_the_background(monkeypatch, tmp_path, capsys):
    started = []

    @contextlib.contextmanager
    def recorded(packages):
        started.append(packages)
        yield

    monkeypatch.setattr(_compilation, "compiling_in_background", recorded)
    words = ["map", "inspect", str(tmp_path / "missing.yaml")]
    assert command.main(words) != 0
    assert started == []
    monkeypatch.setattr(sys, "argv", ["visuohaptic", *words])
    assert command.main() != 0
    assert started == [map_inspect.KERNELS]
    capsys.readouterr()


@pytest.mark.slow
def test_the_list_has_every_signature_of_the_parts():
    """When this fails, a kernel was added, moved or changed: ``python -m benchmarks.kernel_signatures``."""
    root = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", COVERAGE], cwd=root, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "MISSING" not in done.stdout


def test_every_line_names_a_kernel():
    for module, signatures in _compilation.read_signatures().items():
        assert module.startswith("visuohaptic."), f"{module} is not installed with the library"
        kernels = importlib.import_module(module)
        for function, _ in signatures:
            assert hasattr(kernels, function), f"{module}:{function}, see the test above"


def test_the_chapters_of_make_demo_name_packages_with_kernels():
    lines = (
        (Path(__file__).parents[2] / "Makefile").read_text(encoding="utf-8").replace("\\\n", " ").splitlines()
    )
    (named,) = (line.partition(":=")[2].split() for line in lines if line.startswith("FIRST_CHAPTERS"))
    assert named
    assert _compilation.chosen_lines(named)  # refuses unknown names
    assert not set(_compilation.chosen_lines(named)) & set(_compilation.chosen_lines(demo.LATER_CHAPTERS))
