"""The sensor camera's picture of a :class:`FoamScene`, with exact sub-pixel truth.

Layers are drawn from far to near, each with the exact area that it covers of every pixel:
floor, objects (whole prisms), top of the foam, parts of objects that lean
over the foam, robot body, occluders. Where two layers share a border the
nearer one is drawn over a farther one that goes on below it, so that no third surface
shines through. A Gaussian then blurs the picture: an edge is the step convolved
with the pixel's square and the lens.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Float32, UInt8

from ..camera import Camera, Pose
from ..errors import InputError
from ._canvas import Canvas, Hole, Plane
from .contour_truth import ContourTruth
from .effects import CameraEffects
from .look import Look, Occluder, Surface
from .rolling_view import NEAR_M, RollingView, cut_polygon
from .scene import FoamScene, SceneObject
from .shadow import shade_floor

__all__ = [
    "CameraEffects",
    "CameraShake",
    "ContourTruth",
    "Look",
    "Occluder",
    "SceneLike",
    "SceneRenderer",
    "Surface",
]

#: A scene that stands still, or one that moves with time [s].
SceneLike = FoamScene | Callable[[float], FoamScene]

#: Movement of the camera: maps coordinates of the resting camera to the moved one, by time [s].
CameraShake = Callable[[float], Pose]

#: The foam goes on this far below the body, so that nothing else shows at their border [m].
UNDER_BODY_M = 0.004


@dataclass(frozen=True, slots=True, eq=False)
class _Moment:
    """A frame's view and the states of its scene at the K keys."""

    view: RollingView
    scenes: tuple[FoamScene, ...]
    row_times_s: Float[np.ndarray, "rows"]

    @property
    def middle(self) -> FoamScene:
        return self.scenes[len(self.scenes) // 2]

    def points(self, name: str) -> Float[np.ndarray, "n K 2"]:
        """``back_m`` or ``front_m`` at each key."""
        return np.stack([np.asarray(getattr(s, name), dtype=np.float64) for s in self.scenes], axis=1)

    def outline(self, index: int) -> Float[np.ndarray, "n K 2"]:
        """Outline of an object at each key, counter-clockwise."""
        outline = np.stack(
            [np.asarray(s.objects[index].outline_foam_m, dtype=np.float64) for s in self.scenes], axis=1
        )
        x, y = np.moveaxis(outline[:, len(self.scenes) // 2], -1, 0)
        area = x @ np.roll(y, -1) - y @ np.roll(x, -1)
        return outline if area > 0 else outline[::-1]


class SceneRenderer:
    """Draws what the sensor's camera sees.

    Parameters
    ----------
    camera
        Lens, size and row timing.
    pose_camera_foam
        Maps frame F of the sensor to the resting camera.
    look, effects
        Surfaces, and what lens and sensor do to the picture.
    shutter_keys
        Number of states that are computed over the readout of a frame when something moves;
        between them pixels are interpolated by cubics. Motion of frequency f and
        amplitude A px leaves an error of about ``0.02 (2 pi f T / (keys - 1))^4 A`` for
        a readout of T.

    Examples
    --------
    >>> import numpy as np
    >>> camera = Camera.simple(320, 180, 360.0)
    >>> pose = camera.pose_of_view((-0.1, 0, 0.28), (0.02, 0, 0)).inverse()
    >>> y = np.linspace(-0.1, 0.1, 21)
    >>> back = np.column_stack([np.zeros(21), y])
    >>> scene = FoamScene(0.0, back, back + [0.02, 0])
    >>> renderer = SceneRenderer(camera, pose)
    >>> renderer.render(scene, rng=np.random.default_rng(0)).shape
    (180, 320)
    >>> truth = renderer.truth(scene)
    >>> foot = truth.back_px[10]  # a straight strip: 2 cm at 0.3 m are about 23 px
    >>> bool(20 < truth.front_at(foot, [0.0, -1.0])[0] < 26)
    True
    """

    def __init__(
        self,
        camera: Camera,
        pose_camera_foam: Pose,
        look: Look | None = None,
        effects: CameraEffects | None = None,
        *,
        shutter_keys: int = 9,
    ) -> None:
        if shutter_keys < 4:
            raise InputError("SceneRenderer", f"found {shutter_keys}, expected >= 4", field="shutter_keys")
        self.camera = camera
        self.pose_camera_foam = pose_camera_foam
        self.look = look or Look()
        self.effects = effects or CameraEffects()
        self.shutter_keys = shutter_keys
        self._canvas = Canvas(camera, 3 if self.look.colour else 1)

    def render(
        self,
        scene: SceneLike,
        *,
        rng: np.random.Generator,
        t_s: float | None = None,
        camera_shake: CameraShake | None = None,
        occluders: Sequence[Occluder] = (),
    ) -> UInt8[np.ndarray, "rows columns *colour"]:
        """The picture that the camera delivers.

        Parameters
        ----------
        scene
            A scene, or a function of time that gives one; objects and points keep their order.
        rng
            Source of the noise; the same state gives the same picture.
        t_s
            Exposure of the first row [s]; by default the scene's time, needed for a function.
        camera_shake
            Motion of the camera, maps the resting camera's frame to the moved one.
        occluders
            Things in front of the scene, the last one is nearest.
        """
        exact, row_times_s = self._exact(scene, t_s, camera_shake, occluders)
        image = self.effects.developed(exact, row_times_s, rng)
        return image if self.look.colour else image[..., 0]

    def render_exact(
        self,
        scene: SceneLike,
        *,
        t_s: float | None = None,
        camera_shake: CameraShake | None = None,
        occluders: Sequence[Occluder] = (),
    ) -> Float32[np.ndarray, "rows columns *colour"]:
        """The blurred picture before light, gain, noise and rounding; a copy."""
        exact, _ = self._exact(scene, t_s, camera_shake, occluders)
        return (exact if self.look.colour else exact[..., 0]).copy()

    def truth(
        self, scene: SceneLike, *, t_s: float | None = None, camera_shake: CameraShake | None = None
    ) -> ContourTruth:
        """Exact image curves of the contours; arguments as in :meth:`render`."""
        moment = self._moment(scene, t_s, camera_shake)
        back, front = moment.points("back_m"), moment.points("front_m")
        curves = [
            moment.view.polyline(_at_height(points, 0.0))
            for points in (back, front, _stripe(back, front, self.look.stripe_width_m))
        ]
        return ContourTruth(
            curves[0],
            curves[1],
            curves[2] if self.look.stripe is not None else np.zeros((0, 2)),
            self._front_visible(moment, front),
        )

    def _moment(self, scene: SceneLike, t_s: float | None, shake: CameraShake | None) -> _Moment:
        rows = np.arange(self.camera.height)
        if t_s is None:
            if not isinstance(scene, FoamScene):
                raise InputError("SceneRenderer", "a scene that moves with time needs t_s", field="t_s")
            t_s = scene.t_s
        moves = self.camera.row_delay_s > 0 and (shake is not None or not isinstance(scene, FoamScene))
        key_rows = np.linspace(0, self.camera.height - 1, self.shutter_keys) if moves else np.zeros(1)
        times = self.camera.row_time_s(t_s, key_rows)
        scenes = tuple(scene if isinstance(scene, FoamScene) else scene(float(t)) for t in times)
        shapes = {
            (s.back_m.shape, s.front_m.shape, *(o.outline_foam_m.shape for o in s.objects)) for s in scenes
        }
        if len(shapes) > 1 or scenes[0].back_m.shape != scenes[0].front_m.shape or len(scenes[0].back_m) < 2:
            raise InputError(
                "SceneRenderer",
                "expected back and front contour with the same number of points (at least 2), "
                f"and the same objects during a frame; found shapes {sorted(map(str, shapes))}",
                field="scene",
            )
        poses = tuple(
            self.pose_camera_foam if shake is None else shake(float(t)) @ self.pose_camera_foam for t in times
        )
        return _Moment(RollingView(self.camera, poses, key_rows), scenes, self.camera.row_time_s(t_s, rows))

    def _exact(
        self,
        scene: SceneLike,
        t_s: float | None,
        shake: CameraShake | None,
        occluders: Sequence[Occluder],
    ) -> tuple[Float32[np.ndarray, "rows columns channels"], Float[np.ndarray, "rows"]]:
        effects = self.effects
        middle = self._moment(scene, t_s, shake)
        if effects.exposure_s > 0 and effects.exposure_samples > 1:
            count = effects.exposure_samples
            total = np.zeros_like(self._canvas.image)
            for shift in (np.arange(count) + 0.5) / count - 0.5:
                at = float(middle.row_times_s[0] + shift * effects.exposure_s)
                self._draw(self._moment(scene, at, shake), occluders)
                total += self._canvas.image
            total *= np.float32(1 / count)
            return effects.blurred(total), middle.row_times_s
        self._draw(middle, occluders)
        return effects.blurred(self._canvas.image), middle.row_times_s

    def _draw(self, moment: _Moment, occluders: Sequence[Occluder]) -> None:
        canvas, view = self._canvas, moment.view
        self._draw_floor(moment)
        centre = view.centre_foam_m
        back, front = moment.points("back_m"), moment.points("front_m")
        self._draw_foam_side(moment, back, front, centre)
        lean: list[Hole] = []
        foam = _closed(front, _shifted_back(back, UNDER_BODY_M))
        # Far objects first: the nearest point of each outline decides.
        outlines = [moment.outline(i) for i in range(len(moment.middle.objects))]
        mid = view.keys // 2
        order = sorted(
            range(len(outlines)),
            key=lambda i: -np.linalg.norm(outlines[i][:, mid] - centre[:2], axis=1).min(),
        )
        for i in order:
            planes, polygons = self._prism(moment, moment.middle.objects[i], outlines[i], centre)
            canvas.paint_parts(polygons, planes)
            for part, sign in _leaning(
                foam, outlines[i][:, mid], moment.middle.objects[i].top_m, centre, mid
            ):
                pixels = view.polygon(view.to_camera(_at_height(part, 0.0)))
                lean.append((pixels, sign, planes, polygons))
        self._draw_foam_top(moment, foam, back, front, lean)
        self._draw_body(moment, back)
        for occluder in occluders:
            self._draw_occluder(moment, occluder)

    def _plane(
        self,
        moment: _Moment,
        surface: Surface,
        origin: np.ndarray,
        along_a: np.ndarray,
        along_b: np.ndarray,
        gradient: tuple[float, float, float] = (1.0, 0.0, 0.0),
    ) -> Plane:
        """Plane whose origin and axes in F are (3,) or (K, 3)."""
        keys = moment.view.keys
        matrices = moment.view.plane_matrices(
            *(np.broadcast_to(v, (keys, 3)) for v in (origin, along_a, along_b))
        )
        return Plane(matrices, surface, np.asarray(gradient))

    def _draw_floor(self, moment: _Moment) -> None:
        origins, a, b = [], [], []
        tile_m = self._canvas.tile_m(self.look.floor)
        for scene in moment.scenes:
            world = scene.pose_world_foam
            # The nearest corner of the tiling keeps texture coordinates small far from the world's origin.
            corner = np.round(moment.middle.pose_world_foam.translation_m[:2] / tile_m) * tile_m
            below = world.apply(np.array([0.0, 0.0, -scene.floor_below_m]))[2]
            origins.append(world.inverse().apply(np.array([*corner, below])))
            a.append(world.rotation[0])
            b.append(world.rotation[1])
        plane = self._plane(moment, self.look.floor, np.array(origins), np.array(a), np.array(b))
        self._canvas.fill(plane)
        if self.look.shadow > 0:
            mid = moment.view.keys // 2
            outlines = [moment.outline(i)[:, mid] for i in range(len(moment.middle.objects))]
            strip = _closed(moment.points("front_m"), moment.points("back_m"))[:, mid]
            shade_floor(self._canvas.image, moment.view, moment.middle, [*outlines, strip], self.look)

    def _prism(
        self, moment: _Moment, item: SceneObject, outline: np.ndarray, centre: np.ndarray
    ) -> tuple[list[Plane], list[np.ndarray]]:
        """Visible faces of an upright prism, as planes and polygons [px]."""
        view = moment.view
        mid = view.keys // 2
        surface = Surface(item.grey, item.texture, item.material, item.bgr, item.seed)
        low = -moment.middle.floor_below_m
        planes, polygons = [], []
        ends = np.roll(outline, -1, axis=0)
        run = 0.0
        for start, end in zip(outline, ends, strict=True):
            edge = end[mid] - start[mid]
            length = float(np.hypot(*edge))
            run += length
            if length < 1e-9:
                continue
            normal = np.array([edge[1], -edge[0]]) / length
            if (centre[:2] - start[mid]) @ normal <= 0:
                continue
            face = np.stack([start, end, end, start])
            heights = np.array([low, low, item.top_m, item.top_m])
            points = np.concatenate(
                [face, np.broadcast_to(heights[:, None, None], (4, view.keys, 1))], axis=-1
            )
            polygon = view.polygon(view.to_camera(points))
            if len(polygon) < 3:
                continue
            # Texture runs on around the corners: a grows with the outline's length, minus the face's own.
            direction = (end - start) / length
            origin = np.concatenate([start - (run - length) * direction, np.zeros((view.keys, 1))], axis=-1)
            along = np.concatenate([direction, np.zeros((view.keys, 1))], axis=-1)
            facing = float(-normal[0] + 0.5 * normal[1])
            light = 1.0 + self.look.face_contrast * (facing - 0.9) * 0.6
            planes.append(
                self._plane(moment, surface, origin, along, np.array([0, 0, 1.0]), (light, 0.0, 0.0))
            )
            polygons.append(polygon)
        if centre[2] > item.top_m + NEAR_M:
            polygon = view.polygon(view.to_camera(_at_height(outline, item.top_m)))
            if len(polygon) >= 3:
                light = 1.0 + 0.5 * self.look.face_contrast
                origin = np.concatenate([outline[0], np.full((view.keys, 1), item.top_m)], axis=-1)
                edge = outline[1] - outline[0]
                edge = edge / np.linalg.norm(edge, axis=1, keepdims=True)
                zero = np.zeros((view.keys, 1))
                a = np.concatenate([edge, zero], axis=-1)
                b = np.concatenate([-edge[:, 1:], edge[:, :1], zero], axis=-1)
                planes.append(self._plane(moment, surface, origin, a, b, (light, 0.0, 0.0)))
                polygons.append(polygon)
        return planes, polygons

    def _draw_foam_side(
        self, moment: _Moment, back: np.ndarray, front: np.ndarray, centre: np.ndarray
    ) -> None:
        """Side faces of the strip that look at the camera: front and both ends."""
        view = moment.view
        mid = view.keys // 2
        outline = np.concatenate([back[:1], front, back[-1:]])
        dark = (0.8, 0.0, 0.0)
        for start, end in pairwise(outline):
            edge = end[mid] - start[mid]
            # The outline runs with the strip, so the outside is on its right.
            if (centre[:2] - start[mid]) @ np.array([edge[1], -edge[0]]) <= 0 or not edge.any():
                continue
            # Reaches a little above the top, which is drawn over it: no gap at their common edge.
            face = np.stack([start, end, end, start])
            height = self.look.foam_height_m
            heights = np.array([-height, -height, 0.1 * height, 0.1 * height])
            points = np.concatenate(
                [face, np.broadcast_to(heights[:, None, None], (4, view.keys, 1))], axis=-1
            )
            polygon = view.polygon(view.to_camera(points))
            if len(polygon) < 3:
                continue
            origin = np.append(start[mid], 0.0)
            along = np.append(edge / np.linalg.norm(edge), 0.0)
            plane = self._plane(moment, self.look.foam, origin, along, np.array([0, 0, 1.0]), dark)
            self._canvas.paint_parts([polygon], [plane])

    def _draw_foam_top(
        self,
        moment: _Moment,
        foam: np.ndarray,
        back: np.ndarray,
        front: np.ndarray,
        lean: list[Hole],
    ) -> None:
        view, look = moment.view, self.look
        axes = (np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]))
        plane = self._plane(moment, look.foam, *axes)
        polygons, planes = [view.polygon(view.to_camera(_at_height(foam, 0.0)))], [plane]
        if look.stripe is not None:
            inner = _closed(_stripe(back, front, look.stripe_width_m), _shifted_back(back, UNDER_BODY_M))
            polygons.append(view.polygon(view.to_camera(_at_height(inner, 0.0))))
            planes = [self._plane(moment, look.stripe, *axes), plane]
        self._canvas.paint_nested(polygons, planes, lean)

    def _draw_body(self, moment: _Moment, back: np.ndarray) -> None:
        view = moment.view
        plane = self._plane(moment, self.look.body, np.zeros(3), np.array([0, 1.0, 0]), np.array([1.0, 0, 0]))
        margin = self.look.body_margin_m
        first, last = back[0] - back[1], back[-1] - back[-2]
        first = back[0] + margin * first / np.linalg.norm(first, axis=-1, keepdims=True)
        last = back[-1] + margin * last / np.linalg.norm(last, axis=-1, keepdims=True)
        edge = np.concatenate([first[None], back, last[None]])
        # Far behind: the view cuts what lies behind the camera.
        away = np.array([-1.0, 0.0])
        polygon = np.concatenate([edge, edge[-1:] + away, edge[:1] + away])
        self._canvas.paint_parts([view.polygon(view.to_camera(_at_height(polygon, 0.0)))], [plane])

    def _draw_occluder(self, moment: _Moment, occluder: Occluder) -> None:
        view, times = moment.view, moment.row_times_s
        active = (times >= occluder.start_s) & (times <= occluder.end_s)
        if not active.any():
            return
        outline = occluder.outline_at(float(times[len(times) // 2]))
        if occluder.height_m is None:
            # Fixed to the picture: its texture is cast to the sensor plane, only the outline matters.
            polygon, height = outline, 0.0
        else:
            height = occluder.height_m
            points = np.repeat(outline[:, None], view.keys, axis=1)
            polygon = view.polygon(view.to_camera(_at_height(points, height)))
        plane = self._plane(
            moment,
            occluder.surface,
            np.array([0, 0, height]),
            np.array([1.0, 0, 0]),
            np.array([0, 1.0, 0]),
        )
        self._canvas.paint_parts([polygon], [plane], None if active.all() else active)

    def _front_visible(self, moment: _Moment, front: np.ndarray) -> np.ndarray:
        centre, mid = moment.view.centre_foam_m, moment.view.keys // 2
        points = front[:, mid]
        visible = np.ones(len(points), dtype=bool)
        for i, item in enumerate(moment.middle.objects):
            outline = moment.outline(i)[:, mid]
            hull = _lean_hull(outline, item.top_m, centre)
            # Points that touch the object itself are on its near side, and seen.
            visible &= ~(_within(hull, points, 1e-6) & ~_within(outline, points, -1e-4))
        return visible


def _at_height(points_m: np.ndarray, z_m: float) -> np.ndarray:
    """Points (n, K, 2) of a plane at a height as (n, K, 3)."""
    return np.concatenate([points_m, np.full((*points_m.shape[:-1], 1), z_m)], axis=-1)


def _closed(front: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Polygon between two contours."""
    return np.concatenate([front, back[::-1]])


def _stripe(back: np.ndarray, front: np.ndarray, width_m: float) -> np.ndarray:
    """Inner edge of the stripe: its width behind the front, at most half way to the back."""
    across = back - front
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    share = np.minimum(width_m / np.maximum(length, 1e-12), 0.5)
    return front + share * across


def _shifted_back(back: np.ndarray, distance_m: float) -> np.ndarray:
    """The back contour moved into the body, along its normal."""
    tangent = np.gradient(back, axis=0)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    return back - distance_m * np.stack([tangent[..., 1], -tangent[..., 0]], axis=-1)


def _lean_hull(outline: np.ndarray, top_m: float, centre: np.ndarray) -> np.ndarray:
    """Convex region of the plane z = 0 that an upright prism hides or stands on, counter-clockwise."""
    from scipy.spatial import ConvexHull

    height = centre[2]
    scale = height / max(height - top_m, 0.02 * height) if top_m > 0 else 1.0
    points = np.concatenate([outline, centre[:2] + scale * (outline - centre[:2])])
    return points[ConvexHull(points).vertices]


def _within(polygon: np.ndarray, points: np.ndarray, margin_m: float) -> np.ndarray:
    """Whether points lie deeper than a margin inside a convex counter-clockwise polygon."""
    edge = np.roll(polygon, -1, axis=0) - polygon
    normal = (
        np.column_stack([-edge[:, 1], edge[:, 0]]) / np.maximum(np.linalg.norm(edge, axis=1), 1e-12)[:, None]
    )
    return (points @ normal.T - (polygon * normal).sum(axis=1) > margin_m).all(axis=1)


def _leaning(
    foam: np.ndarray, outline: np.ndarray, top_m: float, centre: np.ndarray, mid: int
) -> list[tuple[np.ndarray, float]]:
    """Polygons (n, K, 2) with signs whose sum is the foam hidden behind an upright prism.

    Hidden is what lies in the hull of the prism's shadow but not below the prism itself:
    there the foam touches it from the near side.
    """
    if (foam[:, mid, 0].max() < outline[:, 0].min()) and centre[0] < foam[:, mid, 0].min():
        return []
    result = []
    for region, sign in ((_lean_hull(outline, top_m, centre), 1.0), (outline, -1.0)):
        part = foam
        for start, end in zip(region, np.roll(region, -1, axis=0), strict=True):
            edge = end - start
            inside = (part[:, mid] - start) @ np.array([-edge[1], edge[0]])
            part = cut_polygon(part, inside)
            if len(part) < 3:
                break
        result.append((part, sign) if len(part) >= 3 else (np.zeros((0, *foam.shape[1:])), sign))
    areas = [_area(part[:, mid]) for part, _ in result]
    # Less than a hundredth of a pixel: the polygons differ by rounding only.
    if abs(areas[0] - areas[1]) < 1e-10:
        return []
    return [(part, sign) for part, sign in result if len(part) >= 3]


def _area(polygon: np.ndarray) -> float:
    if len(polygon) < 3:
        return 0.0
    x, y = polygon[:, 0], polygon[:, 1]
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
