"""Build ``visuohaptic-kernels``: the compiled kernels of a release, for one platform and one version of Python.

``python -m benchmarks.kernel_wheel --out dist`` compiles what ``visuohaptic warmup`` compiles, for every processor with
AVX2 and FMA, and packs it as a wheel that pins this version of the library and the versions of numba, llvmlite and
NumPy (its minor version) that were used. See ``docs/howto/release.md``.
"""

from __future__ import annotations

import argparse
import base64
import hashlib
import importlib.metadata
import os
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from visuohaptic._version import __version__

#: Prints the name of the cache folder, that of the folder in the wheel, and the entries that Python requests.
_NAMES = """
import importlib
from visuohaptic.cli._compilation import read_signatures
from visuohaptic.core import cache_folder, code_digest
from visuohaptic.core.kernels import shipped_name
print(cache_folder())
print(shipped_name())
for module, signatures in read_signatures().items():
    found = importlib.import_module(module)
    for function in dict.fromkeys(name for name, _ in signatures):
        print(f"{module}.{function}-{code_digest(getattr(found, function))}-")
"""

_INIT = '"""Compiled kernels of visuohaptic: found by ``visuohaptic.core.kernels``, nothing to import."""\n'


def main() -> int:
    """Compile, pack, and print the path of the wheel."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("dist"), help="folder of the wheel (dist)")
    parser.add_argument("--jobs", type=int, help="processes")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        wheel = build_wheel(args.out, *compiled_entries(Path(folder), args.jobs))
    print(f"{wheel}: {wheel.stat().st_size / 1e6:.1f} MB")
    return 0


def compiled_entries(folder: Path, jobs: int | None) -> tuple[str, list[Path]]:
    """Compile all kernels into an empty cache; name of the folder in the wheel, and its files."""
    settings = {"NUMBA_CPU_NAME": "x86-64-v3", "NUMBA_CPU_FEATURES": "", "VISUOHAPTIC_CACHE_DIR": str(folder)}
    kept = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    environment = {**kept, **settings}
    command = [sys.executable, "-m", "visuohaptic", "warmup", *(["--workers", str(jobs)] if jobs else [])]
    subprocess.run(command, env=environment, check=True)
    names = [sys.executable, "-c", _NAMES]
    said = subprocess.run(names, env=environment, check=True, capture_output=True, text=True).stdout
    cache, shipped, *stems = said.splitlines()
    # The kernels that only kernels call are inside the code of these.
    return shipped, [path for path in sorted(Path(cache).iterdir()) if path.name.startswith(tuple(stems))]


def build_wheel(out: Path, shipped: str, entries: list[Path]) -> Path:
    """Write a wheel with the entries (binary distribution format 1.0)."""
    tags = _platform_tags()
    name = f"visuohaptic_kernels-{__version__}"
    files = {"visuohaptic_kernels/__init__.py": _INIT.encode()}
    files.update({f"visuohaptic_kernels/{shipped}/{path.name}": path.read_bytes() for path in entries})
    files[f"{name}.dist-info/METADATA"] = _metadata().encode()
    lines = ["Wheel-Version: 1.0", "Generator: benchmarks.kernel_wheel", "Root-Is-Purelib: false"]
    lines += [f"Tag: {_python_tag()}-{tag}" for tag in tags]
    files[f"{name}.dist-info/WHEEL"] = "\n".join([*lines, ""]).encode()
    record = f"{name}.dist-info/RECORD"
    files[record] = "".join(
        [*(f"{path},{_hash(data)},{len(data)}\n" for path, data in files.items()), f"{record},,\n"]
    ).encode()
    out.mkdir(parents=True, exist_ok=True)
    wheel = out / f"{name}-{_python_tag()}-{'.'.join(tags)}.whl"
    with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for path, data in files.items():
            # A fixed time: the same files give the same wheel.
            archive.writestr(zipfile.ZipInfo(path, (2020, 1, 1, 0, 0, 0)), data, zipfile.ZIP_DEFLATED)
    return wheel


def _metadata() -> str:
    versions = {name: importlib.metadata.version(name) for name in ("numba", "llvmlite", "numpy")}
    numpy_minor = ".".join(versions["numpy"].split(".")[:2])
    needs = [
        f"visuohaptic=={__version__}",
        f"numba=={versions['numba']}",
        f"llvmlite=={versions['llvmlite']}",
        f"numpy=={numpy_minor}.*",
    ]
    lines = [
        "Metadata-Version: 2.4",
        "Name: visuohaptic-kernels",
        f"Version: {__version__}",
        "Summary: Compiled kernels of visuohaptic, for x86-64 processors with AVX2 and FMA",
        "License-Expression: Apache-2.0",
        f"Requires-Python: =={sys.version_info.major}.{sys.version_info.minor}.*",
    ]
    return "\n".join([*lines, *(f"Requires-Dist: {need}" for need in needs), ""])


def _python_tag() -> str:
    version = f"cp{sys.version_info.major}{sys.version_info.minor}"
    return f"{version}-{version}"


def _platform_tags() -> list[str]:
    """Platform tags of numba's wheel: its compiled code runs wherever numba runs."""
    text = importlib.metadata.distribution("numba").read_text("WHEEL") or ""
    return [line.rpartition("-")[2] for line in text.splitlines() if line.startswith("Tag: ")]


def _hash(data: bytes) -> str:
    digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=")
    return f"sha256={digest.decode()}"


if __name__ == "__main__":
    sys.exit(main())
