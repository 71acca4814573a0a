"""The sensor camera's image of a :class:`FoamScene`, with exact sub-pixel ground truth.

Layers are added from far to near (and drawn from near to far): floor, objects (whole prisms), foam and robot body
minus the parts hidden by objects that extend over them, occluders. Each layer covers a
pixel by its exact fraction after pixel and lens: the layer's polygon convolved with the pixel's
square and a Gaussian. Where two layers share a border, the nearer one is drawn over a farther one that
continues below it, so that no third surface is visible in between. Textures are blurred in their own plane.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Float32, UInt8

from ...core import Camera, Pose
from ._canvas import Canvas, Hole, Parts, Plane
from ._coverage import Coverage
from ._solids import (
    at_height,
    closed,
    hidden_from,
    hidden_parts,
    prism_faces,
    silhouette,
    solid_faces,
    turned_left,
)
from .appearance import Look, Occluder, Surface, shade_floor
from .contour_truth import ContourTruth
from .effects import CameraEffects
from .exposure import CameraShake, ExposedScene, SceneLike, inner_edge, observe
from .scene import FoamScene
from .textures import MATERIALS, compression

#: Light comes from above, behind and the left; a face's brightness grows with its normal along this direction.
_LIGHT = np.array([-0.5, 0.3, 1.0])
_MEAN_LIGHT = 0.5
_SIDE_LIGHT = 0.8

#: States that are computed over the readout of a frame when something moves; between them pixels are interpolated by
#: cubics. Motion of frequency f and amplitude A px causes an error of about ``0.02 (2 pi f T / (keys - 1))^4 A`` for a
#: readout of T.
_SHUTTER_KEYS = 9
#: Solids with more visible faces than this count as round.
_MAX_FACES = 6

#: Origin and axes of the sensor plane: texture with the grain along the strip.
_SENSOR_AXES = (np.zeros(3), np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))


class SceneRenderer:
    """Renders the view of the sensor's camera.

    Parameters
    ----------
    camera
        Lens, size and row timing.
    T_camera_foam
        Maps frame F of the sensor to the resting camera.
    look, effects
        Surfaces, and imperfections of lens and sensor.

    Examples
    --------
    >>> import numpy as np
    >>> from visuohaptic.simulation.rendering import crossings
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
    >>> bool(20 < crossings(truth.front_px, foot, [0.0, -1.0])[0] < 26)
    True
    """

    def __init__(
        self,
        camera: Camera,
        T_camera_foam: Pose,
        look: Look | None = None,
        effects: CameraEffects | None = None,
    ) -> None:
        self.camera = camera
        self.T_camera_foam = T_camera_foam
        self.look = look or Look()
        self.effects = effects or CameraEffects()
        self._canvas = Canvas(
            camera,
            3 if self.look.colour else 1,
            self.effects.blur_px,
            float(np.linalg.norm(T_camera_foam.translation_m)),
        )

    def render(
        self,
        scene: SceneLike,
        *,
        rng: np.random.Generator,
        t_s: float | None = None,
    ) -> UInt8[np.ndarray, "rows columns *colour"]:
        """Image as delivered by the camera.

        Parameters
        ----------
        scene
            A scene, or a function of time that returns one; objects and points keep their order.
        rng
            Source of the noise; the same state gives the same image.
        t_s
            Exposure of the first row [s]; by default the scene's time, needed for a function.
        """
        exact, row_times_s = self._exact(scene, t_s, None, ())
        image = self.effects.developed(exact, row_times_s, rng)
        return image if self.look.colour else image[..., 0]

    def repeated(
        self, scene: FoamScene, count: int, *, rng: np.random.Generator
    ) -> Iterator[UInt8[np.ndarray, "rows columns *colour"]]:
        """Images of a static scene, as :meth:`render` returns them: rendered once, with new noise in each.

        Parameters
        ----------
        scene
            Scene in the camera's view.
        count
            Number of images.
        rng
            Source of all noise.
        """
        exact, row_times_s = self._exact(scene, None, None, ())
        exact = exact.copy()
        for _ in range(count):
            image = self.effects.developed(exact, row_times_s, rng)
            yield image if self.look.colour else image[..., 0]

    def render_exact(
        self,
        scene: SceneLike,
        *,
        t_s: float | None = None,
        camera_shake: CameraShake | None = None,
        occluders: Sequence[Occluder] = (),
    ) -> Float32[np.ndarray, "rows columns *colour"]:
        """The blurred image before light, gain, noise and rounding; a copy.

        Parameters
        ----------
        scene, t_s
            As in :meth:`render`.
        camera_shake
            Motion of the camera, maps the resting camera's frame to the moved one.
        occluders
            Objects in front of the scene, the last one is nearest.
        """
        exact, _ = self._exact(scene, t_s, camera_shake, occluders)
        return (exact if self.look.colour else exact[..., 0]).copy()

    def truth(
        self, scene: SceneLike, *, t_s: float | None = None, camera_shake: CameraShake | None = None
    ) -> ContourTruth:
        """Exact image curves of the contours.

        Parameters
        ----------
        scene, t_s, camera_shake
            As in :meth:`render_exact`.
        """
        shot = self._observe(scene, t_s, camera_shake)
        back, front = shot.points("back_m"), shot.points("front_m")
        curves = [
            shot.view.polyline(at_height(points, 0.0))
            for points in (back, front, self._stripe_edge(shot, back, front))
        ]
        return ContourTruth(
            curves[0],
            curves[1],
            curves[2] if self.look.stripe is not None else np.zeros((0, 2)),
            self._front_visible(shot, front),
        )

    def _observe(self, scene: SceneLike, t_s: float | None, shake: CameraShake | None) -> ExposedScene:
        return observe(self.camera, self.T_camera_foam, scene, t_s, shake, max_keys=_SHUTTER_KEYS)

    def _exact(
        self,
        scene: SceneLike,
        t_s: float | None,
        shake: CameraShake | None,
        occluders: Sequence[Occluder],
    ) -> tuple[Float32[np.ndarray, "rows columns channels"], Float[np.ndarray, "rows"]]:
        effects = self.effects
        middle = self._observe(scene, t_s, shake)
        if effects.exposure_s > 0 and effects.exposure_samples > 1:
            count = effects.exposure_samples
            total = np.zeros((), np.float32)
            for shift in (np.arange(count) + 0.5) / count - 0.5:
                at = float(middle.row_times_s[0] + shift * effects.exposure_s)
                total = total + self._draw(self._observe(scene, at, shake), occluders)
            return total * np.float32(1 / count), middle.row_times_s
        return self._draw(middle, occluders), middle.row_times_s

    def _draw(
        self, shot: ExposedScene, occluders: Sequence[Occluder]
    ) -> Float32[np.ndarray, "rows columns channels"]:
        view = shot.view
        centre, mid = view.centre_foam_m, view.keys // 2
        back, front = shot.points("back_m"), shot.points("front_m")
        outlines = [shot.outline(i) for i in range(len(shot.middle.objects))]
        regions = self._sensor_regions(shot, back, front)
        self._draw_floor(shot, [*outlines, closed(front, back)])
        self._draw_foam_side(shot, back, front)
        holes: list[Hole] = []
        # Far objects first: the nearest point of each outline decides.
        distances = [np.linalg.norm(o[:, mid] - centre[:2], axis=1).min() for o in outlines]
        for i in sorted(range(len(outlines)), key=lambda i: -distances[i]):
            item, outline = shot.middle.objects[i], outlines[i]
            parts = self._draw_object(shot, i, outline)
            for part, sign in hidden_parts(closed(front, back), outline[:, mid], item.top_m, centre):
                holes.append((view.polygon(at_height(part, 0.0)), sign, parts))
        surfaces = [self.look.stripe] if self.look.stripe is not None else []
        surfaces += [self.look.foam, self.look.body]
        planes = [self._plane(shot, surface, _SENSOR_AXES) for surface in surfaces]
        warp, grid = compression(back[:, mid], front[:, mid])
        planes[:-1] = [replace(plane, warp=warp, grid=grid) for plane in planes[:-1]]
        self._canvas.paint_nested(regions, planes, holes)
        for occluder in occluders:
            self._draw_occluder(shot, occluder)
        return self._canvas.drawn()

    def _plane(
        self,
        shot: ExposedScene,
        surface: Surface,
        axes: tuple[np.ndarray, np.ndarray, np.ndarray],
        light: float = 1.0,
    ) -> Plane:
        """Plane by its origin and two unit vectors in F, each (3,) or (K, 3)."""
        shape = (shot.view.keys, 3)
        matrices = shot.view.plane_matrices(*(np.broadcast_to(axis, shape) for axis in axes))
        return Plane(matrices, surface, light)

    def _draw_floor(self, shot: ExposedScene, outlines: list[np.ndarray]) -> None:
        origins, a, b = [], [], []
        tile_m = MATERIALS[self.look.floor.material]
        for scene in shot.scenes:
            world = scene.T_world_foam
            # The nearest corner of the tiling keeps texture coordinates small, even far from the world's origin.
            corner = np.round(shot.middle.T_world_foam.translation_m[:2] / tile_m) * tile_m
            below = world.apply(np.array([0.0, 0.0, -scene.floor_below_m]))[2]
            origins.append(world.inverse().apply(np.array([*corner, below])))
            a.append(world.rotation[0])
            b.append(world.rotation[1])
        axes = (np.array(origins), np.array(a), np.array(b))
        light = (
            shade_floor(shot.view, shot.middle, outlines, self.look)
            if self.look.shadow > 0
            else np.ones((self.camera.height, self.camera.width), np.float32)
        )
        self._canvas.fill(self._plane(shot, self.look.floor, axes), light)

    def _draw_object(self, shot: ExposedScene, index: int, outline: np.ndarray) -> Parts:
        view, item, low = shot.view, shot.middle.objects[index], -shot.middle.floor_below_m
        centre = view.centre_foam_m
        surface = Surface(item.grey, item.texture, item.material, item.bgr, item.seed)
        planes, polygons, lights = [], [], []
        if item.solid is None:
            faces = prism_faces(outline, low, item.top_m, centre)
        else:
            solids = [solid for s in shot.scenes if (solid := s.objects[index].solid) is not None]
            poses = tuple(solid.T_foam_solid for solid in solids)
            faces = solid_faces(item.solid.outline_m, item.solid.height_m, poses, -low, centre)
        for face, polygon in zip(faces, view.polygons([face.corners_m for face in faces]), strict=True):
            if len(polygon) >= 3:
                lights.append(1.0 + self.look.face_contrast * float(face.normal @ _LIGHT - _MEAN_LIGHT))
                axes = (face.origin_m, face.along_a, face.along_b)
                planes.append(self._plane(shot, surface, axes, lights[-1]))
                polygons.append(polygon)
        if len(polygons) <= _MAX_FACES:
            return self._canvas.paint_parts(polygons, planes)
        if item.solid is None:
            border = view.polygon(silhouette(outline, low, item.top_m, centre))
        else:
            import cv2

            # A convex body in any orientation: its border is the hull of its faces.
            corners = np.concatenate(polygons).astype(np.float32)
            border = cv2.convexHull(corners).reshape(-1, 2).astype(np.float64)
        rest = replace(planes[0], surface=replace(surface, texture=0.0), light=float(np.mean(lights)))
        return self._canvas.paint_facets(border, rest, polygons, planes)

    def _draw_foam_side(self, shot: ExposedScene, back: np.ndarray, front: np.ndarray) -> None:
        """Side faces of the strip that face the camera; on most robots the camera is above them."""
        height = self.look.foam_height_m
        # Extends slightly above the top, which is drawn over it: no gap at their common edge.
        outline = turned_left(closed(front, back))
        # The back, whose normal points to -x, is glued to the body.
        for face in prism_faces(outline, -height, 0.1 * height, shot.view.centre_foam_m, -0.7):
            if face.normal[2] == 0.0:
                polygon = shot.view.polygon(face.corners_m)
                axes = (face.origin_m, face.along_a, face.along_b)
                self._canvas.paint_parts([polygon], [self._plane(shot, self.look.foam, axes, _SIDE_LIGHT)])

    def _sensor_regions(
        self, shot: ExposedScene, back: np.ndarray, front: np.ndarray
    ) -> list[Coverage | None]:
        """Foam with body, (foam behind the stripe with body,) body: nested regions, so there are no gaps."""
        look, view = self.look, shot.view
        first, last = back[0] - back[1], back[-1] - back[-2]
        first = back[0] + look.body_margin_m * first / np.linalg.norm(first, axis=-1, keepdims=True)
        last = back[-1] + look.body_margin_m * last / np.linalg.norm(last, axis=-1, keepdims=True)
        # Far behind: the view clips everything behind the camera.
        away = np.array([-1.0, 0.0])
        behind = np.stack([last, last + away, first + away, first])
        lines = [np.concatenate([back[:1], front, back[-1:]]), back]
        if look.stripe is not None:
            inner = self._stripe_edge(shot, back, front)
            lines.insert(1, np.concatenate([back[:1], inner, back[-1:]]))
        outlines = [at_height(np.concatenate([line, behind]), 0.0) for line in lines]
        return [self._canvas.cover(polygon) for polygon in view.polygons(outlines)]

    def _stripe_edge(self, shot: ExposedScene, back: np.ndarray, front: np.ndarray) -> np.ndarray:
        if all(scene.stripe_m is not None for scene in shot.scenes):
            return shot.points("stripe_m")
        return inner_edge(back, front, self.look.stripe_width_m)

    def _draw_occluder(self, shot: ExposedScene, occluder: Occluder) -> None:
        view, times = shot.view, shot.row_times_s
        active = (times >= occluder.start_s) & (times <= occluder.end_s)
        if not active.any():
            return
        outline = occluder.outline_at(float(times[len(times) // 2]))
        if occluder.height_m is None:
            # Fixed to the image: its texture is projected to the sensor plane, only the outline matters.
            polygon, height = outline, 0.0
        else:
            height = occluder.height_m
            points = np.repeat(outline[:, None], view.keys, axis=1)
            polygon = view.polygon(at_height(points, height))
        axes = (np.array([0.0, 0.0, height]), _SENSOR_AXES[1], _SENSOR_AXES[2])
        plane = self._plane(shot, occluder.surface, axes)
        self._canvas.paint_parts([polygon], [plane], None if active.all() else active)

    def _front_visible(self, shot: ExposedScene, front: np.ndarray) -> np.ndarray:
        centre, mid = shot.view.centre_foam_m, shot.view.keys // 2
        visible = np.ones(len(front), dtype=bool)
        for i, item in enumerate(shot.middle.objects):
            visible &= ~hidden_from(front[:, mid], shot.outline(i)[:, mid], item.top_m, centre)
        return visible
