"""The gripper variant: the strip rides on a finger, the reference contour shows where the finger is.

Alt 2016, Sec. 3.3 and 3.6.4.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...core.camera.frame import Frame
from ...core.errors import CalibrationError, InputError
from ...core.measurement import ForceProfile, Reason
from .sensor import FoamSensor
from .strip.config import FoamSensorConfig, FoamSetup
from .strip.finger_optics import FingerOptics, FingerPosition
from .strip.zero import ZeroReference

__all__ = ["FingerReading", "FingerSensor", "load_foam_sensor"]

#: A finger that moves by more than this while it is zeroed does not stand still [m].
_STILL_M = 2e-4


@dataclass(frozen=True, slots=True, eq=False)
class FingerReading:
    """Force profile and position of the finger from one frame."""

    profile: ForceProfile
    finger: FingerPosition
    #: Front contour in the fixed frame (frame F at position 0), NaN where it was not seen.
    contour_m: Float[np.ndarray, "K 2"]

    @property
    def t_s(self) -> float:
        """Time of the frame [s]."""
        return self.profile.t_s

    @property
    def valid(self) -> bool:
        """Whether force and position can be trusted."""
        return self.profile.valid and self.finger.valid

    @property
    def reason(self) -> Reason:
        """Why not; that of the force first."""
        return self.profile.reason if not self.profile.valid or self.finger.valid else Reason.LOST


class FingerSensor(FoamSensor):
    """A foam sensor on a finger that moves along a line in front of a fixed camera.

    The initial position comes from an AprilTag on the finger (or is that of
    ``T_camera_foam`` without a tag); from then on the reference contour is followed
    from frame to frame. The tag is searched again when the contour is lost, and compared
    with it once in a while. A camera that turns or shifts across the axis makes frames invalid
    (``moved``); a shift along the axis cannot be distinguished from a motion of the finger.

    Parameters
    ----------
    setup
        Configuration with a section ``finger``, and all that it names.
    zero
        The strip at rest; without it every frame is ``not_zeroed``.

    Examples
    --------
    With a gripper and ``sensor.yaml`` it is ``FingerSensor.load("sensor.yaml")``; here both are simulated:

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
        """Where the finger was in the last frame."""
        return self.optics.position

    def zero(self, frames: Iterable[Frame], *, limit: int = 60) -> ZeroReference:
        """Take the zero reference while nothing touches the strip and the finger stands still.

        Raises
        ------
        CalibrationError
            The contours were not found, or finger or strip moved meanwhile.
        """
        seen: list[float] = []

        def watched() -> Iterator[Frame]:
            for frame in frames:
                yield frame
                if self.finger.valid:
                    seen.append(self.finger.position_m)
                    # A finger that stands still has its lines in one place: where the first frame has it.
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
            The next frame in order of time.
        """
        profile = self.read(frame)
        geometry = self.setup.geometry
        front = geometry.front_m - profile.delta_m[:, None] * geometry.outward
        return FingerReading(profile, self.finger, front + self.finger.position_m * self.axis_foam[:2])


def load_foam_sensor(path: Path | str) -> FoamSensor:
    """The foam sensor that ``sensor.yaml`` describes, with its zero reference if there is one.

    Parameters
    ----------
    path
        The file; those that it names are relative to its folder.

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
