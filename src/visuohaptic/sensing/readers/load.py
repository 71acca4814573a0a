"""The reader of a sensor's file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..sensor import load_sensor
from .beam_reader import BeamReader
from .foam_reader import FoamReader
from .scene_reader import SceneReader
from .sensor_reader import SensorReader


def load_reader(path: Path, name: str) -> SensorReader[Any]:
    """The reader of a sensor's file, for live use.

    Parameters
    ----------
    path
        ``sensor.yaml`` or ``scene.yaml``; see :func:`~visuohaptic.sensing.sensor.load_sensor`.
    name
        First part of its topics.

    Raises
    ------
    InputError
        The file, or one that it names, cannot be used.
    """
    from ..beam.tracked import TrackedBeam
    from ..scene.scene_file import SceneSensor

    # Frames of a live camera are read while the detector runs.
    sensor: Any = load_sensor(path, threaded=True)
    if isinstance(sensor, TrackedBeam):
        return BeamReader(sensor, name)
    if isinstance(sensor, SceneSensor):
        return SceneReader(sensor, name)
    return FoamReader(sensor, name)
