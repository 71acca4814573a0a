"""Kernels compiled by a release are found if the user's cache lacks them; concurrent writers never mix."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from visuohaptic.core import kernels

from .kernel_pack import CALL, call_pack, import_pack, write_module

#: Prints the folder of the cache, and the name that its entries have in the package that ships them.
SHIP = """
from visuohaptic.core.kernels import cache_folder, shipped_name
print(cache_folder())
print(shipped_name())
"""


@pytest.mark.skipif(
    not kernels.cache._runs_shipped_code(), reason="compiled kernels are shipped for x86-64-v3 only"
)
def test_shipped_code_is_used_where_our_own_is_absent(pack, folder, tmp_path, monkeypatch):
    """A package made on one machine is found on another; what it lacks, and other versions, are compiled."""
    built = {"VISUOHAPTIC_CACHE_DIR": str(tmp_path / "built"), "NUMBA_CPU_NAME": kernels.SHIPPED_CPU}
    built["NUMBA_CPU_FEATURES"] = ""
    environment = {**os.environ, **built, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", CALL + SHIP],
        cwd=pack,
        env=environment,
        check=True,
        capture_output=True,
        text=True,
    )
    value, compiled, made, name = done.stdout.split()
    assert (value, compiled) == ("1011", "2")
    package = pack / "visuohaptic_kernels"
    package.mkdir()
    (package / "__init__.py").touch()
    Path(made).rename(package / name)
    assert call_pack(pack) == (1011, 0)
    assert not folder.exists()  # nothing is copied
    monkeypatch.setattr(kernels.cache, "_shipped_package", lambda: package)
    for path in (package / name).iterdir():
        path.write_bytes(path.read_bytes()[:-1])
    assert import_pack(pack) == (1011, 2)  # damaged: compiled, and kept as our own
    assert import_pack(pack) == (1011, 0)
    write_module(pack, "settings", "FACTOR = 30\nNUMBERS = (1, 2)\n")
    assert import_pack(pack) == (1031, 2)
    assert call_pack(pack, NUMBA_CPU_NAME="generic") == (1031, 2)


@pytest.mark.parametrize(
    ("machine", "features", "environment"),
    [("aarch64", True, {}), ("x86_64", False, {}), ("x86_64", True, {"NUMBA_CPU_NAME": "generic"})],
)
def test_shipped_code_is_passed_over_on_another_processor(
    monkeypatch, tmp_path, machine, features, environment
):
    (tmp_path / "visuohaptic_kernels").mkdir()
    (tmp_path / "visuohaptic_kernels" / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES"):
        monkeypatch.delenv(name, raising=False)

    def found(machine, features):
        monkeypatch.setattr("platform.machine", lambda: machine)
        present = dict.fromkeys(kernels.cache._SHIPPED_FEATURES, True) | {"fma": features}
        monkeypatch.setattr("llvmlite.binding.get_host_cpu_features", lambda: present)
        return kernels.cache._shipped_package.__wrapped__()

    assert found("x86_64", True) == tmp_path / "visuohaptic_kernels"
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert found(machine, features) is None


def test_processes_that_save_at_once_never_mix(tmp_path):
    """A slice of the campaign of ``benchmarks.cold_start``: nothing wrong is ever loaded, and nothing is lost."""
    from benchmarks.cold_start import ARGUMENTS, FAULTS, VERSIONS, saves

    rows = list(saves(range(0, 20, 2), tmp_path / "cache"))
    assert [seed for seed, _ in rows] == list(range(0, 20, 2))
    assert [found[what] for _, found in rows for what in FAULTS] == [0] * 10 * len(FAULTS)
    afterwards = len(VERSIONS) * len(ARGUMENTS) * len(rows)
    assert sum(found["right"] for _, found in rows) > afterwards  # the reader did read while they wrote


def test_the_campaign_of_saves_finds_what_is_stale_or_mixed(tmp_path, monkeypatch):
    """Entries under each other's names, as a cache that forgets the version or the signature would have them."""
    from benchmarks import cold_start

    monkeypatch.setenv("VISUOHAPTIC_CACHE_DIR", str(tmp_path))
    for offset in cold_start.VERSIONS:
        function = cold_start._scaled(offset)
        for value in cold_start.ARGUMENTS:
            function(value)
    assert cold_start._loads() == {"right": len(cold_start.VERSIONS) * len(cold_start.ARGUMENTS)}
    folder = kernels.cache_folder()
    one, other = (cold_start._scaled(offset)._cache for offset in cold_start.VERSIONS)

    def replace(name: str, source: str) -> None:
        kernels.cache._write(folder / name, kernels.cache._read(folder / source, owned=True))

    replace(one._entry((numba.float64,)), other._entry((numba.float64,)))
    replace(one._entry((numba.float32,)), one._entry((numba.int64,)))
    found = cold_start._loads()
    assert (found["stale"], found["mixed"], found["wrong"]) == (1, 1, 0)
