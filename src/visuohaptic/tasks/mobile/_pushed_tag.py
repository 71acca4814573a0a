"""Recording of a push, and the shape and haptic tag computed from it (Alt 2016, Sec. 4.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...core import BaseState, Event, ForceProfile, HapticTag, PrimitiveKind
from ...sensing import PrimitiveFit, fit_contact, tag_from_push
from ...sensing.push.push_record import StopReason, record_push


class PushRecording:
    """Force profiles and odometry of one push, until the platform retreats."""

    def __init__(self) -> None:
        self.profiles: list[ForceProfile] = []
        self.states: list[BaseState] = []
        self.angles_rad: list[float] = []  #: orientation of the object in the world, from its texture
        self._start: BaseState | None = None
        self._halted: list[tuple[ForceProfile, BaseState]] = []

    def add(self, profile: ForceProfile, state: BaseState, angle_rad: float) -> None:
        """Record one frame.

        Parameters
        ----------
        profile
            Measurement of the foam.
        state
            Odometry at the same time.
        angle_rad
            Rotation of the object from its texture [rad]; NaN if not measured.
        """
        self.profiles.append(profile)
        self.states.append(state)
        self.angles_rad.append(angle_rad)

    def add_standstill(self, profile: ForceProfile, state: BaseState) -> None:
        """Record a frame of the halt; frames during which the platform still moves are ignored.

        Parameters
        ----------
        profile, state
            As of :meth:`add`.
        """
        if abs(state.speed_m_s) < 1e-3 and profile.contacts:
            self._halted.append((profile, state))

    def travel_m(self, state: BaseState) -> float:
        """Distance along the initial heading, since the first state passed to this method [m].

        Parameters
        ----------
        state
            State of the odometry.
        """
        start = self._start = self._start or state
        dx, dy = state.x_m - start.x_m, state.y_m - start.y_m
        return dx * math.cos(start.heading_rad) + dy * math.sin(start.heading_rad)

    def travels_m(self) -> Float[np.ndarray, "N"]:
        """Distance along the initial heading at every frame [m]."""
        return np.array([self.travel_m(state) for state in self.states])

    def travel_at(self, t_s: float) -> float:
        """Distance at a time, interpolated between frames [m].

        Parameters
        ----------
        t_s
            Time [s].
        """
        times = [profile.t_s for profile in self.profiles]
        return float(np.interp(t_s, times, self.travels_m()))

    def shape(self) -> tuple[PrimitiveFit | None, BaseState | None]:
        """Primitive fitted to the largest contact at standstill, or else at the largest deflection."""
        if self._halted:
            profile, state = self._halted[len(self._halted) // 2]
        else:
            pressed = [i for i, p in enumerate(self.profiles) if p.contacts]
            if not pressed:
                return None, None
            best = max(pressed, key=lambda i: float(np.nansum(self.profiles[i].delta_m)))
            profile, state = self.profiles[best], self.states[best]
        contact = profile.max_contact
        return (None, None) if contact is None else (fit_contact(contact), state)

    def tag(
        self,
        fit: PrimitiveFit | None,
        events: Sequence[Event],
        stopped_by: StopReason | None,
        max_force_N: float,
    ) -> HapticTag:
        """Haptic tag of the pushed object.

        Parameters
        ----------
        fit
            Shape of the contact.
        events
            Events of the push.
        stopped_by
            Why the push ended.
        max_force_N
            Maximum push force of the platform [N].
        """
        best = fit.best if fit is not None else None
        centre = float(best.parameters[1]) if best is not None and best.kind is PrimitiveKind.CIRCLE else None
        if best is not None and best.kind is PrimitiveKind.SEGMENT:
            centre = 0.5 * float(best.parameters[1] + best.parameters[3])
        flat = best is not None and best.kind in (PrimitiveKind.LINE, PrimitiveKind.SEGMENT)
        push = record_push(
            self.profiles, self.travels_m(), lateral_m=self._laterals_m(), angle_rad=self._turn_rad(flat)
        )
        return tag_from_push(
            push,
            events=events,
            stopped_by=stopped_by,
            max_force_N=max_force_N,
            primitive=best,
            object_centre_m=centre,
        )

    def _laterals_m(self) -> Float[np.ndarray, "N"]:
        """Lateral shift of the platform to the left of the initial heading [m]."""
        first = self.states[0]
        return np.array(
            [
                -(state.x_m - first.x_m) * math.sin(first.heading_rad)
                + (state.y_m - first.y_m) * math.cos(first.heading_rad)
                for state in self.states
            ]
        )

    def _turn_rad(self, flat: bool) -> Float[np.ndarray, "N"] | None:
        """Orientation of the object in the world [rad], from its texture and, for a flat object, from its face."""
        face = None
        if flat:
            face = np.array(
                [
                    _face_angle(profile) + state.heading_rad
                    for profile, state in zip(self.profiles, self.states, strict=True)
                ]
            )
        pushed = np.array([bool(profile.contacts) for profile in self.profiles])
        texture = np.array(self.angles_rad)
        if not np.isfinite(texture[pushed]).mean() > 0.5:
            return face
        return texture if face is None else _joined(texture, face)


def _joined(texture_rad: np.ndarray, face_rad: np.ndarray) -> np.ndarray:
    """Mean of two angles with a constant offset between them; where one is missing, the other."""
    both = np.isfinite(texture_rad) & np.isfinite(face_rad)
    if not both.any():
        return texture_rad
    shifted = face_rad - np.median(face_rad[both] - texture_rad[both])
    one = np.where(np.isfinite(texture_rad), texture_rad, shifted)
    return np.where(both, 0.5 * (texture_rad + shifted), one)


def _face_angle(profile: ForceProfile) -> float:
    """Direction of the touched flat face in frame F [rad]; NaN without sufficient contact."""
    contact = profile.max_contact
    if contact is None:
        return math.nan
    pressed = contact.delta_m > 0.7 * contact.delta_m.max()
    if pressed.sum() < 4:
        return math.nan
    x, y = contact.points_foam_m[pressed].T
    slope = np.polyfit(y, x, 1)[0]
    # A face along y has angle zero; a counter-clockwise rotation decreases x with growing y.
    return float(-math.atan(slope))
