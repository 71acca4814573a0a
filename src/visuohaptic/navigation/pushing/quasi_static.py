"""Quasi-static motion of an object pushed by a round platform, with contact friction.

The object rests unless it is in contact and stops at once when contact is
lost: at 0.05 m/s its momentum carries it a third of a millimetre. Its motion
then follows from three principles: each support point resists its own motion
with its load times friction (Coulomb; all points together form the
exact limit surface, not an ellipsoid); the platform's rim does not penetrate the object;
and the contact force stays in its friction cone, on its edge where the rim
slips along the object. Alt 2016, Algorithm 2, has no contact friction
and uses moments of inertia in place of the floor friction; see
:mod:`~benchmarks.peers.impulse_push` for that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core import POSITIVE, InputError, check_numbers, finite_array
from ._push_kernels import CONTACT_X, FORCE_X, GAP, X, push_object
from .push_model import PushModel

#: Distance between poses of the platform (m): trajectory errors are of second order in it, 2 mm at 2 cm.
STEP_M = 0.02
#: Length before the path's end in which the contact does not count as lost (m).
RELEASE_M = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class PushTrace:
    """Motion of the object along a path of the platform."""

    platform_m: Float[np.ndarray, "k 3"]  #: x, y, heading [m, m, rad]
    object_m: Float[np.ndarray, "k 3"]  #: x, y, yaw of its reference point [m, m, rad]
    force: Float[np.ndarray, "k 2"]  #: on the object, relative to the total floor friction; 0 without contact
    contact_m: Float[np.ndarray, "k 2"]  #: contact point on the rim; NaN without contact
    last_contact: int  #: row of the last contact; -1 if there was none
    released: bool  #: touched, and contact lost before the end of the path

    @property
    def touched(self) -> bool:
        """Whether the platform touched the object at all."""
        return self.last_contact >= 0

    @property
    def moved_m(self) -> float:
        """Displacement of the reference point from its start."""
        return float(np.hypot(*(self.object_m[-1, :2] - self.object_m[0, :2])))


def simulate_push(
    model: PushModel,
    object_m: tuple[float, float, float] | Float[np.ndarray, "3"],
    path_m: Float[np.ndarray, "k 3"],
    radius_m: float,
) -> PushTrace:
    """Simulate the motion of an object pushed by a disc along a path.

    Parameters
    ----------
    model
        Outline, supports and contact friction.
    object_m
        Pose of its reference point: x, y [m], yaw [rad].
    path_m
        Poses of the platform, x, y [m], heading [rad], a few centimetres apart
        (:func:`line_path`, :func:`arc_path`). The heading matters only because
        the rim rotates with it.
    radius_m
        Radius of the platform [m].

    Raises
    ------
    InputError
        If the platform overlaps the object at the start.
    """
    start = finite_array("simulate_push", object_m, 3, field="object_m")
    path = finite_array("simulate_push", path_m, None, 3, field="path_m", least=2)
    check_numbers("simulate_push", POSITIVE, radius_m=radius_m)
    trace = np.zeros((len(path), 8))
    last = push_object(
        model.outline_m, model.round_m, model.support_m, model.load, model.gyration_m, model.tip_m,
        model.contact_friction, radius_m, path, start, trace,
    )  # fmt: skip
    if trace[0, GAP] < -1e-3:
        raise InputError(
            "simulate_push", f"the platform starts {-1e3 * trace[0, GAP]:.1f} mm inside the object's outline"
        )
    object_m, force, contact_m = trace[:, X : X + 3], trace[:, FORCE_X : FORCE_X + 2], trace[:, CONTACT_X:GAP]
    released = last >= 0 and remaining_m(path, int(last)) > RELEASE_M
    return PushTrace(path, object_m, force, contact_m, int(last), released)


def remaining_m(path_m: Float[np.ndarray, "k 3"], row: int) -> float:
    """Length of a path after one of its rows [m].

    Parameters
    ----------
    path_m
        Poses x, y [m], heading [rad], (K, 3).
    row
        Index of the row.
    """
    steps = np.diff(path_m[row:, :2], axis=0)
    return float(np.hypot(steps[:, 0], steps[:, 1]).sum())


def line_path(
    start_m: Float[np.ndarray, "2"], end_m: Float[np.ndarray, "2"], step_m: float = STEP_M
) -> Float[np.ndarray, "k 3"]:
    """Poses on a straight line, heading along it.

    Parameters
    ----------
    start_m, end_m
        x, y [m].
    step_m
        Distance between poses [m].
    """
    return arc_path(start_m, end_m, 0.0, step_m)


def arc_path(
    start_m: Float[np.ndarray, "2"], end_m: Float[np.ndarray, "2"], turn_rad: float, step_m: float = STEP_M
) -> Float[np.ndarray, "k 3"]:
    """Poses on an arc between two points.

    Parameters
    ----------
    start_m, end_m
        x, y [m].
    turn_rad
        Change of heading [rad]; left is positive, 0 is a line.
    step_m
        Distance between poses [m].

    Raises
    ------
    InputError
        Both ends are the same point, or the turn is a full circle or more.
    """
    start, end = np.asarray(start_m, dtype=np.float64), np.asarray(end_m, dtype=np.float64)
    chord = end - start
    length = float(np.hypot(chord[0], chord[1]))
    if not (np.isfinite(length) and length > 0 and abs(turn_rad) < 2 * math.pi and step_m > 0):
        raise InputError(
            "arc_path", f"found {start} to {end}, turn {turn_rad} rad, step {step_m} m; expected two points"
        )
    half = 0.5 * turn_rad
    stretch = half / math.sin(half) if abs(half) > 1e-9 else 1.0
    count = max(2, math.ceil(length * stretch / step_m - 1e-9) + 1)
    fraction = np.linspace(0.0, 1.0, count)
    along = math.atan2(chord[1], chord[0])
    heading = along - half + fraction * turn_rad
    if abs(half) > 1e-9:
        # Chords of the arc from its start: length sin(part) / sin(half), direction half way.
        reach = length * np.sin(fraction * half) / math.sin(half)
        direction = along - half + fraction * half
    else:
        reach, direction = length * fraction, np.full(count, along)
    return np.column_stack(
        [start[0] + reach * np.cos(direction), start[1] + reach * np.sin(direction), heading]
    )
