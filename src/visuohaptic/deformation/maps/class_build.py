"""Data sets of container classes: maps and features of many variants, resumable (Alt 2016, Sec. 6.4.1).

A job is (class, variant, seed) with its settings; its result depends on nothing else. Results are
written atomically, so an interrupted build resumes where it stopped and ends with the same content
hash as an uninterrupted one.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..._version import __version__
from ...core.errors import InputError, VisuohapticError
from ...core.files import atomic_path, lock, read_npz, write_text
from ...core.map_tasks import map_tasks
from ...core.objects import HEIGHTS
from ..nonlinear.contents import Contents
from ..shapes.mesher import ShellObject, mesh_container
from .build_plan import BUILD_FORMAT, BuildJob
from .confidence_band import object_map
from .curve_features import nonlinear_features
from .features import StiffnessFeatures, linear_features

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class BuildReport:
    """Result of a build."""

    objects: int
    computed: int  #: the others existed already
    failed: tuple[tuple[str, str], ...]  #: file and reason
    content_sha256: str  #: hash of all arrays of all objects


def compute(job: BuildJob) -> tuple[bytes, str]:
    """Compute map and features of one object.

    Parameters
    ----------
    job
        A job of :func:`.plan_jobs`.

    Returns
    -------
    tuple
        The bytes of an NPZ file and an empty string; or empty bytes and the reason of the failure.
    """
    try:
        shell = mesh_container(job.description(), around=job.around)
        found = object_map(shell, band=job.band)
        coarse = None
        if job.curve_around:
            coarse = mesh_container(job.description(), around=job.curve_around, levels=HEIGHTS)
        grids = [
            _features(job, shell, coarse, Contents(closed=closed, fill=fill)) for closed, fill in job.states
        ]
    except VisuohapticError as error:
        return b"", str(error)
    reached: dict[str, Any] = {}
    if coarse is not None:
        reached["curve_reached"] = np.array([grid.reached for grid in grids])
    out = io.BytesIO()
    np.savez_compressed(
        out,
        vertices_m=found.vertices_m,
        faces=found.faces,
        stiffness_N_per_m=found.stiffness_N_per_m,
        stiffness_sigma_N_per_m=found.stiffness_sigma_N_per_m,
        features=np.stack([grid.values for grid in grids]),
        features_valid=np.stack([grid.valid for grid in grids]),
        features_reason=np.stack([grid.reason.astype(np.str_) for grid in grids]),
        feature_points_m=grids[0].points_m,
        **reached,
        states=np.array(job.states, dtype=float),
        container=np.array(job.container),
        key=np.array(job.key),
    )
    return out.getvalue(), ""


def _features(
    job: BuildJob, shell: ShellObject, coarse: ShellObject | None, contents: Contents
) -> StiffnessFeatures:
    if coarse is None:
        return linear_features(shell, contents)
    return nonlinear_features(shell, contents, heights=job.curve_heights, fill_in=True, coarse=coarse)


def build(
    jobs: Sequence[BuildJob],
    folder: Path | str,
    *,
    workers: int | str = 1,
    progress: Callable[[int, int], None] | None = None,
) -> BuildReport:
    """Compute missing results and write the manifest.

    Parameters
    ----------
    jobs
        See :func:`plan_jobs`.
    folder
        Created if it does not exist; results of the same jobs in it are kept.
    workers
        See :func:`.map_tasks`.
    progress
        Called with the number of finished jobs and the total.
    """
    folder = Path(folder)
    try:
        for name in {job.name for job in jobs}:
            (folder / name).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(folder, f"cannot create it ({error.strerror})") from error
    with _locked(folder):
        for part in folder.glob("*/.*.part.npz"):
            part.unlink(missing_ok=True)  # left over from an interrupted build
        digests = {job.file: digest for job in jobs if (digest := _existing(folder / job.file, job.key))}
        missing = [job for job in jobs if job.file not in digests]
        failed: dict[str, str] = {}
        done = len(digests)
        if progress:
            progress(done, len(jobs))
        results = map_tasks(compute, missing, name="objects build", workers=workers)
        for number, (data, reason) in results:
            job = missing[number]
            if reason:
                failed[job.file] = reason
                _log.warning("%s: %s", job.file, reason)
            else:
                with atomic_path(folder / job.file) as temporary:
                    temporary.write_bytes(data)
                digests[job.file] = _digest(read_npz(folder / job.file, "a result of objects build"))
            done += 1
            if progress:
                progress(done, len(jobs))
        total = hashlib.sha256()
        for job in jobs:
            total.update(f"{job.file} {digests.get(job.file, 'failed')}\n".encode())
        report = BuildReport(
            len(digests), len(missing) - len(failed), tuple(sorted(failed.items())), total.hexdigest()
        )
        write_text(folder / "manifest.json", json.dumps(_manifest(jobs, digests, report), indent=1) + "\n")
    return report


def _existing(path: Path, key: str) -> str:
    """Digest of a result file if it exists and is complete, else an empty string."""
    if not path.is_file():
        return ""
    try:
        data = read_npz(path, "a result of objects build", names=("key",))
        return _digest(data) if str(data["key"]) == key else ""
    except InputError:
        _log.warning("%s is damaged and computed again", path)
        return ""


def _digest(data: Mapping[str, np.ndarray]) -> str:
    """Digest of names, types, shapes and values; independent of the compression of the file."""
    out = hashlib.sha256()
    for name, values in sorted(data.items()):
        out.update(f"{name} {values.dtype.str} {values.shape}\n".encode())
        out.update(np.ascontiguousarray(values).tobytes())
    return out.hexdigest()


def _manifest(jobs: Sequence[BuildJob], digests: dict[str, str], report: BuildReport) -> dict[str, Any]:
    from importlib.metadata import version

    return {
        "format": BUILD_FORMAT,
        "versions": {
            "visuohaptic": __version__,
            "python": platform.python_version(),
            **{name: version(name) for name in ("numpy", "scipy", "numba")},
        },
        "machine": platform.machine(),
        "content_sha256": report.content_sha256,
        "failed": dict(report.failed),
        "objects": [
            {
                "file": job.file,
                "class": job.name,
                "variant": job.variant,
                "seed": job.seed,
                "key": job.key,
                "sha256": digests[job.file],
            }
            for job in jobs
            if job.file in digests
        ],
    }


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Allow only one build at a time in a folder; the lock is released when the process ends."""
    with (folder / ".lock").open("w") as handle:
        try:
            lock(handle)
        except OSError as error:
            raise InputError(folder, "another build is running in this folder") from error
        yield
