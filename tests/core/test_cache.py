"""The cache of machine code never returns code of other sources, other types or another user."""

from __future__ import annotations

import gc
import itertools
import logging
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from numba import types
from numba.core import caching, compiler, dispatcher
from numba.core.errors import TypingError
from numba.core.event import install_recorder
from numba.extending import intrinsic

from visuohaptic.core import KernelCache, cache_folder, code_digest, kernel, kernels, remove_stale

from .kernel_pack import CALL, PACK, call_pack, entries, import_pack, write_module


def test_a_second_process_compiles_nothing(pack):
    assert call_pack(pack, PYTHONHASHSEED="1") == (1011, 2)
    assert call_pack(pack, PYTHONHASHSEED="2") == (1011, 0)
    assert import_pack(pack) == (1011, 0)  # and what is imported anew here is as a process of its own
    write_module(pack, "settings", "FACTOR = 30\nNUMBERS = (1, 2)\n")
    assert import_pack(pack) == (1031, 2)
    assert call_pack(pack) == (1031, 0)


@pytest.mark.parametrize(
    ("name", "old", "new", "value"),
    [
        ("bottom", "x * FACTOR", "x * FACTOR * 2", 1021),  # a callee in another file
        ("settings", "FACTOR = 10", "FACTOR = 30", 1031),  # a constant that the callee imports
        ("settings", "(1, 2)", "(5, 2)", 1015),
        ("top", "+ 1000", "+ 2000", 2011),
        ("settings", "FACTOR = 10", "import math\nFACTOR = int(math.sqrt(16))", 1005),  # a computed one
    ],
)
def test_a_change_anywhere_below_is_seen(pack, name, old, new, value):
    assert import_pack(pack) == (1011, 2)
    text = textwrap.dedent(PACK[name])
    assert old in text
    write_module(pack, name, text.replace(old, new))
    assert import_pack(pack)[0] == value
    write_module(pack, name, text)
    assert import_pack(pack) == (1011, 0)  # the entries of before are still there


def test_an_edit_while_the_process_runs_does_not_reach_the_cache(pack):
    """The process has the old function in memory: its code must not be kept under the new text."""
    edit = "import pack.top, pathlib; p = pathlib.Path('pack/settings.py')\n"
    edit += "p.write_text(p.read_text().replace('10', '30'))\nassert pack.top.answer(1) == 1011"
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    subprocess.run([sys.executable, "-c", edit], cwd=pack, env=environment, check=True)
    assert import_pack(pack) == (1031, 2)


def test_an_edit_of_one_kernel_leaves_the_others(pack):
    import_pack(pack)
    write_module(pack, "top", PACK["top"].replace("1000", "2000"))
    assert import_pack(pack) == (2011, 1)


