"""Gripper variant of the foam sensor: the strip is mounted on a finger, whose position follows from the reference contour.

Alt 2016, Sec. 3.3 and 3.6.4.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...core import CalibrationError, ForceProfile, Frame, InputError, Reason
from .sensor import FoamSensor
from .strip import FingerOptics, FingerPosition, FoamSensorConfig, FoamSetup, ZeroReference

#: Largest motion of a finger at standstill during zeroing [m].
_STILL_M = 2e-4


@dataclass(frozen=True, slots=True, eq=False)
class FingerReading:
    """Force profile and position of the finger from one frame."""

    profile: ForceProfile
    finger: FingerPosition
    #: Front contour in the fixed frame (frame F at position 0), NaN where it was not observed.
    contour_m: Float[np.ndarray, "K 2"]

    @property
    def t_s(self) -> float:
        """Time of the frame [s]."""
        return self.profile.t_s

    @property
    def valid(self) -> bool:
        """Whether force and position are valid."""
        return self.profile.valid and self.finger.valid

    @property
    def reason(self) -> Reason:
        """Why the reading is not valid; the reason of the force has priority."""
        return self.profile.reason if not self.profile.valid or self.finger.valid else Reason.LOST


class FingerSensor(FoamSensor):
    """A foam sensor on a finger that moves along a line in front of a fixed camera.

    The initial position is that of an AprilTag on the finger (without a tag, that of
    ``T_camera_foam``); from then on the reference contour is tracked
    from frame to frame. The tag is detected again when the contour is lost, and periodically
    compared with it. A camera that rotates or shifts across the axis makes frames invalid
    (``moved``); a shift along the axis cannot be distinguished from a motion of the finger.

    Parameters
    ----------
    setup
        Configuration with a section ``finger``, and all files that it names.
    zero
        The strip at rest; without it the reason of every frame is ``not_zeroed``.

    Examples
    --------
    With a real gripper and ``sensor.yaml``, use ``FingerSensor.load("sensor.yaml")``; here both are simulated:

    >>> from visuohaptic.rigs import GripperSensor
    >>> virtual, rng = GripperSensor(stripe=False), np.random.default_rng(0)
    >>> sensor = virtual.build(".", rng, zero_frames=5)
    >>> reading = sensor.read_finger(virtual.gripper(rng=rng).frame())
    >>> reading.finger.valid, abs(reading.finger.position_m) < 1e-4
    (True, True)
    """

    optics: FingerOptics

    def __init__(self, setup: FoamSetup, zero: ZeroReference | None = None) -> None:
        if setup.config.finger is None:
            raise InputError("FingerSensor", "the configuration has no section 'finger'", field="finger")
        super().__init__(setup, zero)
        axis = np.asarray(setup.config.finger.axis_foam, dtype=np.float64)
        self.axis_foam: Float[np.ndarray, "3"] = axis / np.linalg.norm(axis)  #: direction of motion, frame F

    def _make_optics(self) -> FingerOptics:
        return FingerOptics(self.setup)

    @property
    def finger(self) -> FingerPosition:
        """Position of the finger in the last frame."""
        return self.optics.position

    def zero(self, frames: Iterable[Frame], *, limit: int = 60) -> ZeroReference:
        """Take the zero reference while nothing touches the strip and the finger is at rest.

        Raises
        ------
        CalibrationError
            The contours were not found, or finger or strip moved during zeroing.
        """
        seen: list[float] = []

        def watched() -> Iterator[Frame]:
            for frame in frames:
                yield frame
                if self.finger.valid:
                    seen.append(self.finger.position_m)
                    # While the finger is at rest, the lines stay where the first frame placed them.
                    self.optics.hold()

        try:
            zero = super().zero(watched(), limit=limit)
        finally:
            self.optics.release()
        moved = max(seen, default=0.0) - min(seen, default=0.0)
        if moved > _STILL_M:
            self._watch = None
            raise CalibrationError(
                "zero",
                f"the finger moved by {1e3 * moved:.2f} mm, expected less than {1e3 * _STILL_M:.1f} mm",
                remedy="zero while the finger stands still",
            )
        return zero

    def read_finger(self, frame: Frame) -> FingerReading:
        """Force, position of the finger, and the contour in the fixed frame.

        Parameters
        ----------
        frame
            The next frame in chronological order.
        """
        profile = self.read(frame)
        geometry = self.setup.geometry
        front = geometry.front_m - profile.delta_m[:, None] * geometry.outward
        return FingerReading(profile, self.finger, front + self.finger.position_m * self.axis_foam[:2])


def load_foam_sensor(path: Path | str) -> FoamSensor:
    """Load the foam sensor that ``sensor.yaml`` describes, with its zero reference if there is one.

    Parameters
    ----------
    path
        The file; file names in it are relative to its folder.

    Returns
    -------
    FoamSensor
        A :class:`FingerSensor` if the file has a section ``finger``.

    Raises
    ------
    InputError
        A file or field cannot be used.
    """
    setup = FoamSensorConfig.load(path)
    return (FingerSensor if setup.config.finger is not None else FoamSensor).of_setup(setup)
