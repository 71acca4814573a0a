"""Motion of the object that is pushed, and whether it falls or slips (Alt 2016, Sec. 3.5).

The surface that the camera sees is taken as a plane through the contact line, perpendicular to the
floor, or as the cylinder that the fitted circle is the section of. Tracked points are cast to it once;
from then on they are points of a rigid body. A first touch tells the direction and the curvature of the
surface badly: both are unknowns with a prior, and the motion itself decides, since points on a wrong surface do
not move like one rigid body. Between the
first and the newest picture the plane makes a homography H = R - T n^T / d, Eq. (2.14), which is
estimated by consensus and decomposed; of its solutions that one counts whose plane is the known one. Its motion
is then refined on the pixels, with the plane and its distance known, and compared with
the simpler motion of an object that stands: shift and turn on the floor. The simpler one wins unless the pixels
contradict it (BIC), which keeps the turn precise and the tilt zero until there is one.

A fall is a tilt above a limit. Tracking may not be able to follow that far: when the
tracks are lost, the last tilt is carried on with its rate, and a sudden loss together with that of
the contact force counts as a fall at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core.camera.model import Camera
from ...core.camera.pose import Pose
from ...core.errors import InputError
from ...core.geometry import so3_log
from ...core.measurement import Event, EventKind, Reason
from ...tracking.points.flow import FlowStep
from ...tracking.points.homography import decompose_homography, estimate_homography_robust, facing_motions
from ...tracking.pose.plane_pose import lens_numbers
from .contact_surface import cast_to_face

__all__ = ["ObjectMotion", "ObjectMotionSettings", "ObjectTracker"]


#: Motion, covariance of (rotation vector, shift), points that agree, and robust cost.
_Fit = tuple[Pose, np.ndarray, np.ndarray, float]
#: Of (rotation vector, shift) what an object on the floor can do.
_STANDING = np.array([2, 3, 4])


@dataclass(frozen=True, slots=True)
class ObjectMotionSettings:
    """How the motion is estimated, and what counts as an event."""

    smallest_sigma_px: float = 0.15  #: of a track: interpolation, and a surface that is not quite plane
    gate_sigmas: float = 4.0  #: a point agrees within so many standard deviations
    min_points: int = 8
    min_share: float = 0.4  #: of the points that must agree
    fall_tilt_rad: float = 0.5  #: from here on an object does not come back
    tilt_seen_rad: float = 0.08  #: a tilt that is carried on when the tracks are lost
    coast_s: float = 0.6  #: for so long
    sudden_fraction: float = 0.4  #: fewer tracks than this part of those before are a sudden loss
    slip_m: float = 0.006  #: shift of the contact along the foam that counts as slip
    shape_turn_rad: float = 0.03  #: once it has turned by so much the motion tells the surface, too

    def __post_init__(self) -> None:
        if not (self.min_points >= 4 and 0 < self.min_share < 1 and self.fall_tilt_rad > 0):
            raise InputError(
                "ObjectMotionSettings",
                f"found min_points {self.min_points}, min_share {self.min_share}, "
                f"fall_tilt_rad {self.fall_tilt_rad}; expected >= 4, between 0 and 1, > 0",
            )


@dataclass(frozen=True, slots=True, eq=False)
class ObjectMotion:
    """Motion of the touched object since it is tracked, in frame F of the sensor."""

    t_s: float
    valid: bool
    reason: Reason
    shift_m: Float[np.ndarray, "3"]  #: of the point of contact
    turn_rad: float  #: about the vertical, counter-clockwise
    tilt_rad: float  #: between its axis and the vertical, >= 0
    covariance: Float[np.ndarray, "6 6"]  #: of (rotation vector [rad], shift [m]) in F
    points: int  #: that agree

    @property
    def turn_sigma_rad(self) -> float:
        """Standard deviation of ``turn_rad``."""
        return float(np.sqrt(self.covariance[2, 2]))


def _angle(motion: Pose) -> float:
    """By how much a motion turns [rad]."""
    return float(np.linalg.norm(so3_log(motion.rotation)))


def _twist(motion: Pose) -> float:
    """The part of a turn that is about the vertical [rad]: twice the angle of (w, z) of the quaternion."""
    r = motion.rotation
    return math.atan2(r[1, 0] - r[0, 1], r[0, 0] + r[1, 1])


def _upright(motion: Pose) -> Pose:
    """The nearest motion of an object that stands on the floor."""
    shift = np.array([motion.translation_m[0], motion.translation_m[1], 0.0])
    return Pose.from_rotation_vector([0.0, 0.0, _twist(motion)], shift)


class ObjectTracker:
    """The object's motion from tracked points on its face, and its events.

    Parameters
    ----------
    camera, T_camera_foam
        The sensor's camera.
    """

    def __init__(
        self, camera: Camera, T_camera_foam: Pose, settings: ObjectMotionSettings | None = None
    ) -> None:
        self.camera, self.T_camera_foam = camera, T_camera_foam
        self.settings = settings or ObjectMotionSettings()
        self._lens = lens_numbers(camera)
        self.face: Pose | None = None  #: at the begin; None: nothing is tracked
        self.curvature_per_m = 0.0  #: of the face's section with the floor; 0 = plane
        self._shape_sigma = np.array([0.1, 2.0])  # of the face's direction [rad] and curvature [1/m]
        self._eye = T_camera_foam.inverse().translation_m
        self._to_foam = T_camera_foam.inverse().rotation
        self._motion = Pose.identity()  # of the body about the contact point
        self._body: dict[int, np.ndarray] = {}
        self._seen: dict[int, tuple[np.ndarray, Pose]] = {}  # ray in F and motion, where a point was chosen
        self.rejected: set[int] = set()  #: points that did not move with the body
        self._agree = 1.0
        self._lean = np.eye(3)  # of the body where its face was looked at last
        self._tilts: list[tuple[float, float]] = []
        self._happened: set[EventKind] = set()
        self._covariance = np.full((6, 6), np.inf)
        self._points = 0

    def start(
        self,
        face: Pose,
        curvature_per_m: float = 0.0,
        *,
        direction_sigma_rad: float = 0.1,
        curvature_sigma_per_m: float = 2.0,
        another: bool = True,
    ) -> None:
        """Begin with an object whose surface is known as well as the contact tells it.

        ``another`` is False for the object of before, whose face is only known better now: it leans as
        it did, and what has happened to it has happened.
        """
        lean = self._motion.rotation @ self._lean
        keeps = not another and self.follows and bool(self._tilts)
        self._lean = lean @ _upright(Pose(lean, np.zeros(3))).rotation.T if keeps else np.eye(3)
        # What leans by now has a face that leans.
        face = Pose(self._lean @ face.rotation, face.translation_m)
        self.face, self._motion = face, Pose.identity()
        self.curvature_per_m = float(curvature_per_m)
        self._shape_sigma = np.array([direction_sigma_rad, curvature_sigma_per_m])
        self._body, self._seen, self.rejected = {}, {}, set()
        if another:
            self._happened = set()
        self._tilts = self._tilts if keeps else []
        self._points, self._agree = 0, 1.0

    def _recast_all(self) -> None:
        assert self.face is not None
        everyone = list(self._body)
        for i, point in zip(everyone, self._recast(self.face, self.curvature_per_m, everyone), strict=True):
            if np.isfinite(point).all():
                self._body[i] = point
            else:
                del self._body[i]

    @property
    def follows(self) -> bool:
        """Whether most of the points agree with the motion that was found last."""
        return self._agree > 0.3

    @property
    def stands(self) -> bool:
        """Whether it is not seen to lean: then its face may be looked at afresh."""
        return not self._tilts or self._tilts[-1][1] < 0.5 * self.settings.tilt_seen_rad

    def stop(self) -> None:
        """Forget the object."""
        self.face = None

    def moved(self, points_foam_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Where points of the body, given at the begin, are now [m]."""
        return self._place(self._motion, points_foam_m)

    def update(
        self, step: FlowStep, t_s: float, *, in_contact: bool = True, force_fraction: float = 1.0
    ) -> tuple[ObjectMotion, tuple[Event, ...]]:
        """Motion since :meth:`start`, and what happened.

        Parameters
        ----------
        step
            Tracks on the object only.
        in_contact
            Whether the foam feels it: slip is asked only then.
        force_fraction
            Force on the foam as part of its largest lately; a fall takes it away.
        """
        if self.face is None:
            return self._nothing(t_s, Reason.NOT_ZEROED), ()
        if not self._body:
            self._adopt(step.ids, step.before_px)
        ids = step.ids.tolist()
        chosen = np.array([k for k, i in enumerate(ids) if i in self._body], dtype=int)
        tried = step.tried.get(int(step.label[0]) if len(step.label) else 0, 0) or sum(step.tried.values())
        fit = self._fit(step, ids, chosen)
        before = self._points
        if fit is None:
            motion, self._points = self._nothing(t_s, Reason.LOST), 0
            self._agree = 0.0 if len(chosen) >= self.settings.min_points else self._agree
        else:
            self._motion, self._covariance, inliers, _ = fit
            self._points = int(np.count_nonzero(inliers))
            self._agree = self._points / len(chosen)
            for k in chosen[~inliers]:
                # Chosen anew with the motion of this frame it would only agree with its own error.
                self._body.pop(ids[k])
                self.rejected.add(ids[k])
            motion = self._reading(t_s)
            self._tilts = [*self._tilts[-5:], (t_s, motion.tilt_rad)]
            # Points that are chosen late inherit the error of this motion, and would outvote the first ones.
            if (
                _angle(self._motion) < self.settings.shape_turn_rad
                or self._points < 3 * self.settings.min_points
            ):
                known = self._body.keys() | self.rejected
                new = np.array([k for k, i in enumerate(ids) if i not in known], int)
                self._adopt(step.ids[new], step.after_px[new])
        sudden = before >= 2 * self.settings.min_points and len(ids) < self.settings.sudden_fraction * tried
        return motion, self._events(motion, t_s, in_contact, force_fraction, sudden)

    def _nothing(self, t_s: float, reason: Reason) -> ObjectMotion:
        nan = float("nan")
        return ObjectMotion(t_s, False, reason, np.full(3, nan), nan, nan, np.full((6, 6), np.inf), 0)

    def _reading(self, t_s: float) -> ObjectMotion:
        rotation = self._motion.rotation
        turn = _twist(self._motion)
        tilt = math.acos(min(1.0, max(-1.0, float((rotation @ self._lean)[2, 2]))))
        shift = self._motion.translation_m.copy()
        return ObjectMotion(t_s, True, Reason.OK, shift, turn, tilt, self._covariance, self._points)

    def _place(self, motion: Pose, points: np.ndarray) -> np.ndarray:
        assert self.face is not None
        pivot = self.face.translation_m
        return (points - pivot) @ motion.rotation.T + pivot + motion.translation_m

    def _adopt(self, ids: np.ndarray, pixels: np.ndarray) -> None:
        """Points of the body from pixels that see its surface now."""
        if len(ids) == 0:
            return
        assert self.face is not None
        rays = self.camera.rays(pixels) @ self._to_foam.T
        points = self._cast(rays, self._motion, self.face, self.curvature_per_m)
        for i, ray, point in zip(ids.tolist(), rays, points, strict=True):
            if np.isfinite(point).all():
                self._body[i], self._seen[i] = point, (ray, self._motion)

    def _cast(self, rays: np.ndarray, motion: Pose, face: Pose, curvature: float) -> np.ndarray:
        return cast_to_face(self._eye, rays, motion, face, curvature)

    def _recast(self, face: Pose, curvature: float, ids: list[int]) -> np.ndarray:
        """The body's points on another surface; those chosen later with the motion of their time."""
        body = np.empty((len(ids), 3))
        groups: dict[int, list[int]] = {}
        for k, i in enumerate(ids):
            groups.setdefault(id(self._seen[i][1]), []).append(k)
        for members in groups.values():
            rays = np.array([self._seen[ids[k]][0] for k in members])
            body[members] = self._cast(rays, self._seen[ids[members[0]]][1], face, curvature)
        return body

    def _fit(self, step: FlowStep, ids: list[int], chosen: np.ndarray) -> _Fit | None:
        s = self.settings
        if len(chosen) < s.min_points:
            return None
        body = np.array([self._body[ids[k]] for k in chosen])
        pixels, sigma = step.after_px[chosen], np.hypot(step.sigma_px[chosen], s.smallest_sigma_px)
        best = self._refined(self._motion, body, pixels, sigma)
        if best is None or np.mean(best[2]) < 0.8:
            guess = self._by_homography(body, pixels)
            other = None if guess is None else self._refined(guess, body, pixels, sigma)
            if other is not None and (best is None or other[2].sum() > best[2].sum()):
                best = other
        best = self._with_shape(best, [ids[k] for k in chosen], pixels, sigma)
        if best is None or best[2].sum() < max(s.min_points, s.min_share * len(chosen)):
            return None
        return best

    def _with_shape(
        self, best: _Fit | None, ids: list[int], pixels: np.ndarray, sigma: np.ndarray
    ) -> _Fit | None:
        """Correct the surface, too, where one that is known badly does not explain the motion."""
        s = self.settings
        start = best[0] if best is not None else self._motion
        if best is not None and (_angle(start) < s.shape_turn_rad or best[3] < 3.0 * len(ids)):
            return best  # two numbers per point: the expected cost is 2
        assert self.face is not None
        known, found, cost = (self.face, self.curvature_per_m), None, np.inf
        if best is not None:
            found, cost = (*known, self._shape_sigma, best), best[3] - 2.0 * math.log(2.0 * len(ids)) - 10.0
        for active in (_STANDING, np.arange(6)):
            shape = self._fit_shape(start, ids, pixels, sigma, active)
            if shape is None:
                continue
            body = self._recast(*shape[:2], ids)
            if not np.isfinite(body).all():
                continue
            self.face, self.curvature_per_m = shape[:2]
            again = self._refined(start, body, pixels, sigma)
            if again is not None and again[3] < cost:
                found, cost = (*shape, again), again[3]
        self.face, self.curvature_per_m = known
        if found is None or found[3] is best:
            return best
        # Every frame shares the noise of the first one: what is known grows slower than by independent ones.
        self._shape_sigma = np.maximum(np.sqrt(2.0) * found[2], 1e-3 * self._shape_sigma)
        self.face, self.curvature_per_m = found[:2]
        self._recast_all()
        return found[3]

    def _fit_shape(
        self, motion: Pose, ids: list[int], pixels: np.ndarray, sigma: np.ndarray, active: np.ndarray
    ) -> tuple[Pose, float, np.ndarray] | None:
        """Face, curvature, and their standard deviations, by least squares together with the motion."""
        assert self.face is not None
        s, shape, prior = self.settings, np.zeros(2), self._shape_sigma
        spread = prior
        steps, free = np.array([1e-4, 1e-2]), np.array([*active, 6, 7])
        if len(active) < 6:
            motion = _upright(motion)

        def surface(change: np.ndarray) -> tuple[Pose, float]:
            assert self.face is not None
            turn = Pose.from_rotation_vector([0.0, 0.0, change[0]], np.zeros(3))
            return Pose(turn.rotation @ self.face.rotation, self.face.translation_m), float(
                self.curvature_per_m + change[1]
            )

        for iteration in range(6):
            body = self._recast(*surface(shape), ids)
            residual = (self._project(motion, body) - pixels) / sigma[:, None]
            distance = np.linalg.norm(residual, axis=1)
            seen = np.isfinite(distance)
            if np.count_nonzero(seen) < s.min_points:
                return None
            scale = max(1.0, float(np.median(distance[seen])) / 1.177)
            gate = s.gate_sigmas * scale
            weight = np.where(seen & (distance < gate), (1 - (distance / gate) ** 2) ** 2, 0.0)
            jacobian = np.zeros((len(ids), 2, 8))
            jacobian[:, :, :6] = self._jacobian(motion, body, np.arange(6))
            for k in range(2):
                ahead = self._recast(*surface(shape + steps[k] * np.eye(2)[k]), ids)
                jacobian[:, :, 6 + k] = (self._project(motion, ahead) - self._project(motion, body)) / steps[
                    k
                ]
            jacobian /= sigma[:, None, None]
            used = (weight > 0) & np.isfinite(jacobian).all(axis=(1, 2))
            flat = jacobian[used].reshape(-1, 8)[:, free]
            weighted = np.repeat(weight[used], 2)[:, None] * flat / scale**2
            information = weighted.T @ flat
            information += 1e-9 * np.trace(information) * np.eye(len(free))
            information[-2:, -2:] += np.diag(1.0 / prior**2)
            gradient = weighted.T @ residual[used].ravel()
            gradient[-2:] += shape / prior**2
            change = np.zeros(8)
            change[free] = -np.linalg.solve(information, gradient)
            if not np.abs(change[:7]).max() < 1.0:
                return None
            turn = Pose.from_rotation_vector(change[:3], np.zeros(3))
            motion = Pose(turn.rotation @ motion.rotation, motion.translation_m + change[3:6])
            shape = shape + change[6:]
            spread = np.sqrt(np.diag(np.linalg.inv(information))[-2:])
            if iteration > 1 and np.abs(change[:6]).max() < 1e-5:
                break
        if np.any(np.abs(shape) > 4.0 * prior):
            return None
        return (*surface(shape), spread)

    def _by_homography(self, body: np.ndarray, pixels: np.ndarray) -> Pose | None:
        """Motion by decomposition of the homography of the known plane."""
        assert self.face is not None
        view = self.T_camera_foam
        normal = view.rotation @ self.face.rotation[:, 2]
        distance = -float(normal @ view.apply(self.face.translation_m))
        if distance <= 1e-3:
            return None
        start = view.apply(body)
        source, target = start[:, :2] / start[:, 2:], self.camera.rays(pixels)[:, :2]
        found = estimate_homography_robust(
            source, target, threshold=2.0 / self.camera.focal_px, minimum=self.settings.min_points
        )
        if not found.valid:
            return None
        rays = np.column_stack([source[found.inliers], np.ones(np.count_nonzero(found.inliers))])
        motions = facing_motions(decompose_homography(found.matrix), rays)
        if not motions:
            return None
        motion = max(motions, key=lambda one: float(one.normal @ normal))
        # From the camera's frame to F, about the point of contact.
        moved = Pose(motion.rotation, distance * motion.translation_over_distance)
        in_foam = view.inverse() @ moved @ view
        pivot = self.face.translation_m
        return Pose(in_foam.rotation, in_foam.apply(pivot) - pivot)

    def _refined(self, start: Pose, body: np.ndarray, pixels: np.ndarray, sigma: np.ndarray) -> _Fit | None:
        """The standing motion if the pixels allow it, else the free one."""
        free = self._least_squares(start, body, pixels, sigma, np.arange(6))
        if free is None:
            return None
        stands = self._least_squares(_upright(start), body, pixels, sigma, _STANDING)
        price = 3.0 * math.log(2.0 * len(body)) + 10.0
        return stands if stands is not None and stands[3] < free[3] + price else free

    def _least_squares(
        self, start: Pose, body: np.ndarray, pixels: np.ndarray, sigma: np.ndarray, active: np.ndarray
    ) -> _Fit | None:
        """Gauss-Newton on the pixels with Tukey's weights; (rotation vector, shift) in F, those ``active``."""
        from ._object_kernels import fit_motion

        assert self.face is not None
        s, view = self.settings, self.T_camera_foam
        rotation, shift = start.rotation.copy(), start.translation_m.copy()
        distance, kept = np.zeros(len(body)), np.zeros((6, 6))
        free = np.zeros(6, dtype=bool)
        free[active] = True
        scale = fit_motion(
            body, np.ascontiguousarray(pixels), sigma, self.face.translation_m, view.rotation, view.translation_m,
            self._lens, s.gate_sigmas, max(4, s.min_points // 2), free, rotation, shift, distance, kept,
        )  # fmt: skip
        if not np.isfinite(scale):
            return None
        cost = float(np.minimum(distance, s.gate_sigmas) @ np.minimum(distance, s.gate_sigmas))
        covariance = np.zeros((6, 6))
        covariance[np.ix_(active, active)] = np.linalg.pinv(kept[np.ix_(active, active)]) * scale**2
        return Pose(rotation, shift), covariance, distance < s.gate_sigmas * scale, cost

    def _project(self, motion: Pose, body: np.ndarray) -> np.ndarray:
        return self.camera.project(self.T_camera_foam.apply(self._place(motion, body)))

    def _jacobian(self, motion: Pose, body: np.ndarray, active: np.ndarray) -> np.ndarray:
        """d pixels / d (rotation vector, shift): pinhole by hand, at the undistorted point."""
        assert self.face is not None
        placed = self._place(motion, body)
        x, y, z = self.T_camera_foam.apply(placed).T
        fx, fy = self.camera.matrix[0, 0], self.camera.matrix[1, 1]
        by_point = np.zeros((len(body), 2, 3))
        by_point[:, 0, 0], by_point[:, 0, 2] = fx / z, -fx * x / z**2
        by_point[:, 1, 1], by_point[:, 1, 2] = fy / z, -fy * y / z**2
        by_point = by_point @ self.T_camera_foam.rotation
        arm = placed - self.face.translation_m - motion.translation_m
        turns = np.zeros((len(body), 3, 6))
        turns[:, :, 3:] = np.eye(3)
        # d(w x a) / dw = -[a]x
        turns[:, 0, 1], turns[:, 0, 2] = arm[:, 2], -arm[:, 1]
        turns[:, 1, 0], turns[:, 1, 2] = -arm[:, 2], arm[:, 0]
        turns[:, 2, 0], turns[:, 2, 1] = arm[:, 1], -arm[:, 0]
        return (by_point @ turns)[:, :, active]

    def _events(
        self, motion: ObjectMotion, t_s: float, in_contact: bool, force_fraction: float, sudden: bool
    ) -> tuple[Event, ...]:
        found: list[Event] = []
        if EventKind.FALL not in self._happened and self._falls(motion, t_s, force_fraction, sudden):
            found.append(Event(EventKind.FALL, t_s))
        if EventKind.SLIP not in self._happened and motion.valid and in_contact and self.face is not None:
            along = self.face.rotation[:, 0]
            way = float(motion.shift_m @ along)
            sigma = math.sqrt(max(float(along @ motion.covariance[3:, 3:] @ along), 0.0))
            if abs(way) > self.settings.slip_m + 3.0 * sigma and motion.tilt_rad < 0.2:
                found.append(Event(EventKind.SLIP, t_s, float(self.face.translation_m[1])))
        self._happened |= {event.kind for event in found}
        return tuple(found)

    def _falls(self, motion: ObjectMotion, t_s: float, force_fraction: float, sudden: bool) -> bool:
        s = self.settings
        if motion.valid:
            return motion.tilt_rad > s.fall_tilt_rad
        if not self._tilts:
            return False
        last_t, last = self._tilts[-1]
        if last > s.tilt_seen_rad and t_s - last_t < s.coast_s and len(self._tilts) >= 3:
            return self._carried_on(t_s) > s.fall_tilt_rad
        return sudden and force_fraction < 0.5

    def _carried_on(self, t_s: float) -> float:
        """Tilt that the last ones lead to, growing at least as fast as they did."""
        times, tilts = np.array(self._tilts[-4:]).T
        rate = float(np.polyfit(times - times[-1], tilts, 1)[0])
        gain = np.diff(tilts) / np.diff(times)
        speeding = max(0.0, float(gain[-1] - gain[0]) / max(float(times[-1] - times[1]), 1e-3))
        ahead = t_s - float(times[-1])
        return float(tilts[-1]) + max(rate, float(gain[-1])) * ahead + 0.5 * speeding * ahead**2
