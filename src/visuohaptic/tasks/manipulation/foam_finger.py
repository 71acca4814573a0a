"""Adapters from the foam sensor of a finger to the touch readings of hand tasks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core import ForceProfile, Frame, Gripper, InputError, Reason
from ...sensing.foam import FingerReading, FingerSensor, FoamSensor


@dataclass(frozen=True, slots=True)
class FoamTouch:
    """A :class:`~visuohaptic.core.robots.FingerTouch` of one frame."""

    valid: bool
    force_N: float  #: infinite if the foam is saturated
    force_sigma_N: float
    #: position of the touched surface from the centre between the fingers; NaN without contact
    surface_m: float


class FoamFinger:
    """Measures force and position of the touched surface; for ``Hand.feel``.

    The position is that of the foam contour in the fixed frame: the position of the finger from the reference
    contour, plus the deflection. The drive of the gripper is not used.

    Parameters
    ----------
    sensor
        Sensor with its zero reference.
    middle_m
        Coordinate of the centre between the fingers along the closing direction, in frame F at position 0 [m]:
        that of the undeformed front plus half the opening of the gripper.

    Raises
    ------
    InputError
        ``middle_m`` is not finite.

    Examples
    --------
    >>> hand = Hand(arm, gripper, camera, FoamFinger(sensor, middle_m=0.065))  # doctest: +SKIP
    """

    def __init__(self, sensor: FingerSensor, middle_m: float) -> None:
        if not math.isfinite(middle_m):
            raise InputError(
                "FoamFinger", f"found {middle_m}, expected a finite coordinate", field="middle_m"
            )
        self.sensor, self.middle_m = sensor, middle_m
        axis = np.asarray(sensor.axis_foam[:2], dtype=np.float64)
        outward = np.mean(np.atleast_2d(sensor.setup.geometry.outward), axis=0)
        #: closing direction, unit vector in the x-y plane of frame F
        self.closing = axis / np.linalg.norm(axis) * (1.0 if float(axis @ outward) > 0.0 else -1.0)

    def __call__(self, frame: Frame) -> FoamTouch:
        """Read one frame.

        Parameters
        ----------
        frame
            Frame of the camera that looks at the finger.
        """
        return self.touch(self.sensor.read_finger(frame))

    def touch(self, reading: FingerReading) -> FoamTouch:
        """Force and position of the surface from a reading.

        Parameters
        ----------
        reading
            Reading of the finger's sensor.
        """
        valid = bool(reading.profile.valid and reading.finger.valid)
        return _touch(reading.profile, valid, self.middle_m - reading.contour_m @ self.closing)


class FoamFingerOnDrive:
    """Measures force and position of the touched surface with a camera mounted on the finger; for ``Hand.feel``.

    The position is that of the undeformed front from the drive of the gripper, plus the deflection of the foam.

    Parameters
    ----------
    sensor
        Sensor with its zero reference.
    gripper
        Its opening is the distance between the undeformed fronts of both fingers.

    Examples
    --------
    >>> hand = Hand(arm, gripper, camera, FoamFingerOnDrive(sensor, gripper))  # doctest: +SKIP
    """

    def __init__(self, sensor: FoamSensor, gripper: Gripper) -> None:
        self.sensor, self.gripper = sensor, gripper

    def __call__(self, frame: Frame) -> FoamTouch:
        """Read one frame.

        Parameters
        ----------
        frame
            Of the camera on the finger.
        """
        profile = self.sensor.read(frame)
        return _touch(profile, profile.valid, 0.5 * self.gripper.state().opening_m + profile.delta_m)


def _touch(profile: ForceProfile, valid: bool, surface_m: Float[np.ndarray, "K"]) -> FoamTouch:
    """Touch with the surface position at the most deflected point; ``surface_m`` is the position of the foam's front."""
    contact, furthest_m = profile.max_contact, math.nan
    if valid and contact is not None:
        inside = (profile.s_m >= contact.s_start_m) & (profile.s_m <= contact.s_end_m)
        if np.isfinite(surface_m[inside]).any():
            furthest_m = float(np.nanmax(surface_m[inside]))
    force_N = math.inf if profile.reason is Reason.SATURATED else float(profile.force_N)
    return FoamTouch(bool(valid), force_N, float(profile.force_sigma_N), furthest_m)
