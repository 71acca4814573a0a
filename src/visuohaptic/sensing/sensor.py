"""Interface common to all sensors of this package, so that one loop from source to sinks drives any of them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

from ..core import Camera, Frame, InputError, Reason, load_yaml

_KINDS = ("foam", "beam", "scene")


@runtime_checkable
class Measurement(Protocol):
    """Fields common to the measurements of all sensors."""

    @property
    def t_s(self) -> float:
        """Time of the frame [s]."""

    @property
    def valid(self) -> bool:
        """Whether the measurement is valid."""

    @property
    def reason(self) -> Reason:
        """Why it is invalid; ``ok`` if valid."""


Reading = TypeVar("Reading", bound=Measurement, covariant=True)


@runtime_checkable
class Sensor(Protocol[Reading]):
    """A camera-based sensor: foam strip, foam on a finger, bending beam, or the scene ahead."""

    @property
    def camera(self) -> Camera:
        """Model of the camera that records the frames."""

    @property
    def zeroed(self) -> bool:
        """Whether the sensor has its zero reference, or needs none."""

    def zero(self, frames: Iterable[Frame]) -> Any:
        """Record the zero reference from frames without contact; the result has ``save(path)``.

        Parameters
        ----------
        frames
            Frames of the unloaded sensor.
        """

    def read(self, frame: Frame) -> Reading:
        """Measure in one frame.

        Parameters
        ----------
        frame
            The next frame in order of time.
        """

    def reset(self) -> None:
        """Reset the state between frames, before another recording; the zero reference is kept."""

    def close(self) -> None:
        """Release threads; may be called repeatedly."""


def load_sensor(path: Path | str, *, threaded: bool = False) -> Sensor[Any]:
    """Load the sensor described by a YAML file, with its zero reference if there is one.

    Parameters
    ----------
    path
        ``sensor.yaml`` or ``scene.yaml``; its field ``kind`` is ``foam`` (the default), ``beam`` or ``scene``.
    threaded
        Whether lost templates are searched in a thread, so that a frame never waits (live use of a beam).

    Returns
    -------
    Sensor
        :class:`~visuohaptic.sensing.foam.FoamSensor`, its variant on a finger,
        :class:`~visuohaptic.sensing.beam.TrackedBeam` or :class:`~visuohaptic.sensing.scene.SceneSensor`.

    Raises
    ------
    InputError
        The file, or a file that it refers to, is invalid.
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

        return SceneSensor.load(path)
    raise InputError(path, f"found {str(kind)[:40]!r}, expected one of {', '.join(_KINDS)}", field="kind")
