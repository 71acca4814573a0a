"""Tracking of the foam's surroundings in the camera image: obstacles ahead, floor motion, the pushed object (Sec. 3.5).

One call per frame. Points are tracked on floor patches left and right of the foam and, during
a contact, on the object's face above it; the upper strip of the image is monitored for approaching obstacles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np
from jaxtyping import Float, UInt8

from ...core import BaseState, Camera, Frame, InputError, PlaneView, Pose, rotation_2d
from ...core.measurement import Contact, Event, ForceProfile, Motion, Reason
from ...core.objects import Primitive, PrimitiveKind
from ...core.ranges import POSITIVE, check_numbers
from ...tracking.points.flow import FlowStep, PointTracker
from .contact_surface import contact_face, face_curvature
from .ego_motion import EgoMotionFilter
from .floor_motion import FloorTracker
from .object_events import ObjectMotion
from .object_motion import ObjectTracker
from .obstacle_mask import Obstacle, ObstacleDetector
from .obstacle_memory import ObstacleMemory
from .scene_regions import FLOOR, OBJECT, SceneRegions, SceneSettings

if TYPE_CHECKING:
    from ..foam.strip.config import FoamSetup


@dataclass(frozen=True, slots=True, eq=False)
class SceneReading:
    """Reading of the surroundings in one frame."""

    t_s: float
    motion: Motion  #: of frame F since the last frame, floor and odometry fused
    floor_motion: Motion  #: from the floor alone
    pose: Float[np.ndarray, "3"]  #: (x, y, heading) of frame F since the start [m, rad]
    pose_covariance: Float[np.ndarray, "3 3"]  #: of ``pose``
    object_motion: ObjectMotion  #: since the contact began
    object_angle_rad: float  #: rotation of the object in the world since then; NaN when it is not visible
    events: tuple[Event, ...]  #: FALL and SLIP
    obstacle: Obstacle
    floor_points: int
    object_points: int

    @property
    def valid(self) -> bool:
        """Whether the motion of the platform is valid."""
        return self.motion.valid

    @property
    def reason(self) -> Reason:
        """Reason if not valid; ``ok`` when valid."""
        return self.motion.reason

    @property
    def mask(self) -> UInt8[np.ndarray, "rows columns"]:
        """255 where the upper strip is not floor, in bins of ``obstacle.binning`` pixels."""
        return self.obstacle.mask

    @property
    def proximity_m(self) -> float:
        """Distance of the nearest obstacle in front of the foam; inf = free, NaN = unknown."""
        return self.obstacle.proximity_m


class SceneTracker:
    """Tracks the surroundings of the foam, frame by frame.

    Parameters
    ----------
    camera, T_camera_foam
        The sensor's camera and the pose of frame F in it.
    floor_below_m
        Height of the foam's visible edge above the floor.
    settings
        Regions and settings of point selection.
    rng
        Source of RANSAC's random samples.

    Examples
    --------
    >>> from visuohaptic.rigs import VirtualSensor
    >>> rig = VirtualSensor().rig
    >>> tracker = SceneTracker(rig.camera, rig.T_camera_foam)
    >>> grey = np.full((rig.camera.height, rig.camera.width), 128, np.uint8)
    >>> reading = tracker.update(Frame(grey, 0.0, 0))
    >>> reading.motion.valid, str(reading.motion.reason)  # a first frame has moved from nowhere
    (False, 'not_zeroed')
    """

    def __init__(
        self,
        camera: Camera,
        T_camera_foam: Pose,
        floor_below_m: float = 0.05,
        settings: SceneSettings | None = None,
        rng: np.random.Generator | None = None,
    ) -> None:
        check_numbers("SceneTracker", POSITIVE, floor_below_m=floor_below_m)
        self.settings = s = settings or SceneSettings()
        self.camera, self.T_camera_foam = camera, T_camera_foam
        below = Pose(np.eye(3), np.array([0.0, 0.0, -floor_below_m]))
        self.floor_view = PlaneView(camera, T_camera_foam @ below)
        binning = max(s.flow.binning, -(-camera.width // s.max_width_px))
        self._regions = SceneRegions(camera, T_camera_foam, self.floor_view, s)
        self._points = PointTracker(replace(s.flow, binning=binning), rows=(0, self._regions.last_row))
        self._floor = FloorTracker(self.floor_view, s.floor, rng)
        self.ego = EgoMotionFilter(s.ego)
        self._object = ObjectTracker(camera, T_camera_foam, s.object)
        self._obstacles = ObstacleDetector(self.floor_view, s.front_m, s.obstacles)
        self._obstacle: Obstacle | None = None  #: of the newest frame
        self._near = ObstacleMemory(self._obstacles.blind_m)
        self._half_width_m, self._without, self._heading = 0.0, 0, 0.0
        self._angle, self._angle_before = 0.0, 0.0
        self._flat_angle = float("nan")  # direction of a flat face, minus the rotation at that time
        self._deflection_m = 0.0
        self._last_t_s = float("nan")
        self._force_N = 0.0  # maximum of the contact, slowly decaying

    @classmethod
    def of_sensor(
        cls,
        setup: FoamSetup,
        floor_below_m: float = 0.05,
        settings: SceneSettings | None = None,
        rng: np.random.Generator | None = None,
    ) -> Self:
        """Create a tracker for the camera of a foam sensor; the strip's size is the sensor's.

        Parameters
        ----------
        setup
            Configuration of the foam sensor.
        floor_below_m
            Height of the foam's visible edge above the floor [m].
        settings
            Regions and settings; the strip's size is replaced.
        rng
            Source of the random samples; a fixed seed without.
        """
        front = setup.geometry.front_m
        fitted = replace(
            settings or SceneSettings(),
            front_m=float(front[:, 0].max()),
            foam_half_m=float(np.abs(front[:, 1]).max())
            + 0.5 * float(np.median(np.diff(setup.geometry.s_m))),
        )
        return cls(setup.camera, setup.T_camera_foam, floor_below_m, fitted, rng)

    @property
    def sight_m(self) -> float:
        """Distance in front of the foam at which an obstacle can be detected."""
        return self._obstacles.sight_m

    def update(
        self,
        frame: Frame,
        profile: ForceProfile | None = None,
        base_state: BaseState | None = None,
        *,
        gyroscope_rad_s: float | None = None,
        primitive: Primitive | None = None,
    ) -> SceneReading:
        """Motion, obstacles and the touched object in one frame.

        Parameters
        ----------
        frame
            The next frame in time order.
        profile
            Reading of the foam in the same frame; without it no object is tracked.
        base_state, gyroscope_rad_s
            Odometry and turn rate of the platform, if there are any.
        primitive
            Shape of the contact, if it is known; by default it is fitted here.
        """
        if frame.image.shape[:2] != (self.camera.height, self.camera.width):
            raise InputError(
                "SceneTracker.update",
                f"found an image of {frame.image.shape[1]} x {frame.image.shape[0]}, "
                f"expected {self.camera.width} x {self.camera.height}",
            )
        grey, t_s = frame.grey, frame.t_s
        in_contact, face = self._follow_contact(profile, primitive)
        labels = (FLOOR,) if self._object.face is None else (FLOOR, OBJECT)
        step = self._points.update(grey, self._labels, labels=labels)
        expected = None
        if base_state is not None and np.isfinite(self.ego.velocity).all():
            expected = self._expected(base_state, t_s)
        if expected is not None and self._pushes(profile, float(expected[0])):
            step = self._sorted(step, expected)
        on_floor, on_object = step.of(FLOOR), step.of(OBJECT)
        floor = self._floor.update(on_floor, t_s, expected=expected)
        motion = self.ego.update(t_s, floor=floor, odometry=base_state, gyroscope_rad_s=gyroscope_rad_s)
        self._last_t_s = t_s
        fraction = 1.0
        if profile is not None and np.isfinite(profile.force_N):  # a frame that is not read has no force
            self._force_N = max(profile.force_N, 0.97 * self._force_N)
            fraction = profile.force_N / self._force_N if self._force_N > 0 else 1.0
        moved, events = self._object.update(on_object, t_s, in_contact=in_contact, force_fraction=fraction)
        self._points.drop(np.array(sorted(self._object.rejected), dtype=np.int64))
        # For a tilted object, a rotation about the vertical is no longer a rotation on the floor.
        stands = moved.valid and moved.tilt_rad < 0.2
        angle = float("nan")
        if stands:
            angle = self._angle_before + moved.turn_rad + float(self.ego.pose[2]) - self._heading
            self._angle = angle
        self._obstacle = self._obstacles.update(frame.image, motion)
        if face is not None:
            self._measure_face(*face)
        obstacle = self._near.update(self._obstacle, motion, in_contact)
        return SceneReading(
            t_s, motion, floor, self.ego.pose.copy(), self.ego.pose_covariance.copy(), moved, angle, events, obstacle,
            len(on_floor.ids), len(on_object.ids),
        )  # fmt: skip

    def _expected(self, state: BaseState, t_s: float) -> np.ndarray | None:
        if not t_s > self._last_t_s:
            return None
        dt, turn = t_s - self._last_t_s, state.turn_rate_rad_s
        ahead = self.settings.ego.foam_ahead_m
        return np.array([state.speed_m_s * dt, ahead * turn * dt, turn * dt])

    def _follow_contact(
        self, profile: ForceProfile | None, primitive: Primitive | None
    ) -> tuple[bool, tuple[Contact, Primitive | None, float] | None]:
        """Whether there is a contact, and the contact, shape and half width if its face is to be measured.

        That is at the first contact, and again when it has become wider. An object without contact
        for a long time is released.
        """
        contact = None if profile is None else profile.max_contact
        if contact is None:
            self._without += 1
            if self._object.face is not None and self._without > self.settings.lost_contact_frames:
                self._object.stop()
                self._points.forget(OBJECT)
                self._regions.forget()
                self._angle = self._angle_before = 0.0
            return False, None
        self._without = 0
        # Beside the object the foam is dragged along: there is a face only behind compressed foam.
        pressed = contact.points_foam_m[contact.delta_m > 0.5 * np.max(contact.delta_m, initial=0.0)]
        reach = 0.5 * float(np.ptp(pressed[:, 1])) if len(pressed) else 0.0
        width = max(reach - self.settings.object_margin_m, 0.01)
        begins = self._object.face is None
        # The first contact is narrow: its line is more accurate after more compression.
        wider = width > self.settings.widening * self._half_width_m and self._object.stands
        if not ((begins or wider) and len(contact.points_foam_m) >= 2):
            return True, None
        return True, (contact, primitive if primitive is not None else _shape_of(contact), width)

    def _measure_face(self, contact: Contact, shape: Primitive | None, half_width_m: float) -> None:
        """Measure the face again from the current contact, and select points on it."""
        begins = self._object.face is None
        # A contact of a few millimetres has no information about the face, one of 10 cm determines it almost completely.
        known = min(1.0, 0.02 / half_width_m)
        self._object.start(
            contact_face(contact, shape),
            face_curvature(shape),
            direction_sigma_rad=0.01 + 0.15 * known,
            curvature_sigma_per_m=1.0 + 5.0 * known,
            another=begins,
        )
        self._half_width_m = half_width_m
        self._angle_before = 0.0 if begins else self._angle
        self._heading = float(self.ego.pose[2])
        self._flat_angle = float("nan") if begins else self._flat_angle
        if shape is not None and shape.kind in (PrimitiveKind.LINE, PrimitiveKind.SEGMENT):
            # For a flat face, two contacts determine the rotation in between more accurately than the texture.
            along = contact_face(contact, shape).rotation[:, 0]
            in_world = float(np.arctan2(along[0], -along[1])) + self._heading
            if np.isfinite(self._flat_angle):
                self._angle_before = in_world - self._flat_angle
            self._flat_angle = in_world - self._angle_before
        if begins:
            self._force_N = float(np.nan_to_num(contact.force_N))
        self._points.forget(OBJECT)
        regions = self._labels()
        # Points assumed to be on the floor may be on the object.
        self._points.forget(FLOOR, outside=regions)
        self._points.choose(regions)

    def _pushes(self, profile: ForceProfile | None, ahead_m: float) -> bool:
        """Whether the touched object moves with the platform: the foam is no longer compressed further."""
        before = self._deflection_m
        seen = profile is not None and profile.contacts
        self._deflection_m = float(np.nanmax(profile.delta_m)) if profile is not None and seen else 0.0
        return bool(seen) and before > 0.0 and self._deflection_m - before < 0.3 * ahead_m

    def _sorted(self, step: FlowStep, expected: np.ndarray) -> FlowStep:
        """Remove points whose motion shows that they are on the other surface, floor or object.

        A pushed object is static in the image while the floor moves.
        """
        floor = self.floor_view.cast(step.before_px)
        passed = self.floor_view.project((floor - expected[:2]) @ rotation_2d(expected[2]))
        flow = step.after_px - step.before_px
        predicted = passed - step.before_px
        way = np.linalg.norm(predicted, axis=1)
        discriminative = np.isfinite(way) & (way > self.settings.min_discriminative_flow_px)
        still = discriminative & (np.linalg.norm(flow, axis=1) < 0.3 * way)
        passes = discriminative & (np.linalg.norm(flow - predicted, axis=1) < 0.3 * way)
        wrong_floor = still & (step.label == FLOOR)
        # A few floor points may disagree with the odometry by chance, or the start of the object's motion be detected late.
        wrong_object = passes & (step.label == OBJECT)
        for label, wrong in ((FLOOR, wrong_floor), (OBJECT, wrong_object)):
            self._regions.exclude(label, step.after_px[wrong])
        if wrong_floor.any() or wrong_object.any():
            self._points.drop(step.ids[wrong_floor | wrong_object])
        return step.without(wrong_floor | wrong_object)

    def _labels(self) -> UInt8[np.ndarray, "rows columns"]:
        return self._regions.labels(self._obstacle, self._object, self._half_width_m)


def _shape_of(contact: Contact) -> Primitive | None:
    """The best-fitting primitive of the contact so far."""
    from ..push.primitives import fit_contact

    return fit_contact(contact).best if len(contact.points_foam_m) >= 5 else None
