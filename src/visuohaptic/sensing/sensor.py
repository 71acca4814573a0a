"""What every sensor of this package offers, so that one loop from source to sinks drives all of them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np

from ..core.camera.frame import Frame
from ..core.camera.model import Camera
from ..core.errors import InputError
from ..core.files import load_yaml
from ..core.measurement import Reason

__all__ = ["Measurement", "Sensor", "load_sensor"]

_KINDS = ("foam", "beam", "scene")


@runtime_checkable
class Measurement(Protocol):
    """What the reading of any sensor says at least."""

    @property
    def t_s(self) -> float:
        """Time of the frame [s]."""

    @property
    def valid(self) -> bool:
        """Whether it can be trusted."""

    @property
    def reason(self) -> Reason:
        """Why not; ``ok`` when valid."""


Reading = TypeVar("Reading", bound=Measurement, covariant=True)


@runtime_checkable
class Sensor(Protocol[Reading]):
    """A camera that measures: foam strip, foam on a finger, bending beam, or the scene ahead."""

    @property
    def camera(self) -> Camera:
        """Model of the camera whose frames it reads."""

    @property
    def zeroed(self) -> bool:
        """Whether it has the zero reference that it needs."""

    def zero(self, frames: Iterable[Frame]) -> Any:
        """Take the zero reference from frames of a sensor that nothing touches; the result has ``save(path)``.

        Parameters
        ----------
        frames
            Frames of the untouched sensor.
        """

    def read(self, frame: Frame) -> Reading:
        """Measure in one frame; frames are given in the order of their times.

        Parameters
        ----------
        frame
            The next frame in order of time.
        """

    def reset(self) -> None:
        """Forget all frames, before those of another recording; the zero reference stays."""

    def close(self) -> None:
        """Release threads; harmless when repeated."""


def load_sensor(
    path: Path | str, *, threaded: bool = False, rng: np.random.Generator | None = None
) -> Sensor[Any]:
    """The sensor that a YAML file describes, with its zero reference if there is one.

    Parameters
    ----------
    path
        ``sensor.yaml`` or ``scene.yaml``; its field ``kind`` is ``foam`` (the default), ``beam`` or ``scene``.
    threaded
        Look for lost templates in a thread, so that a frame never waits (live use of a beam).
    rng
        Random samples of the scene's consensus; a fixed seed without.

    Returns
    -------
    Sensor
        :class:`~visuohaptic.sensing.foam.FoamSensor`, its variant on a finger,
        :class:`~visuohaptic.sensing.beam.TrackedBeam` or :class:`~visuohaptic.sensing.scene.SceneSensor`.

    Raises
    ------
    InputError
        The file, or one that it names, cannot be used.
    """
    data = load_yaml(path)
    kind = data.get("kind", "foam") if isinstance(data, dict) else "foam"
    if kind == "foam":
        from .foam.finger import load_foam_sensor

        return load_foam_sensor(path)
    if kind == "beam":
        from .beam.tracked import TrackedBeam

        return TrackedBeam.load(path, threaded=threaded)
    if kind == "scene":
        from .scene.scene_file import SceneSensor

        return SceneSensor.load(path, rng=rng)
    raise InputError(path, f"found {str(kind)[:40]!r}, expected one of {', '.join(_KINDS)}", field="kind")
