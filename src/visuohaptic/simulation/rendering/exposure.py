"""States of a scene during the row-by-row exposure of one frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core import Camera, InputError, Pose, finite_array
from ._solids import turned_left
from .rolling_view import RollingView
from .scene import FoamScene

#: A static scene, or one that depends on time [s].
SceneLike = FoamScene | Callable[[float], FoamScene]

#: Motion of the camera: transforms coordinates of the static camera to the moved one, by time [s].
CameraShake = Callable[[float], Pose]


@dataclass(frozen=True, slots=True, eq=False)
class ExposedScene:
    """A frame's view and the states of its scene at the K keys."""

    view: RollingView
    scenes: tuple[FoamScene, ...]
    row_times_s: Float[np.ndarray, "rows"]

    @property
    def middle(self) -> FoamScene:
        return self.scenes[len(self.scenes) // 2]

    def points(self, name: str) -> Float[np.ndarray, "n K 2"]:
        """``back_m`` or ``front_m`` at each key.

        Parameters
        ----------
        name
            Name of the field of the scene.
        """
        return np.stack([np.asarray(getattr(s, name), dtype=np.float64) for s in self.scenes], axis=1)

    def outline(self, index: int) -> Float[np.ndarray, "n K 2"]:
        """Outline of an object at each key, counter-clockwise.

        Parameters
        ----------
        index
            Index of the object.
        """
        return turned_left(
            np.stack([np.asarray(s.objects[index].outline_foam_m, np.float64) for s in self.scenes], axis=1)
        )


def observe(
    camera: Camera,
    T_camera_foam: Pose,
    scene: SceneLike,
    t_s: float | None,
    shake: CameraShake | None,
    *,
    max_keys: int,
) -> ExposedScene:
    """The view and the states of a scene at the keys of a frame.

    Parameters
    ----------
    camera, T_camera_foam
        As of :class:`.SceneRenderer`.
    scene
        A scene, or a function of time that returns one.
    t_s
        Exposure of the first row [s]; by default the time of the scene.
    shake
        Movement of the camera.
    max_keys
        Number of states when something moves during the readout; one otherwise.

    Raises
    ------
    InputError
        No time is given for a moving scene, its number of points or objects changes during the frame, or
        they are not finite or not convex.
    """
    rows = np.arange(camera.height)
    if t_s is None:
        if not isinstance(scene, FoamScene):
            raise InputError("SceneRenderer", "a scene that moves with time needs t_s", field="t_s")
        t_s = scene.t_s
    moves = camera.row_delay_s > 0 and (shake is not None or not isinstance(scene, FoamScene))
    key_rows = np.linspace(0, camera.height - 1, max_keys) if moves else np.zeros(1)
    times = camera.row_time_s(t_s, key_rows)
    scenes = tuple(scene if isinstance(scene, FoamScene) else scene(float(t)) for t in times)
    shapes = {(s.back_m.shape, s.front_m.shape, *(o.outline_foam_m.shape for o in s.objects)) for s in scenes}
    if len(shapes) > 1 or scenes[0].back_m.shape != scenes[0].front_m.shape or len(scenes[0].back_m) < 2:
        raise InputError(
            "SceneRenderer",
            "expected back and front contour with the same number of points (at least 2), "
            f"and the same objects during a frame; found shapes {sorted(map(str, shapes))}",
            field="scene",
        )
    for state in scenes:
        _check(state)
    poses = tuple(T_camera_foam if shake is None else shake(float(t)) @ T_camera_foam for t in times)
    return ExposedScene(RollingView(camera, poses, key_rows), scenes, camera.row_time_s(t_s, rows))


def _check(scene: FoamScene) -> None:
    """Reject scenes that cannot be rendered correctly."""
    for name in ("back_m", "front_m"):
        if not np.isfinite(getattr(scene, name)).all():
            raise InputError("FoamScene", "found points that are not finite", field=name)
    for i, item in enumerate(scene.objects):
        field = f"objects[{i}].outline_foam_m"
        outline = finite_array("FoamScene", item.outline_foam_m, None, 2, field=field, least=3)
        edge = np.roll(outline, -1, axis=0) - outline
        following = np.roll(edge, -1, axis=0)
        scale = np.linalg.norm(edge, axis=1) * np.linalg.norm(following, axis=1)
        turn = (edge[:, 0] * following[:, 1] - edge[:, 1] * following[:, 0]) / np.maximum(scale, 1e-18)
        # Sines of the exterior angles; below a thousandth it is rounding, not shape.
        if turn.min() < -1e-3 and turn.max() > 1e-3:
            raise InputError(
                "FoamScene",
                "found an outline that is not convex",
                field=field,
                remedy="split the object into convex parts",
            )


def inner_edge(back: np.ndarray, front: np.ndarray, width_m: float) -> np.ndarray:
    """Inner edge of the stripe: its width behind the front, at most half way to the back.

    Parameters
    ----------
    back, front
        Contours (n, K, 2) [m].
    width_m
        Width of the stripe [m].
    """
    across = back - front
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    return front + np.minimum(width_m / np.maximum(length, 1e-12), 0.5) * across
