"""Interface and settings of live camera drivers."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import UInt8


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """Settings of a live camera; ``None`` leaves a property unchanged."""

    width: int | None = None  #: [px]
    height: int | None = None  #: [px]
    rate_Hz: float | None = None
    exposure_s: float | None = None  #: fixed exposure time; automatic exposure is switched off
    focus: float | None = None  #: fixed focus in the camera's units; autofocus is switched off
    grey: bool = False


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A connected camera."""

    address: str  #: address for :func:`visuohaptic.io.frames.open_source`
    name: str
    uid: str


class CameraBackend(Protocol):
    """Interface of a driver."""

    def open(self) -> None:
        """Open the device and set its properties; :class:`DeviceError` if it does not exist."""

    def read(self) -> tuple[UInt8[np.ndarray, "rows columns *colour"], float]:
        """Wait for the next image; returns it with its time [s]. :class:`DeviceError` if the device is lost."""

    def close(self) -> None:
        """Release the device; may be called repeatedly."""


def time_s() -> float:
    """Seconds since the epoch without jumps: the monotonic clock, set once by the wall clock."""
    return _EPOCH_S + time.monotonic()


_EPOCH_S = time.time() - time.monotonic()
