"""Drawing area of a view: scene and panel, cleared completely when the view changes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float, Int, UInt8

from ..core.errors import needs
from ..core.files import ramp_colours
from .access_control import reported

#: Pale to dark red: darker is worse.
_SCALE = np.array([[255, 247, 236], [253, 212, 158], [252, 141, 89], [215, 48, 31], [127, 0, 0]], float)


class View(Protocol):
    """A selectable view of the page."""

    title: str

    def draw(self, stage: Stage) -> None:
        """Draw the view on an empty stage.

        Parameters
        ----------
        stage
            Empty stage.
        """


class Stage:
    """Scene and panel, with their current contents.

    Parameters
    ----------
    server
        The viser server.
    """

    def __init__(self, server: Any) -> None:
        self._server = server
        self._kept: dict[str, Any] = {}

    @property
    def gui(self) -> Any:
        """Widgets; pass new handles to :meth:`keep`."""
        return self._server.gui

    @property
    def scene(self) -> Any:
        """Scene nodes; pass new handles to :meth:`keep`."""
        return self._server.scene

    def keep(self, name: str, handle: Any) -> Any:
        """Store a handle; an older one of the same name is removed.

        A scene node that replaces another has to be dropped before it is created:
        viser identifies nodes by name.

        Parameters
        ----------
        name
            Name for later access.
        handle
            Handle from viser.
        """
        self.drop(name)
        self._kept[name] = handle
        return handle

    def drop(self, name: str) -> None:
        """Remove one element, if it exists.

        Parameters
        ----------
        name
            Name passed to :meth:`keep`.
        """
        if (handle := self._kept.pop(name, None)) is not None:
            handle.remove()

    def get(self, name: str) -> Any:
        """A stored handle, or None.

        Parameters
        ----------
        name
            Name passed to :meth:`keep`.
        """
        return self._kept.get(name)

    def clear(self) -> None:
        """Remove all elements."""
        for name in reversed(list(self._kept)):
            self.drop(name)

    def look(self, at_m: tuple[float, float, float], reach_m: float) -> None:
        """Point all cameras at the scene, including those of browsers that connect later.

        Parameters
        ----------
        at_m
            Point at the centre of the view [m].
        reach_m
            Size of the visible region [m].
        """
        position = (at_m[0] + 0.55 * reach_m, at_m[1] - 1.0 * reach_m, at_m[2] + 0.55 * reach_m)
        cameras = [self._server.initial_camera]
        cameras += [client.camera for client in self._server.get_clients().values()]
        for camera in cameras:
            camera.position, camera.look_at = position, at_m

    def mesh(
        self,
        name: str,
        vertices_m: Float[np.ndarray, "v 3"],
        faces: Int[np.ndarray, "f 3"],
        colours: UInt8[np.ndarray, "v 3"],
        on_click: Callable[[np.ndarray, np.ndarray], None] | None = None,
    ) -> Any:
        """A mesh with vertex colours; ``on_click`` receives origin and direction of the ray.

        Parameters
        ----------
        name
            Name for later access.
        vertices_m
            Vertices in the world [m].
        faces
            Triangles, counter-clockwise from outside.
        colours
            Red, green and blue of each vertex.
        on_click
            Called with origin [m] and direction of the ray.
        """
        with needs("trimesh", "geometry", "a coloured mesh on the page"):
            import trimesh
        # The inside of a cup is visible: it is a second surface, at a small distance to avoid flicker.
        outside = trimesh.Trimesh(vertices_m, faces, process=False, validate=False)
        apart = 1e-3 * float(np.ptp(vertices_m, axis=0).max())
        inside_m = vertices_m - apart * outside.vertex_normals
        points = np.concatenate([vertices_m, inside_m])
        both = np.concatenate([faces, np.asarray(faces)[:, ::-1] + len(vertices_m)])
        shape = trimesh.Trimesh(points, both, process=False, validate=False)
        rgba = np.column_stack([colours, np.full(len(colours), 255, np.uint8)])
        shape.visual.vertex_colors = np.concatenate([rgba, rgba])  # type: ignore[union-attr, unused-ignore]
        self.drop(name)
        handle = self.keep(name, self.scene.add_mesh_trimesh(f"/view/{name}", shape))
        if on_click is not None:
            handle.on_click(
                reported(lambda event: on_click(np.array(event.ray_origin), np.array(event.ray_direction)))
            )
        return handle


def hit_face(
    vertices_m: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    origin_m: Float[np.ndarray, "3"],
    direction: Float[np.ndarray, "3"],
) -> tuple[int, Float[np.ndarray, "3"]] | None:
    """First face that a ray hits from either side, and the hit point (Moeller and Trumbore 1997).

    Parameters
    ----------
    vertices_m
        Vertices in the world [m].
    faces
        Triangles.
    origin_m
        Start of the ray [m].
    direction
        Direction of the ray, of any length.
    """
    a = vertices_m[faces[:, 0]]
    e, f = vertices_m[faces[:, 1]] - a, vertices_m[faces[:, 2]] - a
    across = np.cross(direction, f)
    det = np.einsum("fi,fi->f", e, across)
    with np.errstate(divide="ignore", invalid="ignore"):
        away = origin_m - a
        u = np.einsum("fi,fi->f", away, across) / det
        q = np.cross(away, e)
        v = q @ direction / det
        t = np.einsum("fi,fi->f", f, q) / det
        hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t > 0)
    if not hit.any():
        return None
    face = int(np.argmin(np.where(hit, t, np.inf)))
    return face, origin_m + t[face] * direction


def scale_colours(values: Float[np.ndarray, "v"], low: float, high: float) -> UInt8[np.ndarray, "v 3"]:
    """Pale at ``low``, dark red at ``high``; grey if unknown.

    Parameters
    ----------
    values
        One value per vertex; NaN if unknown.
    low, high
        Ends of the scale, in the unit of the values.
    """
    fraction = (values - low) / max(high - low, 1e-300)
    found = ramp_colours(fraction, _SCALE)
    found[~np.isfinite(values)] = 150
    return found
