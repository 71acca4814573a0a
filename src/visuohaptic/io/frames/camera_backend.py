"""What a driver of a live camera offers, and the settings it takes."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import UInt8

__all__ = ["CameraBackend", "CameraSettings", "FoundCamera", "time_s"]


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """Settings of a live camera; ``None`` leaves a property as it is."""

    width: int | None = None  #: [px]
    height: int | None = None  #: [px]
    rate_Hz: float | None = None
    exposure_s: float | None = None  #: fixed exposure time; automatic exposure is switched off
    focus: float | None = None  #: fixed focus in the camera's own steps; autofocus is switched off
    grey: bool = False


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A camera that is connected."""

    address: str  #: what :func:`visuohaptic.io.frames.open_source` takes
    name: str
    uid: str


class CameraBackend(Protocol):
    """What a driver must offer."""

    def open(self) -> None:
        """Open the device and set its properties; :class:`DeviceError` if it is not there."""

    def read(self) -> tuple[UInt8[np.ndarray, "rows columns *colour"], float]:
        """Wait for the next image; returns it with its time [s]. :class:`DeviceError` when it is lost."""

    def close(self) -> None:
        """Release the device; harmless when repeated."""


def time_s() -> float:
    """Seconds since the epoch that never jump: the steady clock, set once by the wall clock."""
    return _EPOCH_S + time.monotonic()


_EPOCH_S = time.time() - time.monotonic()
