"""A two-finger gripper whose finger carries a strip of rubber foam, seen by a fixed camera (Alt 2016, Sec. 3.6.4).

Frames: R is the reference frame, fixed to camera and gripper base; F is the sensor frame of the
finger. Both are the same at position 0, and F moves by the position along x of R. The other
finger mirrors this one, so that an object between them stays in the middle.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Iterator, Sequence
from dataclasses import fields

import numpy as np
from jaxtyping import Float

from ...core import POSITIVE, Camera, Closing, Frame, Gripper, GripperState, Pose, check_numbers, within
from ..foam import FoamStrip, FoamStripGeometry, StripLaw
from ..foam.press_rig import STEP_M
from ..rendering import FoamScene, SceneObject, SceneRenderer
from ..rendering._finger_tag import paint_tag
from .gripper_setup import ROD, RUBBER_FOAM, FingerView, GraspObject, GripperDrive, GripperTruth

#: Maximum step [s].
STEP_S = 0.005


class VirtualGripper(Closing, Gripper):
    """The gripper and its camera; implements ``Gripper`` and ``FrameSource``.

    Time passes only by :meth:`advance_to`, :meth:`skip_to` or by taking frames: each takes one frame period.

    Parameters
    ----------
    objects
        Objects between the fingers.
    rng
        Source of the camera's noise.
    drive
        Opening, acceleration and maximum force.
    view
        Camera and visible parts of the finger.
    geometry, law
        The foam rod on the finger and its material.
    duration_s
        Time after which the source has no more frames [s].
    """

    def __init__(
        self,
        objects: Sequence[GraspObject] = (),
        *,
        rng: np.random.Generator,
        drive: GripperDrive | None = None,
        view: FingerView | None = None,
        geometry: FoamStripGeometry = ROD,
        law: StripLaw = RUBBER_FOAM,
        duration_s: float = math.inf,
    ) -> None:
        self.objects = tuple(objects)
        self.drive = drive or GripperDrive()
        self.view = view or FingerView()
        self.duration_s = duration_s
        self._rng = rng
        rig = self.view.rig
        self._renderer = SceneRenderer(rig.camera, rig.T_camera_foam, self.view.look, self.view.effects)
        self._strip = FoamStrip(geometry, law)
        self._back = geometry.back_m(self._strip.s_m)
        self._springs = np.array([item.stiffness_N_per_m for item in self.objects])
        self._shift, self._load = np.zeros((2, len(self.objects)))
        self._stiffness = np.zeros(len(self.objects))
        self._position = self._speed = 0.0
        self._target, self._limit = 0.0, 0.0
        self._next_frame = 0
        self._times: list[float] = []
        self._truths: list[GripperTruth] = []
        self._record(0.0, self._squeeze(0.0, 0.0))

    # Gripper

    def move(self, opening_m: float, speed_m_s: float) -> None:
        """Start to move to an opening; the drive stops by itself at its maximum force.

        Raises
        ------
        InputError
            The opening is out of range or the speed is not positive.
        """
        check_numbers("move", within(0.0, self.drive.open_m), opening_m=opening_m)
        check_numbers("move", POSITIVE, speed_m_s=speed_m_s)
        self._target, self._limit = 0.5 * (self.drive.open_m - opening_m), 0.5 * speed_m_s

    def stop(self) -> None:
        """Hold the current opening."""
        self._target, self._limit, self._speed = self._position, 0.0, 0.0

    def state(self) -> GripperState:
        """Newest reading of the drive, not used in Sec. 3.6.4."""
        return GripperState(self._times[-1], self.drive.open_m - 2 * self._position, -2 * self._speed)

    # FrameSource

    @property
    def camera(self) -> Camera:
        """The camera's model."""
        return self.view.rig.camera

    @property
    def frame_count(self) -> int | None:
        """Number of frames; ``None`` without a duration."""
        return None if math.isinf(self.duration_s) else math.ceil(self.duration_s * self.view.frame_rate_Hz)

    def __iter__(self) -> Iterator[Frame]:
        while self._next_frame / self.view.frame_rate_Hz < self.duration_s:
            yield self.frame()

    def close(self) -> None:
        """Nothing to release."""

    # Simulation

    def frame(self) -> Frame:
        """The next frame of the camera; simulates up to the end of its readout."""
        index, self._next_frame = self._next_frame, self._next_frame + 1
        t_s = index / self.view.frame_rate_Hz
        effects, camera = self._renderer.effects, self.camera
        self.advance_to(t_s + camera.row_delay_s * camera.height + effects.exposure_s)
        exact = self._renderer.render_exact(
            self.scene, t_s=t_s, camera_shake=self._ride, occluders=self.view.occluders
        )
        image = np.atleast_3d(exact)
        rows_s = camera.row_time_s(t_s, np.arange(camera.height))
        if self.view.tag is not None:
            positions = np.interp(rows_s, self._times, [truth.position_m for truth in self._truths])
            paint_tag(image, camera, self.view.rig.T_camera_foam, self.view.tag, positions, effects.blur_px)
        developed = effects.developed(image, rows_s, self._rng)
        return Frame(developed if self._renderer.look.colour else developed[..., 0], t_s, index)

    def advance_to(self, t_s: float) -> None:
        """Advance the simulation to ``t_s``.

        Parameters
        ----------
        t_s
            Time to reach [s].
        """
        while self._times[-1] < t_s - 1e-12:
            step = STEP_M / self._limit if self._limit > 0 else STEP_S
            self._step(min(STEP_S, step, t_s - self._times[-1]))

    def skip_to(self, t_s: float) -> None:
        """Advance the simulation without images; the next frame is the first one at or after a time.

        Parameters
        ----------
        t_s
            Time to reach [s].
        """
        self.advance_to(t_s)
        self._next_frame = max(self._next_frame, math.ceil(t_s * self.view.frame_rate_Hz - 1e-9))

    def truth(self, t_s: float | None = None) -> GripperTruth:
        """True state at a time that has been simulated; the newest by default.

        Parameters
        ----------
        t_s
            Time [s].
        """
        if t_s is None:
            return self._truths[-1]
        after = bisect.bisect_left(self._times, t_s)
        if after == len(self._times):
            return self._truths[-1]
        if after == 0:
            return self._truths[0]
        a, b = self._truths[after - 1 : after + 1]
        fraction = (t_s - a.t_s) / (b.t_s - a.t_s)
        values = [(getattr(a, part.name), getattr(b, part.name)) for part in fields(GripperTruth)[1:]]
        return GripperTruth(t_s, *((1 - fraction) * one + fraction * other for one, other in values))

    def scene(self, t_s: float) -> FoamScene:
        """Scene in the camera's view at a time, in frame F of the finger.

        Parameters
        ----------
        t_s
            Time [s].
        """
        truth = self.truth(t_s)
        bodies = []
        for item, shift in zip(self.objects, truth.shift_m, strict=True):
            look = item.surface
            outline = item.outline.moved(float(shift) - truth.position_m, 0.0).polygon_m()
            bodies.append(
                SceneObject(outline, item.top_m, look.grey, look.texture, look.seed, look.material, look.bgr)
            )
        return FoamScene(
            t_s,
            self._back,
            truth.front_m,
            (*bodies, *self._other_finger(truth)),
            floor_below_m=0.12,
            T_world_foam=Pose(np.eye(3), np.array([truth.position_m, 0.0, 0.0])),
            stripe_m=truth.stripe_m,
        )

    def _other_finger(self, truth: GripperTruth) -> tuple[SceneObject, SceneObject]:
        """Foam and body of the mirrored finger; its foam is drawn with the same deformation."""
        geometry, foam, body = self._strip.geometry, self._renderer.look.foam, self._renderer.look.body
        back = 2 * geometry.width_m + self.drive.open_m - 2 * truth.position_m
        near = back - float(truth.front_m[:, 0].min())
        half = 0.5 * geometry.length_m
        rod = np.array([[near, -half], [back, -half], [back, half], [near, half]])
        half += self._renderer.look.body_margin_m
        plate = np.array([[back, -half], [back + 0.08, -half], [back + 0.08, half], [back, half]])
        return (
            SceneObject(rod, 0.0, foam.grey, foam.texture, 1, foam.material, foam.bgr),
            SceneObject(plate, 0.0, body.grey, body.texture, 2, body.material, body.bgr),
        )

    def _ride(self, t_s: float) -> Pose:
        """Motion of the camera relative to the finger: the renderer's frame F is fixed to the finger."""
        rest = self.view.rig.T_camera_foam
        moved = Pose(np.eye(3), np.array([self.truth(t_s).position_m, 0.0, 0.0]))
        return rest @ moved @ rest.inverse()

    def _step(self, dt_s: float) -> None:
        now = self._truths[-1]
        way = self._target - self._position
        blocked = now.force_N >= self.drive.max_force_N and way > 0
        # Brakes in time: v^2 = 2 a s.
        target_speed = (
            0.0 if blocked else min(self._limit, math.sqrt(2 * self.drive.acceleration_m_s2 * abs(way)))
        )
        change = np.clip(
            math.copysign(target_speed, way) - self._speed,
            -self.drive.acceleration_m_s2 * dt_s,
            self.drive.acceleration_m_s2 * dt_s,
        )
        self._speed = 0.0 if blocked else self._speed + float(change)
        move = self._speed * dt_s
        if abs(move) >= abs(way) and move * way >= 0:
            move, self._speed = way, 0.0
        self._position += move
        self._record(now.t_s + dt_s, self._squeeze(dt_s, move))

    def _squeeze(self, dt_s: float, travel_m: float) -> Float[np.ndarray, "objects"]:
        """Advance foam and springs by one step of the finger.

        The springs are moved before the foam is compressed, by the amount that its stiffness in the last step
        predicts: foam that is compressed too far and released would record an unloading.
        The remaining imbalance is corrected in the next step.
        """
        if not self.objects:
            return np.zeros(0)
        soft, spring, foam = np.isfinite(self._springs), self._springs, self._stiffness
        rest = self._load[soft] - spring[soft] * self._shift[soft]
        touched = self._load[soft] > 0
        give = np.where(touched, rest + foam[soft] * travel_m, rest) / (spring[soft] + foam[soft])
        self._shift[soft] += give
        state = self._strip.press(
            [
                item.outline.moved(float(shift) - self._position, 0.0)
                for item, shift in zip(self.objects, self._shift, strict=True)
            ],
            dt_s,
        )
        pressed = np.full(len(self.objects), travel_m)
        pressed[soft] -= give
        change, self._load = state.body_force_N[:, 0] - self._load, state.body_force_N[:, 0]
        bound = self._strip.stiffness_N_per_m()
        slope = np.where(np.abs(pressed) > 1e-9, change / np.where(pressed == 0, 1.0, pressed), bound)
        self._stiffness = np.clip(slope, 0.1 * bound, bound)
        return self._load

    def _record(self, t_s: float, force_N: Float[np.ndarray, "objects"]) -> None:
        strip = self._strip
        rod = strip.geometry
        stripe = strip.inner_m(rod.width_m - self._renderer.look.stripe_width_m)
        self._times.append(t_s)
        self._truths.append(
            GripperTruth(
                t_s, self._position, self._speed, float(force_N.sum()), np.array(force_N), self._shift.copy(),
                strip.inner_m(rod.width_m), stripe,
            )
        )  # fmt: skip
