"""The foam sensor of a finger as the tasks of the hand read it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core.camera.frame import Frame
from ...core.errors import InputError
from ...core.measurement import ForceProfile
from ...core.robots import Gripper
from ...sensing.foam.finger import FingerReading, FingerSensor
from ...sensing.foam.sensor import FoamSensor

__all__ = ["FoamFinger", "FoamFingerOnDrive", "FoamTouch"]


@dataclass(frozen=True, slots=True)
class FoamTouch:
    """A :class:`~visuohaptic.core.robots.FingerTouch` of one frame."""

    valid: bool
    force_N: float
    force_sigma_N: float
    surface_m: float  #: from the middle between the fingers to the touched surface; NaN without touch


class FoamFinger:
    """Reads force and place of the touched surface; to be used as ``Hand.feel``.

    The surface is where the foam's contour is in the fixed frame: the finger's position from the reference
    contour, and the deflection on top of it. No reading of the gripper's drive is used.

    Parameters
    ----------
    sensor
        With its zero reference taken.
    middle_m
        Coordinate of the middle between the fingers along the closing direction, frame F at position 0 [m]:
        the undeformed front's coordinate plus half the opening of the gripper there.

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
            Of the camera that looks at the finger.
        """
        return self.touch(self.sensor.read_finger(frame))

    def touch(self, reading: FingerReading) -> FoamTouch:
        """Force and place of the surface in a reading.

        Parameters
        ----------
        reading
            Of the finger's sensor.
        """
        valid = bool(reading.profile.valid and reading.finger.valid)
        return _touch(reading.profile, valid, self.middle_m - reading.contour_m @ self.closing)


class FoamFingerOnDrive:
    """Reads force and place of the touched surface with a camera that rides on the finger; for ``Hand.feel``.

    The surface is where the gripper's drive has the undeformed front, and as far behind it as the foam is pressed in.

    Parameters
    ----------
    sensor
        With its zero reference taken.
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
    """The foremost point of the object is where the foam is pressed back most; ``surface_m`` is where its front is."""
    contact, furthest_m = profile.max_contact, math.nan
    if valid and contact is not None:
        inside = (profile.s_m >= contact.s_start_m) & (profile.s_m <= contact.s_end_m)
        if np.isfinite(surface_m[inside]).any():
            furthest_m = float(np.nanmax(surface_m[inside]))
    return FoamTouch(bool(valid), float(profile.force_N), float(profile.force_sigma_N), furthest_m)
