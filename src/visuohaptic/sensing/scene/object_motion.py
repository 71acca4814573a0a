"""Motion of the pushed object, and whether it falls or slips (Alt 2016, Sec. 3.5).

The visible surface is modelled as a plane through the contact line, perpendicular to the
floor, or as the cylinder whose section is the fitted circle. Tracked points are projected to it once;
from then on they are points of a rigid body. At the first contact, direction and curvature of the
surface are uncertain: both are unknowns with a prior, and are estimated with the motion, since points on a wrong surface do
not move like one rigid body. Between the
first and the newest image the plane induces a homography H = R - T n^T / d, Eq. (2.14), which is
estimated by consensus and decomposed; the solution whose plane is the known one is used. Its motion
is then refined on the pixels, with the plane and its distance known, and compared with
the simpler motion of a standing object: shift and rotation on the floor. The simpler one is used unless the pixels
contradict it (BIC), which keeps the rotation accurate and the tilt zero until the object tilts.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from ...core import Camera, Event, Pose, Reason
from ...tracking.points.flow import FlowStep
from .contact_surface import cast_to_face
from .object_events import ObjectEvents, ObjectMotion, ObjectMotionSettings
from .object_fit import STANDING, BodyFit, BodyFitter, turn_about_vertical, turn_angle, upright


class ObjectTracker:
    """The object's motion from tracked points on its face, and its events.

    Parameters
    ----------
    camera, T_camera_foam
        The sensor's camera.
    settings
        Settings of the motion estimation, and thresholds of events.
    """

    def __init__(
        self, camera: Camera, T_camera_foam: Pose, settings: ObjectMotionSettings | None = None
    ) -> None:
        self.camera, self.T_camera_foam = camera, T_camera_foam
        self.settings = settings or ObjectMotionSettings()
        self._fitter = BodyFitter(camera, T_camera_foam, self.settings.gate_sigmas, self.settings.min_points)
        self.face: Pose | None = None  #: initial one; None: nothing is tracked
        self.curvature_per_m = 0.0  #: of the face's section with the floor; 0 = plane
        self._shape_sigma = np.array([0.1, 2.0])  # of the face's direction [rad] and curvature [1/m]
        self._eye = T_camera_foam.inverse().translation_m
        self._to_foam = T_camera_foam.inverse().rotation
        self._motion = Pose.identity()  # of the body about the contact point
        self._body: dict[int, np.ndarray] = {}
        self._seen: dict[int, tuple[np.ndarray, Pose]] = {}  # ray in F and motion at the selection of a point
        self.rejected: set[int] = set()  #: points that did not move with the body
        self._agree = 1.0
        self._lean = np.eye(3)  # of the body at the last measurement of its face
        self._events = ObjectEvents(self.settings)
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
        """Start tracking an object; its surface is known with the accuracy of the contact.

        Parameters
        ----------
        face
            ``T_foam_face``: x along the contact, y up, z towards the robot.
        curvature_per_m
            Curvature of the section of the surface with the floor [1/m]; 0: a plane.
        direction_sigma_rad
            Standard deviation of the direction of the face about the vertical [rad].
        curvature_sigma_per_m
            Standard deviation of the curvature [1/m].
        another
            Whether it is a new object. For the previous one only the face is measured again: it
            keeps its tilt and its past events.
        """
        lean = self._motion.rotation @ self._lean
        keeps = not another and self.follows and self._events.tilted
        self._lean = lean @ upright(Pose(lean, np.zeros(3))).rotation.T if keeps else np.eye(3)
        # A tilted object has a tilted face.
        face = Pose(self._lean @ face.rotation, face.translation_m)
        self.face, self._motion = face, Pose.identity()
        self.curvature_per_m = float(curvature_per_m)
        self._shape_sigma = np.array([direction_sigma_rad, curvature_sigma_per_m])
        self._body, self._seen, self.rejected = {}, {}, set()
        self._events.start(another=another, keeps_tilt=keeps)
        self._points, self._agree = 0, 1.0

    def _release(self, ids: list[int]) -> None:
        """Give up the points that are no longer tracked; if none is, the last ones remain, and no others take their place."""
        if alive := self._body.keys() & ids:
            self._body = {i: point for i, point in self._body.items() if i in alive}
            self._seen = {i: self._seen[i] for i in self._body}
            self.rejected.intersection_update(ids)

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
        """Whether most of the points agree with the last motion."""
        return self._agree > 0.3

    @property
    def stands(self) -> bool:
        """Whether no tilt is detected: then its face may be measured again."""
        return self._events.stands

    def stop(self) -> None:
        """Stop tracking the object."""
        self.face = None

    def moved(self, points_foam_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Current positions of points of the body, given in its initial pose [m].

        Parameters
        ----------
        points_foam_m
            Points of the body in its initial pose, frame F [m].
        """
        assert self.face is not None
        return self._fitter.place(self.face, self._motion, points_foam_m)

    def update(
        self, step: FlowStep, t_s: float, *, in_contact: bool = True, force_fraction: float = 1.0
    ) -> tuple[ObjectMotion, tuple[Event, ...]]:
        """Motion since :meth:`start`, and events.

        Parameters
        ----------
        step
            Tracks on the object only.
        t_s
            Time of the frame [s].
        in_contact
            Whether the foam is in contact: slip is tested only then.
        force_fraction
            Force on the foam as a fraction of its recent maximum; it drops in a fall.
        """
        if self.face is None:
            return self._nothing(t_s, Reason.NOT_ZEROED), ()
        if not self._body:
            self._adopt(step.ids, step.before_px)
        ids = step.ids.tolist()
        self._release(ids)
        chosen = np.array([k for k, i in enumerate(ids) if i in self._body], dtype=int)
        tried = step.tried.get(int(step.label[0]) if len(step.label) else 0, 0) or sum(step.tried.values())
        fit = self._fit(step, ids, chosen)
        before = self._points
        if fit is None:
            motion, self._points = self._nothing(t_s, Reason.LOST), 0
            self._agree = 0.0 if len(chosen) >= self.settings.min_points else self._agree
        else:
            self._motion, self._covariance, inliers = fit.motion, fit.covariance, fit.inliers
            self._points = int(np.count_nonzero(inliers))
            self._agree = self._points / len(chosen)
            for k in chosen[~inliers]:
                # Reselected with the motion of this frame, they would only agree with its error.
                self._body.pop(ids[k])
                self.rejected.add(ids[k])
            motion = self._reading(t_s)
            self._events.tilt(t_s, motion.tilt_rad)
            # Points that are selected late inherit the error of this motion, and would outvote the first ones.
            if (
                turn_angle(self._motion) < self.settings.shape_turn_rad
                or self._points < 3 * self.settings.min_points
            ):
                known = self._body.keys() | self.rejected
                new = np.array([k for k, i in enumerate(ids) if i not in known], int)
                self._adopt(step.ids[new], step.after_px[new])
        sudden = before >= 2 * self.settings.min_points and len(ids) < self.settings.sudden_fraction * tried
        return motion, self._events.update(
            motion, self.face, in_contact=in_contact, force_fraction=force_fraction, sudden_loss=sudden
        )

    def _nothing(self, t_s: float, reason: Reason) -> ObjectMotion:
        nan = float("nan")
        return ObjectMotion(t_s, False, reason, np.full(3, nan), nan, nan, np.full((6, 6), np.inf), 0)

    def _reading(self, t_s: float) -> ObjectMotion:
        rotation = self._motion.rotation
        turn = turn_about_vertical(self._motion)
        tilt = math.acos(min(1.0, max(-1.0, float((rotation @ self._lean)[2, 2]))))
        shift = self._motion.translation_m.copy()
        return ObjectMotion(t_s, True, Reason.OK, shift, turn, tilt, self._covariance, self._points)

    def _adopt(self, ids: np.ndarray, pixels: np.ndarray) -> None:
        """Points of the body from pixels that currently see its surface."""
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
        """The body's points on another surface; later ones with the motion at their selection."""
        body = np.empty((len(ids), 3))
        groups: dict[int, list[int]] = {}
        for k, i in enumerate(ids):
            groups.setdefault(id(self._seen[i][1]), []).append(k)
        for members in groups.values():
            rays = np.array([self._seen[ids[k]][0] for k in members])
            body[members] = self._cast(rays, self._seen[ids[members[0]]][1], face, curvature)
        return body

    def _fit(self, step: FlowStep, ids: list[int], chosen: np.ndarray) -> BodyFit | None:
        s = self.settings
        if len(chosen) < s.min_points:
            return None
        assert self.face is not None
        body = np.array([self._body[ids[k]] for k in chosen])
        pixels, sigma = step.after_px[chosen], np.hypot(step.sigma_px[chosen], s.min_sigma_px)
        best = self._fitter.refined(self.face, self._motion, body, pixels, sigma)
        if best is None or np.mean(best.inliers) < 0.8:
            guess = self._fitter.by_homography(self.face, body, pixels)
            other = None if guess is None else self._fitter.refined(self.face, guess, body, pixels, sigma)
            if other is not None and (best is None or other.inliers.sum() > best.inliers.sum()):
                best = other
        best = self._with_shape(best, [ids[k] for k in chosen], pixels, sigma)
        if best is None or best.inliers.sum() < max(s.min_points, s.min_fraction * len(chosen)):
            return None
        return best

    def _with_shape(
        self, best: BodyFit | None, ids: list[int], pixels: np.ndarray, sigma: np.ndarray
    ) -> BodyFit | None:
        """Also correct the surface, if an uncertain one does not explain the motion."""
        s = self.settings
        start = best.motion if best is not None else self._motion
        if best is not None and (turn_angle(start) < s.shape_turn_rad or best.cost < 3.0 * len(ids)):
            return best  # two numbers per point: the expected cost is 2
        assert self.face is not None
        known, found, cost = (self.face, self.curvature_per_m), None, np.inf
        if best is not None:
            found, cost = (*known, self._shape_sigma, best), best.cost - 2.0 * math.log(2.0 * len(ids)) - 10.0
        for active in (STANDING, np.arange(6)):
            shape = self._fit_shape(start, ids, pixels, sigma, active)
            if shape is None:
                continue
            body = self._recast(*shape[:2], ids)
            if not np.isfinite(body).all():
                continue
            self.face, self.curvature_per_m = shape[:2]
            again = self._fitter.refined(self.face, start, body, pixels, sigma)
            if again is not None and again.cost < cost:
                found, cost = (*shape, again), again.cost
        self.face, self.curvature_per_m = known
        if found is None or found[3] is best:
            return best
        # All frames share the noise of the first one: the information grows more slowly than with independent frames.
        self._shape_sigma = np.maximum(np.sqrt(2.0) * found[2], 1e-3 * self._shape_sigma)
        self.face, self.curvature_per_m = found[:2]
        self._recast_all()
        return found[3]

    def _fit_shape(
        self, motion: Pose, ids: list[int], pixels: np.ndarray, sigma: np.ndarray, active: np.ndarray
    ) -> tuple[Pose, float, np.ndarray] | None:
        """Face, curvature, and their standard deviations, by least squares together with the motion."""
        assert self.face is not None
        face, curvature = self.face, self.curvature_per_m
        s, shape, prior = self.settings, np.zeros(2), self._shape_sigma
        spread = prior
        steps, free = np.array([1e-4, 1e-2]), np.array([*active, 6, 7])
        if len(active) < 6:
            motion = upright(motion)

        def surface(change: np.ndarray) -> tuple[Pose, float]:
            turn = Pose.from_rotation_vector([0.0, 0.0, change[0]], np.zeros(3))
            return Pose(turn.rotation @ face.rotation, face.translation_m), float(curvature + change[1])

        for iteration in range(6):
            body = self._recast(*surface(shape), ids)
            residual = (self._fitter.project(face, motion, body) - pixels) / sigma[:, None]
            distance = np.linalg.norm(residual, axis=1)
            seen = np.isfinite(distance)
            if np.count_nonzero(seen) < s.min_points:
                return None
            scale = max(1.0, float(np.median(distance[seen])) / 1.177)
            gate = s.gate_sigmas * scale
            weight = np.where(seen & (distance < gate), (1 - (distance / gate) ** 2) ** 2, 0.0)
            jacobian = np.zeros((len(ids), 2, 8))
            jacobian[:, :, :6] = self._fitter.jacobian(face, motion, body, np.arange(6))
            for k in range(2):
                ahead = self._recast(*surface(shape + steps[k] * np.eye(2)[k]), ids)
                jacobian[:, :, 6 + k] = (
                    self._fitter.project(face, motion, ahead) - self._fitter.project(face, motion, body)
                ) / steps[k]
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
