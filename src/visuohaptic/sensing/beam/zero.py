"""Zero reference of the templates, and monitoring of their drift (Alt 2016, Sec. 3.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field, FiniteFloat

from ...core import CalibrationError, InputError, Pose, load_yaml_model, save_yaml
from ...core.errors import brief_list
from ...core.geometry import so3_log
from ..config_fields import PoseSection, Section
from .observation import RelativePoses

#: Ratio of scatter during zeroing to declared sigma, above which it is motion, not noise.
MAX_SCATTER = 4.0
#: Slow drift by less than this many sigmas of a single frame, declared or measured, is included in the covariance.
MAX_CREEP = 2.5
#: A scatter below these is acceptable, independent of the declared noise [m, rad].
FINE_SCATTER = np.array([2e-5, 2e-5, 2e-5, 5e-4, 5e-4, 5e-4])


class _ZeroTemplate(PoseSection):
    name: str


class _ZeroFile(Section):
    t_s: FiniteFloat
    frames: Annotated[int, Field(ge=1)]
    templates: Annotated[list[_ZeroTemplate], Field(min_length=1, max_length=32)]
    covariance: Annotated[list[list[FiniteFloat]], Field(max_length=192)]
    #: Missing in files of older versions: the declared noise is then used unchanged.
    noise: Annotated[FiniteFloat, Field(ge=1.0)] = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class BeamZero:
    """Poses of the templates while the sensor is unloaded."""

    t_s: float  #: time of the last frame used
    frames: int
    rest: RelativePoses  #: mean poses in the reference template, and the covariance of the means
    noise: float = 1.0  #: measured over declared variance of the poses of a frame, from the scatter at rest

    @classmethod
    def from_frames(
        cls,
        t_s: float,
        frames: Sequence[RelativePoses],
        *,
        shared: Float[np.ndarray, "6 6"] | None = None,
    ) -> BeamZero:
        """Average frames of an unloaded sensor; templates missing in most frames are omitted.

        Parameters
        ----------
        t_s
            Time of the last frame [s].
        frames
            Poses of the templates in the reference template, frame by frame.
        shared
            Covariance of a reference that was the same in all frames, which averaging does not reduce.

        Raises
        ------
        CalibrationError
            No template was visible in half of the frames, or the rod moved.
        """
        if not frames:
            raise CalibrationError(
                "zero", "no frame shows the reference and a template", remedy="free the view"
            )
        counts: dict[str, int] = {}
        for frame in frames:
            for name in frame.names:
                counts[name] = counts.get(name, 0) + 1
        names = [name for name, count in counts.items() if 2 * count >= len(frames)]
        whole = [frame.select(names) for frame in frames if set(names) <= set(frame.names)]
        if not names or 2 * len(whole) < len(frames):
            seen = ", ".join(f"{name} in {count}" for name, count in counts.items()) or "none"
            raise CalibrationError(
                "zero",
                f"templates seen in too few of {len(frames)} frames: {seen}",
                remedy="make sure that nothing covers them",
            )
        means, offsets = [], []
        for k in range(len(names)):
            mean, offset = _mean_pose([frame.poses[k] for frame in whole])
            means.append(mean)
            offsets.append(offset)
        covariance = np.mean([frame.covariance for frame in whole], axis=0)
        lever = whole[-1].shared
        common = 0.0 if shared is None else lever @ shared @ lever.T
        covariance, noise = covariance - common, 1.0  # of the independent part of each frame
        scatter = np.hstack(offsets)
        if len(whole) >= 4:
            _refuse_motion(names, scatter, covariance)
            # Noise that the tracker does not declare, as from compressed video, is in the zero and in every frame.
            noise = max(1.0, float(np.mean(scatter.var(axis=0, ddof=1) / np.diag(covariance))))
            covariance = covariance * noise
            # Errors that persist for many frames, as from compressed video, are not reduced by averaging.
            wander = 0.5 * _creep(scatter)
            covariance = covariance * max(1.0, len(whole) * float(np.mean(wander**2 / np.diag(covariance))))
        mean_covariance = covariance / len(whole) + common
        return cls(t_s, len(whole), RelativePoses(tuple(names), tuple(means), mean_covariance, lever), noise)

    def save(self, path: Path | str) -> None:
        """Write as YAML, atomically.

        Parameters
        ----------
        path
            Output file.
        """
        poses = zip(self.rest.names, self.rest.poses, strict=True)
        templates = [{"name": name} | pose.fields for name, pose in poses]
        covariance = [[float(f"{value:.6g}") for value in row] for row in self.rest.covariance]
        about = {"t_s": self.t_s, "frames": self.frames, "noise": float(f"{self.noise:.6g}")}
        save_yaml(path, about | {"templates": templates, "covariance": covariance})

    @classmethod
    def load(cls, path: Path | str, names: Sequence[str]) -> BeamZero:
        """Read a file of :meth:`save`.

        Parameters
        ----------
        path
            Input file.
        names
            Templates on the sensor's rod.
        """
        data = load_yaml_model(path, _ZeroFile)
        found = [template.name for template in data.templates]
        unknown = sorted(set(found) - set(names))
        if unknown or len(set(found)) != len(found):
            raise InputError(
                path,
                f"found templates {brief_list(found)}, the sensor has {', '.join(names)}",
                field="templates",
                remedy="zero again: visuohaptic sense beam --zero",
            )
        size = 6 * len(found)
        if len(data.covariance) != size or any(len(row) != size for row in data.covariance):
            raise InputError(path, f"expected {size} x {size} numbers", field="covariance")
        covariance = np.array(data.covariance)
        covariance = 0.5 * (covariance + covariance.T)
        if np.linalg.eigvalsh(covariance).min() < -1e-6 * np.abs(covariance).max():
            raise InputError(path, "is not positive definite", field="covariance")
        poses = tuple(Pose.from_quaternion(t.quaternion_xyzw, t.translation_m) for t in data.templates)
        rest = RelativePoses(tuple(found), poses, covariance, np.zeros((size, 6)))
        return cls(data.t_s, data.frames, rest, data.noise)


def _mean_pose(poses: Sequence[Pose]) -> tuple[Pose, np.ndarray]:
    """Mean of similar poses, and the deviation (n, 6) of each."""
    rotations = np.array([pose.rotation for pose in poses])
    translations = np.array([pose.translation_m for pose in poses])
    u, _, vt = np.linalg.svd(rotations.mean(axis=0))
    mean = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    centre = translations.mean(axis=0)
    offset = np.hstack([translations - centre, so3_log(rotations @ mean.T)])
    return Pose(mean, centre), offset


def _creep(scatter: Float[np.ndarray, "frames n"]) -> Float[np.ndarray, "n"]:
    """A slow creep is not visible in the scatter of single frames, but in the means of the two halves."""
    half = len(scatter) // 2
    return np.abs(scatter[half:].mean(axis=0) - scatter[:half].mean(axis=0))


def _refuse_motion(names: Sequence[str], scatter: np.ndarray, covariance: np.ndarray) -> None:
    sigma = np.sqrt(np.diag(covariance))
    limit = np.maximum(MAX_SCATTER * sigma, np.tile(FINE_SCATTER, len(names)))
    spread = scatter.std(axis=0, ddof=1)
    creep = _creep(scatter)
    # Changes from frame to frame are undeclared noise of the tracker, as from compressed video, not creep.
    jitter = np.sqrt(0.5 * np.mean(np.diff(scatter, axis=0) ** 2, axis=0))
    allowed = np.maximum(
        max(5 * np.sqrt(4 / len(scatter)), MAX_CREEP) * np.maximum(sigma, jitter),
        np.tile(FINE_SCATTER, len(names)),
    )
    worst = int(np.argmax(np.maximum(spread / limit, creep / allowed)))
    if spread[worst] > limit[worst] or creep[worst] > allowed[worst]:
        unit, factor = ("um", 1e6) if worst % 6 < 3 else ("mdeg", 1e3 * 180 / np.pi)
        shown = (
            (spread, limit)
            if spread[worst] / limit[worst] > creep[worst] / allowed[worst]
            else (creep, allowed)
        )
        raise CalibrationError(
            "zero",
            f"template {names[worst // 6]} moved while zeroing: {factor * shown[0][worst]:.0f} "
            f"{unit}, expected below {factor * shown[1][worst]:.0f} {unit}",
            remedy="zero while nothing touches or shakes the sensor",
        )


@dataclass(frozen=True, slots=True)
class BeamDriftSettings:
    """Adaptation of the zero to slow changes while the sensor is at rest."""

    time_constant_s: float = 30.0  #: of the adaptation
    rest_s: float = 1.0  #: time of negligible load before the adaptation starts
    rest: float = 0.005  #: a load below this fraction of full scale is negligible
    limit: float = 0.02  #: accumulated drift, as a fraction of full scale, beyond which it is not valid


class BeamZeroWatch:
    """Tracks the reading at rest, and reports when the zero has drifted too far.

    A constant load below the rest threshold cannot be distinguished from drift and is
    removed within some time constants; this is the cost of a zero that follows
    the temperature.

    Parameters
    ----------
    full_scale
        Largest wrench of each axis [N, Nm].
    settings
        Adaptation of the zero to slow changes; defaults if None.
    """

    def __init__(self, full_scale: Float[np.ndarray, "6"], settings: BeamDriftSettings | None = None) -> None:
        self.settings = settings or BeamDriftSettings()
        self.full_scale = np.asarray(full_scale, dtype=np.float64)
        self.offset = np.zeros(6)  #: current reading of the unloaded sensor [N, Nm]
        self._rest_since: float | None = None
        self._last_t: float | None = None

    @property
    def drifted(self) -> bool:
        """Whether a new zero is required."""
        return bool((np.abs(self.offset) > self.settings.limit * self.full_scale).any())

    @property
    def covariance(self) -> Float[np.ndarray, "6 6"]:
        """Maximum lag of the adaptation: a tenth of the drift."""
        return np.diag((0.1 * self.offset) ** 2)

    def update(self, t_s: float, wrench: Float[np.ndarray, "6"], sigma: Float[np.ndarray, "6"]) -> None:
        """Process one reading, before the offset is subtracted.

        Parameters
        ----------
        t_s
            Time of the frame [s].
        wrench, sigma
            (F, M) at the tip and its standard deviation [N, Nm].
        """
        elapsed = 0.0 if self._last_t is None else max(0.0, t_s - self._last_t)
        self._last_t = t_s
        left = np.abs(wrench - self.offset)
        if (left > np.maximum(self.settings.rest * self.full_scale, 4 * sigma)).any():
            self._rest_since = None
            return
        if self._rest_since is None:
            self._rest_since = t_s
        if t_s - self._rest_since >= self.settings.rest_s:
            rate = min(1.0, elapsed / self.settings.time_constant_s)
            self.offset = self.offset + rate * (wrench - self.offset)
