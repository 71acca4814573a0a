"""What else the foam's camera sees: obstacles ahead, the floor that passes, the object that is pushed (Sec. 3.5).

One call per frame. Points are tracked on floor patches left and right of the foam and, during
a contact, on the object's face above it; the upper strip of the image is watched for what comes near.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Self

import numpy as np
from jaxtyping import Bool, Float, UInt8

from ...core.camera.frame import Frame
from ...core.camera.model import Camera
from ...core.camera.plane import PlaneView
from ...core.camera.pose import Pose
from ...core.errors import InputError
from ...core.measurement import Contact, Event, ForceProfile, Motion
from ...core.objects import Primitive, PrimitiveKind
from ...core.robots import BaseState
from ...tracking.points.flow import FlowSettings, FlowStep, PointTracker
from .contact_surface import contact_face, face_curvature
from .ego_motion import EgoMotionFilter, EgoMotionSettings
from .floor_motion import FloorMotionSettings, FloorTracker
from .object_motion import ObjectMotion, ObjectMotionSettings, ObjectTracker
from .obstacle_mask import MixtureSettings, Obstacle, ObstacleDetector
from .obstacle_memory import NearMemory

if TYPE_CHECKING:
    from ..foam.strip.config import FoamSetup

__all__ = ["SceneReading", "SceneSettings", "SceneTracker"]

FLOOR, OBJECT = 1, 2
#: Edge of the cells in which it is remembered what is not floor, and what is not the object [px].
_CELL_PX = 16


@dataclass(frozen=True, slots=True)
class SceneSettings:
    """Where to look, and how."""

    flow: FlowSettings = field(default_factory=FlowSettings)
    floor: FloorMotionSettings = field(default_factory=FloorMotionSettings)
    ego: EgoMotionSettings = field(default_factory=EgoMotionSettings)
    object: ObjectMotionSettings = field(default_factory=ObjectMotionSettings)
    obstacles: MixtureSettings = field(default_factory=MixtureSettings)
    front_m: float = 0.02  #: x of the foam's front at rest, frame F
    foam_half_m: float = 0.125  #: half length of the foam along y
    patch_inner_m: float = 0.06  #: floor patches begin so far left and right of the middle
    object_height_m: float = 0.12  #: points on the object are chosen up to this height above the foam
    object_margin_m: float = 0.004  #: and so far inside of the contact's ends
    beside_m: float = 0.04  #: no floor is looked for so near beside the contact
    max_width_px: int = 800  #: images wider than this are binned for the tracks
    lost_contact_frames: int = 20  #: without contact for so long: the next contact is another object
    min_discriminative_flow_px: float = (
        1.0  #: flow of the floor from which a point tells whether it is on the floor
    )
    widening: float = 1.6  #: a contact that has become wider by this factor shows its face better

    def __post_init__(self) -> None:
        if not (self.foam_half_m > 0 and self.object_height_m > 0 and self.max_width_px >= 100):
            raise InputError(
                "SceneSettings",
                f"found foam_half_m {self.foam_half_m}, object_height_m {self.object_height_m}, "
                f"max_width_px {self.max_width_px}; expected > 0, > 0, >= 100",
            )


@dataclass(frozen=True, slots=True, eq=False)
class SceneReading:
    """What one frame tells of the surroundings."""

    t_s: float
    motion: Motion  #: of frame F since the last frame, floor and odometry fused
    floor_motion: Motion  #: the part that the floor alone tells
    pose: Float[np.ndarray, "3"]  #: (x, y, heading) of frame F since the begin [m, rad]
    pose_covariance: Float[np.ndarray, "3 3"]  #: of ``pose``
    object_motion: ObjectMotion  #: since the contact began
    object_angle_rad: float  #: turn of the object in the world since then; NaN when it is not seen
    events: tuple[Event, ...]  #: FALL and SLIP
    obstacle: Obstacle
    floor_points: int
    object_points: int

    @property
    def mask(self) -> UInt8[np.ndarray, "rows columns"]:
        """255 where the upper strip is not floor, in bins of ``obstacle.binning`` pixels."""
        return self.obstacle.mask

    @property
    def proximity_m(self) -> float:
        """Distance of the nearest obstacle ahead of the foam; inf = free, NaN = not known."""
        return self.obstacle.proximity_m


class SceneTracker:
    """Everything around the foam, frame by frame.

    Parameters
    ----------
    camera, T_camera_foam
        The sensor's camera and where frame F is in it.
    floor_below_m
        Height of the foam's visible edge above the floor.
    rng
        Of RANSAC.

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
        if not floor_below_m > 0:
            raise InputError("SceneTracker", f"found {floor_below_m} m, expected > 0", field="floor_below_m")
        self.settings = s = settings or SceneSettings()
        self.camera, self.T_camera_foam = camera, T_camera_foam
        below = Pose(np.eye(3), np.array([0.0, 0.0, -floor_below_m]))
        self.floor_view = PlaneView(camera, T_camera_foam @ below)
        binning = max(s.flow.binning, -(-camera.width // s.max_width_px))
        self._hidden, self._patches, last = self._static_regions()
        self._points = PointTracker(replace(s.flow, binning=binning), rows=(0, last))
        self._floor = FloorTracker(self.floor_view, s.floor, rng)
        self.ego = EgoMotionFilter(s.ego)
        self._object = ObjectTracker(camera, T_camera_foam, s.object)
        self._obstacles = ObstacleDetector(self.floor_view, s.front_m, s.obstacles)
        self._near = NearMemory(self._obstacles.blind_m)
        self._half_width_m, self._without, self._heading = 0.0, 0, 0.0
        self._angle, self._angle_before = 0.0, 0.0
        self._flat_angle = float("nan")  # direction of a flat face, less the turn that it had then
        self._deflection_m = 0.0
        # Where points have shown to be on something else, in cells of so many pixels, for a contact.
        self._not_floor = np.zeros((-(-camera.height // _CELL_PX), -(-camera.width // _CELL_PX)), np.uint8)
        self._not_object = self._not_floor.copy()
        self._last_t_s = float("nan")
        self._force_N = 0.0  # largest of the contact, slowly forgotten

    @classmethod
    def of_sensor(
        cls,
        setup: FoamSetup,
        floor_below_m: float = 0.05,
        settings: SceneSettings | None = None,
        rng: np.random.Generator | None = None,
    ) -> Self:
        """The surroundings of a foam sensor, through its own camera; the strip's size is the sensor's."""
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
        """How far ahead of the foam an obstacle can be seen."""
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
        """Look at one frame.

        Parameters
        ----------
        profile
            What the foam read from the same frame; without it no object is tracked.
        base_state, gyroscope_rad_s
            Odometry and turn rate of the platform, if there are any.
        primitive
            Shape fitted to the contact; without it the contact is taken as straight.
        """
        if frame.image.shape[:2] != (self.camera.height, self.camera.width):
            raise InputError(
                "SceneTracker.update",
                f"found an image of {frame.image.shape[1]} x {frame.image.shape[0]}, "
                f"expected {self.camera.width} x {self.camera.height}",
            )
        grey, t_s = frame.grey, frame.t_s
        obstacle = self._obstacles.update(frame.image)
        in_contact, face = self._follow_contact(profile, primitive)
        labels = (FLOOR,) if self._object.face is None else (FLOOR, OBJECT)
        step = self._points.update(grey, lambda: self._regions(obstacle), labels=labels)
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
        if profile is not None:
            self._force_N = max(profile.force_N, 0.97 * self._force_N)
            fraction = profile.force_N / self._force_N if self._force_N > 0 else 1.0
        moved, events = self._object.update(on_object, t_s, in_contact=in_contact, force_fraction=fraction)
        self._points.drop(np.array(sorted(self._object.rejected), dtype=np.int64))
        # Once it leans, a turn about the vertical is no longer a turn on the floor.
        stands = moved.valid and moved.tilt_rad < 0.2
        angle = float("nan")
        if stands:
            angle = self._angle_before + moved.turn_rad + float(self.ego.pose[2]) - self._heading
            self._angle = angle
        if face is not None:
            self._look_afresh(*face, obstacle)
        obstacle = self._near.update(obstacle, motion, in_contact)
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
        """Whether something is touched, and its contact, shape and half width where its face is to be looked at.

        That is at the first contact, and again when it has become wider. Lets go of an object that
        has not been felt for long.
        """
        contact = None
        if profile is not None:
            contact = max((c for c in profile.contacts), key=lambda c: c.force_N, default=None)
        if contact is None:
            self._without += 1
            if self._object.face is not None and self._without > self.settings.lost_contact_frames:
                self._object.stop()
                self._points.forget(OBJECT)
                self._not_floor[:], self._not_object[:] = 0, 0
                self._angle = self._angle_before = 0.0
            return False, None
        self._without = 0
        # Beside the object the foam is drawn along: only where it is pressed is there a face behind.
        pressed = contact.points_foam_m[contact.delta_m > 0.5 * np.max(contact.delta_m, initial=0.0)]
        reach = 0.5 * float(np.ptp(pressed[:, 1])) if len(pressed) else 0.0
        width = max(reach - self.settings.object_margin_m, 0.01)
        begins = self._object.face is None
        # The first touch is a narrow one: the contact's line is known better once the foam has given way.
        wider = width > self.settings.widening * self._half_width_m and self._object.stands
        if not ((begins or wider) and len(contact.points_foam_m) >= 2):
            return True, None
        return True, (contact, primitive if primitive is not None else _shape_of(contact), width)

    def _look_afresh(
        self, contact: Contact, shape: Primitive | None, half_width_m: float, obstacle: Obstacle
    ) -> None:
        """Take the face as the contact shows it now, and choose points on it."""
        begins = self._object.face is None
        # A contact of a few millimetres knows nothing of the face, one of 10 cm all but everything.
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
            # A flat face that is felt twice tells the turn in between better than the texture.
            along = contact_face(contact, shape).rotation[:, 0]
            in_world = float(np.arctan2(along[0], -along[1])) + self._heading
            if np.isfinite(self._flat_angle):
                self._angle_before = in_world - self._flat_angle
            self._flat_angle = in_world - self._angle_before
        if begins:
            self._force_N = contact.force_N
        self._points.forget(OBJECT)
        regions = self._regions(obstacle)
        # Points that were taken for floor may be on the object.
        self._points.forget(FLOOR, outside=regions)
        self._points.choose(regions)

    def _pushes(self, profile: ForceProfile | None, ahead_m: float) -> bool:
        """Whether what is touched moves with the platform: the foam no longer gives way as it goes on."""
        before = self._deflection_m
        seen = profile is not None and profile.contacts
        self._deflection_m = float(np.nanmax(profile.delta_m)) if profile is not None and seen else 0.0
        return bool(seen) and before > 0.0 and self._deflection_m - before < 0.3 * ahead_m

    def _sorted(self, step: FlowStep, expected: np.ndarray) -> FlowStep:
        """Without the points that the platform's way shows to be on the other thing, floor or object.

        What is pushed stands still in the picture while the floor passes.
        """
        floor = self.floor_view.cast(step.before_px)
        c, s = np.cos(expected[2]), np.sin(expected[2])
        passed = self.floor_view.project((floor - expected[:2]) @ np.array([[c, -s], [s, c]]))
        flow = step.after_px - step.before_px
        told = passed - step.before_px
        way = np.linalg.norm(told, axis=1)
        telling = np.isfinite(way) & (way > self.settings.min_discriminative_flow_px)
        still = telling & (np.linalg.norm(flow, axis=1) < 0.3 * way)
        passes = telling & (np.linalg.norm(flow - told, axis=1) < 0.3 * way)
        wrong_floor = still & (step.label == FLOOR)
        # Few floor points may disagree with the wheels by chance, or the object be seen to start late.
        wrong_object = passes & (step.label == OBJECT)
        for wrong, cells in ((wrong_floor, self._not_floor), (wrong_object, self._not_object)):
            at = np.clip(step.after_px[wrong] / _CELL_PX, 0, np.array(cells.shape[::-1]) - 1).astype(int)
            cells[at[:, 1], at[:, 0]] = 1
        if wrong_floor.any() or wrong_object.any():
            self._points.drop(step.ids[wrong_floor | wrong_object])
        return step.without(wrong_floor | wrong_object)

    def _static_regions(
        self,
    ) -> tuple[Bool[np.ndarray, "rows columns"], UInt8[np.ndarray, "rows columns"], int]:
        """What the sensor hides, the floor patches, and the last row that matters."""
        import cv2

        s, n = self.settings, 4
        rows, columns = self.camera.height, self.camera.width
        v, u = np.mgrid[0:rows:n, 0:columns:n].astype(np.float64)
        pixels = np.stack([u, v], axis=-1)
        top = PlaneView(self.camera, self.T_camera_foam).cast(pixels)
        floor = self.floor_view.cast(pixels)
        # The body reaches a little beyond the foam's ends, the side of the foam is seen below its edge.
        hidden = (top[..., 0] < s.front_m + 0.004) & (np.abs(top[..., 1]) < s.foam_half_m + 0.035)
        hidden |= top[..., 0] < 0.0
        side = (floor[..., 0] < s.front_m + 0.004) & (np.abs(floor[..., 1]) < s.foam_half_m + 0.01)
        hidden |= side | ~np.isfinite(floor[..., 0])
        hidden = cv2.dilate(hidden.astype(np.uint8), np.ones((5, 5), np.uint8))
        patches = ((hidden == 0) & (np.abs(floor[..., 1]) > s.patch_inner_m)).astype(np.uint8)
        full = [np.kron(a, np.ones((n, n), np.uint8))[:rows, :columns] for a in (hidden, patches)]
        border = max(8, columns // 60)
        full[1][:border] = full[1][-border:] = full[1][:, :border] = full[1][:, -border:] = 0
        free = np.flatnonzero((full[0] == 0).any(axis=1))
        last = min(rows, int(free[-1]) + 40) if len(free) else rows
        return full[0] > 0, full[1], last

    def _regions(self, obstacle: Obstacle) -> UInt8[np.ndarray, "rows columns"]:
        """Where to choose points in this frame."""
        import cv2

        regions, s = self._patches.copy(), self.settings
        n = obstacle.binning
        # Below what stands in the strip there is no floor but the lower part of the same thing.
        if obstacle.valid:
            standing = np.repeat(np.count_nonzero(obstacle.mask, axis=0) > 0.15 * obstacle.mask.shape[0], n)
            columns = np.zeros(self.camera.width, bool)
            columns[: len(standing)] = standing
            regions[:, columns] = 0
        if self._object.face is not None:
            polygon = self._face_polygon(s.object_height_m)
            # An object is wider than its contact: the floor begins some centimetres beside it.
            whole = self._face_polygon(np.inf, s.beside_m)
            if polygon is not None and whole is not None:
                clear, above = np.zeros_like(regions), np.zeros_like(regions)
                cv2.fillConvexPoly(clear, polygon, 1)
                cv2.fillConvexPoly(above, whole, 1)
                regions[above > 0] = 0
                regions[(clear > 0) & ~self._hidden] = OBJECT
            for label, cells in ((FLOOR, self._not_floor), (OBJECT, self._not_object)):
                if cells.any():
                    size = (cells.shape[1] * _CELL_PX, cells.shape[0] * _CELL_PX)
                    large = cv2.resize(cells, size, interpolation=cv2.INTER_NEAREST)
                    regions[(large[: regions.shape[0], : regions.shape[1]] > 0) & (regions == label)] = 0
        return regions

    def _face_polygon(self, height_m: float, beside_m: float = 0.0) -> np.ndarray | None:
        """The part of the object's face above the foam, where it is now [px]."""
        assert self._object.face is not None
        a = self._half_width_m + beside_m
        eye_z = float(self.T_camera_foam.inverse().translation_m[2])
        high = min(height_m, 0.85 * eye_z)
        corners = np.array([[-a, 0.003, 0.0], [a, 0.003, 0.0], [a, high, 0.0], [-a, high, 0.0]])
        placed = self._object.moved(self._object.face.apply(corners))
        pixels = self.camera.project(self.T_camera_foam.apply(placed))
        if not np.isfinite(pixels).all() or np.abs(pixels).max() > 1e5:
            return None
        return np.rint(pixels).astype(np.int32)


def _shape_of(contact: Contact) -> Primitive | None:
    """The primitive that fits the contact so far."""
    from ..push.primitives import fit_contact

    return fit_contact(contact).best if len(contact.points_foam_m) >= 5 else None
