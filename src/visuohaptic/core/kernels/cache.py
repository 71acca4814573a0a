"""Decorator for all compiled functions, with a cache of machine code that is never stale.

A *kernel* is a function that numba compiles at its first call with arguments of new types; nothing is
compiled at import. The machine code is kept in one file per signature, so that later processes
only load it. The file name contains a digest of everything that determines the machine code:

- the byte code and constants of the function *as they are in memory*, the values of the globals it uses
  (numba treats them as constants), the options of the decorator, and the same of every kernel that it calls;
- the types of the arguments;
- in the name of the folder: the versions of numba, llvmlite, NumPy and Python, the processor and its
  features, and the environment variables of numba.

The optional package ``visuohaptic-kernels`` contains the same files, compiled for all processors with AVX2 and
FMA (x86-64-v3) and every patch version of NumPy; they are used if the user's folder has none.

The digest is computed by :mod:`.code`; a function without digest is compiled, but never cached.

Files are written under a temporary name and renamed, so that a reader finds a complete file or none, and they
start with a checksum. They contain object code and are trusted like the installation itself: see ``SECURITY.md``.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
import os
import pickle
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding
import numba
import numpy as np
from numba.core import serialize, sigutils
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.registry import cpu_target
from numba.core.types import Array, Boolean, Number, Type
from numba.core.types.containers import BaseTuple
from numba.core.types.misc import NoneType

from .callees import add_overload, rebuilt, reduced
from .code import code_digest, kernel_name, text_digest
from .compiler import call_template, compile_kernel

_log = logging.getLogger(__name__)

#: Ending of a file that is being written; one that is older than an hour was left by a process that was killed.
_UNFINISHED = ".part"
_MAX_WRITE_S = 3600.0

#: All kernels of the modules imported so far, in order of definition.
KERNELS: list[Dispatcher] = []
#: Format of the entries, part of their folder's name; 2: kernels that only kernels call have no machine code.
_FORMAT = 2

#: Environment variables of numba that do not affect the machine code, or whose effect is in the folder's name.
_NO_CODE = {"NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS", "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES"}
#: Processor of the shipped machine code, and its features beyond x86-64 (System V ABI, AMD64 supplement 1.0).
SHIPPED_CPU = "x86-64-v3"
_SHIPPED_FEATURES = [
    "avx",
    "avx2",
    "bmi",
    "bmi2",
    "cx16",
    "f16c",
    "fma",
    "lzcnt",
    "movbe",
    "popcnt",
    "sse4.2",
]


def kernel(
    function: Any = None,
    /,
    *,
    fastmath: Any = False,
    parallel: Any = False,
    inline: Any = "never",
    error_model: Any = "python",
    nogil: Any = False,
) -> Any:
    """Compile a function with numba at its first call, and cache the machine code for later processes.

    Parameters
    ----------
    function
        The function, if the decorator is used without parentheses. A signature is rejected, since it would
        be compiled at import.
    fastmath, parallel, inline, error_model, nogil
        As in :func:`numba.njit`.

    Returns
    -------
    Dispatcher or decorator
        The compiled function (the function itself when ``NUMBA_DISABLE_JIT`` is set), or the decorator
        that makes it.

    Raises
    ------
    TypeError
        If a signature is given.
    """
    if function is not None and not callable(function):
        raise TypeError(
            f"found the signature {function!r}, expected @kernel or @kernel(option=value): leave it out"
        )

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher: Any = numba.njit(
            fastmath=fastmath,
            parallel=parallel,
            inline=inline,
            error_model=error_model,
            nogil=nogil,
            no_cfunc_wrapper=True,  # an entry for callers in C, of which there are none
        )(function)
        if dispatcher is not function:  # it is with NUMBA_DISABLE_JIT
            dispatcher._cache = KernelCache(dispatcher)
            dispatcher.compile = functools.partial(compile_kernel, dispatcher, dispatcher.compile)
            dispatcher.add_overload = functools.partial(add_overload, dispatcher, dispatcher.add_overload)
            dispatcher.get_call_template = functools.partial(call_template, dispatcher.get_call_template)
            KERNELS.append(dispatcher)
        return dispatcher

    return compiled if function is None else compiled(function)


class KernelCache:
    """Numba's interface to the cache: loads the machine code of a signature before compilation, and saves it afterwards.

    Parameters
    ----------
    dispatcher
        Numba's dispatcher of the kernel.
    """

    cache_path = None  # shown in numba's statistics

    def __init__(self, dispatcher: Any) -> None:
        self._dispatcher = dispatcher

    def flush(self) -> None:
        """Called by numba before it recompiles all signatures; saving then overwrites the old files."""

    def load_overload(self, sig: Any, target_context: Any) -> CompileResult | None:
        """The machine code of a signature; None if it is absent, damaged or owned by another user.

        Parameters
        ----------
        sig
            Numba's signature: types of the arguments.
        target_context
            Numba's code generator.
        """
        name = self._entry(sig)
        target_context.refresh()
        for folder, owned in ((cache_folder(), True), (_shipped_folder(), False)):
            payload = _read(folder / name, owned) if name and folder else None
            if payload is not None:
                # Numba's own format; owner and checksum of the file have been verified.
                return rebuilt(target_context, pickle.loads(payload))  # noqa: S301
        return None

    def save_overload(self, sig: Any, data: CompileResult) -> None:
        """Write the machine code of a signature; does nothing without a writable folder or for uncacheable code.

        Parameters
        ----------
        sig
            Numba's signature: types of the arguments.
        data
            Compilation result of numba.
        """
        name, folder = self._entry(sig), cache_folder()
        lifted = any(not part.can_cache for part in data.lifted)
        if name and folder and not lifted and not data.library.has_dynamic_globals:
            _write(folder / name, serialize.dumps(reduced(data)))

    def _entry(self, sig: Any) -> str | None:
        """File name of a signature; None if it is not cached."""
        code = code_digest(self._dispatcher)
        arguments, _ = sigutils.normalize_signature(sig)
        if code is None or not all(map(_is_plain, arguments)):
            _log.debug("%s%s is not cached", self._dispatcher.py_func.__qualname__, arguments)
            return None
        return f"{kernel_name(self._dispatcher)}-{code}-{text_digest(repr(arguments))}"


def cache_folder() -> Path | None:
    """Folder of this user's machine code for this processor and these versions; None without a home folder.

    It is inside ``VISUOHAPTIC_CACHE_DIR``, ``NUMBA_CACHE_DIR`` or the user's cache folder, whichever is set first.
    """
    named = os.environ.get("VISUOHAPTIC_CACHE_DIR") or os.environ.get("NUMBA_CACHE_DIR")
    if not named and sys.platform == "win32":
        named = os.environ.get("LOCALAPPDATA")
    elif not named and sys.platform == "darwin":
        named = "~/Library/Caches"
    elif not named:
        named = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    base = Path(os.path.expanduser(named or "~"))
    processor = cpu_target.target_context.codegen().magic_tuple()
    name = _environment(processor, np.__version__)
    return None if base.parts[:1] == ("~",) else base.absolute() / "visuohaptic" / name


def cached_names() -> list[str]:
    """File names of the entries of this user and of those that are shipped; of folders that can be read."""
    found: list[str] = []
    for folder in (cache_folder(), _shipped_folder()):
        with contextlib.suppress(OSError):
            found += os.listdir(folder) if folder else ()
    return found


def may_be_cached() -> bool:
    """Whether there is a folder for new entries, or can be one."""
    folder = cache_folder()
    there = next((one for one in (folder, *folder.parents) if one.exists()), None) if folder else None
    return there is not None and os.access(there, os.W_OK)


def shipped_name() -> str:
    """Folder name of shipped machine code for these versions, in the package ``visuohaptic_kernels``."""
    triple = cpu_target.target_context.codegen().magic_tuple()[0]
    return _environment((triple, SHIPPED_CPU, ""), ".".join(np.__version__.split(".")[:2]))


def _shipped_folder() -> Path | None:
    """Folder of the shipped machine code for these versions; None without the package or on another processor."""
    package = _shipped_package()
    return package / shipped_name() if package is not None else None


@functools.cache
def _shipped_package() -> Path | None:
    named = os.environ.get("NUMBA_CPU_NAME") or os.environ.get("NUMBA_CPU_FEATURES")
    found = None if named or not _runs_shipped_code() else find_spec("visuohaptic_kernels")
    return Path(found.origin).parent if found is not None and found.origin is not None else None


def remove_stale() -> int:
    """Remove the user's entries that can no longer be loaded; returns their number.

    These are entries of functions that were changed or removed, and temporary files of processes that were killed
    while writing, but not those that another process may be writing now. Entries of modules that are not imported,
    and of other versions of Python and numba, are kept.
    """
    folder = cache_folder()
    current = {f"{kernel_name(one)}-{code_digest(one)}" for one in KERNELS}
    removed = 0
    try:
        for path in sorted(folder.iterdir()) if folder else ():
            kept = path.name.rpartition("-")[0] in current or _may_be_imported(path.name)
            if not kept and not _may_be_written(path):
                path.unlink()
                removed += 1
    except OSError as error:
        _log.debug("the kernel cache is left as it is: %s", error)
    return removed


def _may_be_written(path: Path) -> bool:
    return path.suffix == _UNFINISHED and time.time() - path.stat().st_mtime < _MAX_WRITE_S


def _may_be_imported(entry: str) -> bool:
    """Whether the module of an entry exists but is not imported, so that its kernels are unknown."""
    module = entry.partition("-")[0].rpartition(".")[0]
    try:
        return bool(module) and module not in sys.modules and find_spec(module) is not None
    except ModuleNotFoundError:  # its package no longer exists
        return False


def _is_plain(kind: Type) -> bool:
    """Whether the text of a type describes it completely: numbers, arrays and tuples of them, but no functions."""
    if isinstance(kind, BaseTuple):
        return all(map(_is_plain, kind.types))
    scalar = kind.dtype if isinstance(kind, Array) else kind
    return isinstance(scalar, (Boolean, NoneType, Number))


def _runs_shipped_code() -> bool:
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return False
    return all(map(llvmlite.binding.get_host_cpu_features().get, _SHIPPED_FEATURES))


def _environment(processor: tuple[str, str, str], numpy_version: str) -> str:
    """Folder name for a processor (target, name, features), a version of NumPy, and the other versions in use."""
    versions = (numba.__version__, llvmlite.__version__, numpy_version, sys.implementation.cache_tag)
    settings = sorted(
        item for item in os.environ.items() if item[0].startswith("NUMBA_") and item[0] not in _NO_CODE
    )
    exact = repr((_FORMAT, versions, getattr(sys, "abiflags", ""), processor, settings))
    return f"kernels-numba{versions[0]}-{versions[3]}-{processor[1]}-{text_digest(exact)}"


def _read(path: Path, owned: bool) -> bytes | None:
    """Content of an entry; None if it is absent or damaged, or, with ``owned``, if another user could have written it."""
    try:
        with path.open("rb") as file:
            statuses = (os.fstat(file.fileno()), path.parent.stat())
            content = file.read()
    except OSError:
        return None
    user = os.geteuid() if owned and hasattr(os, "geteuid") else None
    if user is not None and any(one.st_uid != user or one.st_mode & 0o022 for one in statuses):
        _log.debug("%s is not loaded: another user could write it", path)
        return None
    # The checksum includes the name: a renamed entry does not match the requested one.
    if content[:32] != _checksum(path.name, content[32:]):
        _log.debug("%s is not loaded: it is damaged", path)
        return None
    return content[32:]


def _write(path: Path, payload: bytes) -> None:
    """Write an entry under a temporary name and rename it; errors of an unwritable folder are ignored."""
    temporary = None
    try:
        path.parent.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        path.parent.mkdir(exist_ok=True, mode=0o700)
        handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=_UNFINISHED)
        with os.fdopen(handle, "wb") as file:
            file.write(_checksum(path.name, payload) + payload)
        os.replace(temporary, path)
    except OSError as error:
        _log.debug("%s is not kept: %s", path.name, error)
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)


def _checksum(name: str, payload: bytes) -> bytes:
    return hashlib.sha256(name.encode() + payload).digest()