@pytest.mark.parametrize("damage", [b"", b"garbage", None])
def test_a_damaged_entry_is_compiled_anew(pack, folder, damage):
    import_pack(pack)
    for path in entries(folder):
        content = path.read_bytes()
        path.write_bytes(content[: len(content) // 2] if damage is None else damage)
    assert import_pack(pack) == (1011, 2)
    assert import_pack(pack) == (1011, 0)


def test_without_a_place_to_write_it_compiles(pack, tmp_path, monkeypatch):
    file = tmp_path / "file"
    file.touch()
    monkeypatch.setenv("VISUOHAPTIC_CACHE_DIR", str(file))
    assert import_pack(pack) == (1011, 2)
    for name in ("VISUOHAPTIC_CACHE_DIR", "NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(file))
    assert import_pack(pack) == (1011, 2)


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can become another user"
)
def test_a_user_without_a_name_or_home_compiles(pack, folder):
    """As in a container that is run with a number for a user."""
    script = f"import os; os.setgid(54321); os.setuid(54321)\n{CALL}"
    environment = {
        **os.environ,
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONPATH": os.pathsep.join(map(str, sys.path)),
    }
    for name in ("HOME", "VISUOHAPTIC_CACHE_DIR", "NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        environment.pop(name, None)
    # The other user cannot enter the test's folder: the modules are imported before the user changes.
    # So are the parts of numba and of Python that the first compilation imports.
    loaded = f"import sys; sys.path.insert(0, {str(pack)!r}); import numba, pack.top; numba.njit(lambda x: x + 1)(1)"
    script = f"{loaded}\n{script}"
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True)
    assert done.stdout.split() == ["1011", "2"], done.stderr
    assert not folder.exists()


def test_without_any_home_there_is_no_folder(monkeypatch):
    for name in ("VISUOHAPTIC_CACHE_DIR", "NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)  # as Python does for an unknown user
    assert cache_folder() is None


def test_the_folder_is_the_first_that_is_named(monkeypatch, tmp_path):
    names = ("VISUOHAPTIC_CACHE_DIR", "NUMBA_CACHE_DIR")
    for name in names:
        monkeypatch.setenv(name, str(tmp_path / name))
    for name in names:
        assert cache_folder().parents[1] == tmp_path / name
        monkeypatch.delenv(name)


def test_the_folder_tells_settings_of_the_compiler_apart(monkeypatch, folder):
    before = cache_folder()
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    assert cache_folder() == before
    monkeypatch.setenv("NUMBA_BOUNDSCHECK", "1")
    assert cache_folder() != before


def _seven():
    """A new dispatcher of one function, as a new process has it."""

    @kernel
    def seven(x):
        return x / 2 + 7

    kernels.KERNELS.remove(seven)
    return seven


def test_entries_are_private_and_those_of_others_are_not_loaded(folder, monkeypatch):
    _seven()(1.0)
    (entry,) = entries(folder)
    if os.name == "posix":
        assert entry.stat().st_mode & 0o777 == 0o600
        assert entry.parent.stat().st_mode & 0o777 == 0o700
        assert folder.joinpath("visuohaptic").stat().st_mode & 0o777 == 0o700
        for path in (entry, entry.parent):
            mode = path.stat().st_mode
            path.chmod(mode | 0o020)
            assert _compiles(_seven(), 1.0)
            path.chmod(mode)
        assert not _compiles(_seven(), 1.0)
        monkeypatch.setattr(os, "geteuid", lambda: entry.stat().st_uid + 1)
        assert _compiles(_seven(), 1.0)


def _compiles(function, *arguments) -> bool:
    with install_recorder("numba:compile") as events:
        assert function(*arguments) == arguments[0] / 2 + 7
    return bool(events.buffer)


def test_an_entry_under_the_name_of_another_is_not_loaded(folder):
    _seven()(1.0)
    (first,) = entries(folder)
    _seven()(np.float32(1.0))
    (second,) = (path for path in entries(folder) if path != first)
    first.write_bytes(second.read_bytes())
    assert _compiles(_seven(), 1.0)


def test_every_interleaving_of_two_writers_leaves_right_code(folder, monkeypatch):
    """Two processes save two signatures, or the same: after each step a reader finds the right code or none."""
    types = (1.0, 3)
    results = [next(iter(_compiled(value).overloads.values())) for value in types]
    signatures = [tuple(result.signature.args) for result in results]
    rounds = 0
    for pair in itertools.product(range(2), repeat=2):
        for order in set(itertools.permutations("aaabbb")):
            for path in entries(folder):
                path.unlink()
            writers = {
                name: _steps(KernelCache(_seven()), signatures[which], results[which], monkeypatch)
                for name, which in zip("ab", pair, strict=True)
            }
            for name in order:
                next(writers[name])
                for value, signature in zip(types, signatures, strict=True):
                    _check_reader(value, signature)
            assert len(entries(folder)) == len(set(pair))
            rounds += 1
    assert rounds == 4 * 20


def _compiled(value):
    function = _seven()
    function(value)
    return function


def _steps(cache, signature, result, monkeypatch):
    """Save in three steps: before the first file is made, before it is renamed, after."""
    written = []
    with monkeypatch.context() as patch:
        patch.setattr(kernels.cache, "_write", lambda path, payload: written.append((path, payload)))
        cache.save_overload(signature, result)
    ((path, payload),) = written
    yield
    waiting = []
    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", lambda *names: waiting.append(names))
        kernels.cache._write(path, payload)
    yield
    os.replace(*waiting[0])
    yield


def _check_reader(value, signature):
    function = _seven()
    found = function._cache.load_overload(signature, function.targetctx)
    if found is not None:
        assert tuple(found.signature.args) == signature
        assert found.entry_point(value) == value / 2 + 7


def test_remove_stale_keeps_what_can_be_loaded(folder, monkeypatch):
    function = _seven()
    function(1.0)
    (entry,) = entries(folder)
    stem, _, types = entry.name.split("-")
    killed = entry.parent / "tmpabc.part"
    for name in (f"{stem}-0123-{types}", "visuohaptic.gone.old.kernel-0123-4567", killed.name):
        (entry.parent / name).touch()
    os.utime(killed, (0.0, 0.0))
    unknown = entry.parent / "this.kernel-0123-4567"  # of a module that exists and was not imported
    unknown.touch()
    written_now = entry.parent / "tmpdef.part"
    written_now.touch()
    monkeypatch.setattr(kernels.cache, "KERNELS", [function])
    assert remove_stale() == 3
    assert entries(folder) == sorted([entry, unknown, written_now])


def test_a_function_that_uses_an_object_is_compiled_but_not_cached(folder, caplog):
    holder = type("Holder", (), {"__module__": "somewhere"})()

    @kernel
    def uses_an_object(x):
        if x > 1e300:
            return holder.value
        return x

    kernels.KERNELS.remove(uses_an_object)
    with caplog.at_level(logging.DEBUG, "visuohaptic.core"):
        assert code_digest(uses_an_object) is None
    assert "uses_an_object is not cached" in caplog.text


def test_a_function_as_argument_is_not_cached(folder):
    """The type of such an argument does not say what the function computes."""

    @kernel
    def applied(function, x):
        return function(x)

    kernels.KERNELS.remove(applied)
    assert applied(_seven(), 1.0) == pytest.approx(7.5)
    assert [path.name for path in entries(folder) if "applied" in path.name] == []


def test_the_digest_has_every_ingredient():
    """Each change below changes the machine code, so it must change the digest."""

    ones = np.ones(2)

    def made(constant=2.0, factor=ones, **options):
        def function(x):
            return x * constant + factor[0]

        dispatcher = kernel(**options)(function)
        kernels.KERNELS.remove(dispatcher)
        return code_digest(dispatcher)

    digests = [
        made(), made(constant=3.0), made(constant=2), made(factor=np.zeros(2)),
        made(factor=np.ones(2, np.float32)), made(fastmath=True), made(fastmath={"nsz"}),
        made(error_model="numpy"), made(nogil=True), made(parallel=True),
    ]  # fmt: skip

    def generated(constant):
        @intrinsic
        def number(context):
            def generate(context, builder, signature, arguments):
                return context.get_constant(types.float64, constant)

            return types.float64(), generate

        def function(x):
            return x * number()

        dispatcher = kernel(function)
        kernels.KERNELS.remove(dispatcher)
        return code_digest(dispatcher)

    digests += [generated(2.0), generated(3.0)]
    assert None not in digests
    assert len(set(digests)) == len(digests)
    assert (made(), generated(2.0)) == (digests[0], digests[-2])


def test_the_collector_rests_while_kernels_are_compiled(monkeypatch):
    monkeypatch.setattr(gc, "disable", lambda: states.append("rests"))
    monkeypatch.setattr(gc, "enable", lambda: states.append("collects"))
    states: list[str] = []

    @kernel
    def inner(x):
        return x + "text"

    @kernel
    def outer(x):
        return inner(x)

    try:
        with pytest.raises(TypingError):
            outer(1)
    finally:
        for one in (inner, outer):
            kernels.KERNELS.remove(one)
    assert states == ["rests", "collects"]  # once for both, and also where the code is wrong


def test_a_value_in_the_source_is_not_compiled_for_alone(folder):
    @kernel
    def callee(x):
        return x + 1

    @kernel
    def caller(n):
        total = 0
        for _ in range(n):
            total = callee(total)
        return total + callee(7)

    try:
        assert caller(5) == 13
        assert len(callee.overloads) == 1
    finally:
        for one in (callee, caller):
            kernels.KERNELS.remove(one)


def test_a_signature_is_refused():
    with pytest.raises(TypeError, match=r"found the signature 'f8\(f8\)', expected @kernel"):
        kernel("f8(f8)")


def test_numba_still_has_what_the_cache_uses():
    """Private names of numba: when this fails, look at numba.core.caching before the cache is mended."""
    assert {"load_overload", "save_overload", "flush", "cache_path"} <= set(dir(KernelCache))
    assert set(caching._Cache.__abstractmethods__) == {
        "cache_path", "load_overload", "save_overload", "enable", "disable", "flush",
    }  # fmt: skip
    assert {"_reduce", "_rebuild"} <= set(dir(compiler.CompileResult))
    assert isinstance(_seven()._cache, KernelCache)
    source = Path(dispatcher.__file__).read_text()
    assert "self._cache.load_overload(sig, self.targetctx)" in source
    assert "self._cache.save_overload(sig, cres)" in source
