"""Figures of a reconstruction and of a completed surface with its standard deviation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.files import FIGURE_SUFFIXES, check_target, draw_surface, frame_box, new_figure, save_figure
from .body_completion import BodyCompletion
from .completion.surface_completion import Completion
from .mesh import SurfaceMesh
from .pipeline import Reconstruction

#: Azimuths of the two views of an object, and their elevation [deg].
_AZIMUTHS_DEG, _ELEVATION_DEG = (-60.0, 30.0), 20.0
#: Number of mesh vertices along the longest edge of a drawn scene; more are not visible in a figure.
_DRAWN_VERTICES = 120
_GREY = (0.72, 0.72, 0.72, 1.0)


def plot_completion(completion: Completion | BodyCompletion, path: Path | str) -> None:
    """Plot the completed surface from two sides: grey where visible, else coloured by its standard deviation.

    Parameters
    ----------
    completion
        Completion with its touches; contacts are drawn as points.
    path
        .png, .pdf or .svg.

    Raises
    ------
    InputError
        The suffix is not supported, or the file cannot be written.

    Examples
    --------
    The middle of a bottle is not seen:

    >>> from visuohaptic.reconstruction.completion import HoleRegion
    >>> from visuohaptic.simulation.tabletop import random_bottle
    >>> bottle = random_bottle(np.random.default_rng(4), "round")
    >>> low_m, high_m = 0.3 * bottle.height_m, 0.7 * bottle.height_m
    >>> visible = SurfaceMesh(*bottle.mesh(0.0, low_m)).joined(SurfaceMesh(*bottle.mesh(high_m, bottle.height_m)))
    >>> region = HoleRegion.of_points(bottle.mesh(low_m, high_m, caps=False)[0])
    >>> plot_completion(Completion(visible, region), "completed.png")
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    path = check_target(path, FIGURE_SUFFIXES)
    mesh = completion.completed()
    sigma_mm = 1e3 * completion.sigma_m(mesh.vertices_m)[mesh.faces].mean(axis=1)
    seen = sigma_mm <= 1e3 * completion.visual_sigma_m
    scale = ScalarMappable(Normalize(0.0, max(float(sigma_mm.max(initial=0.0)), 1e-3)), "viridis")
    colors = np.where(seen[:, None], _GREY, scale.to_rgba(sigma_mm))
    contacts_m = np.array([t.contact_m for t in completion.touches if t.contact_m is not None]).reshape(-1, 3)
    # Only the object: the supporting surface would hide it.
    own_m = (
        completion.region.hull_m if isinstance(completion, Completion) else completion.surface().vertices_m
    )
    low_m, high_m = own_m.min(axis=0), own_m.max(axis=0)
    room_m = 0.5 * float((high_m - low_m).max())
    figure, views = _figure()
    for axes, azimuth_deg in zip(views, _AZIMUTHS_DEG, strict=True):
        _draw(axes, azimuth_deg, mesh, colors, low_m - room_m, high_m + room_m)
        axes.scatter(*(1e3 * contacts_m.T), color="crimson", s=18, depthshade=False, zorder=3)
    figure.colorbar(scale, ax=views, label="standard deviation [mm]", shrink=0.7)
    error_mm = 1e3 * completion.expected_error_m()
    figure.suptitle(f"{len(completion.touches)} touches, expected error {error_mm:.1f} mm")
    save_figure(path, figure)


def plot_reconstruction(found: Reconstruction, path: Path | str) -> None:
    """Plot the visual surface in grey and the transparent parts, coloured by their score, from two sides.

    Parameters
    ----------
    found
        Surface and transparent parts.
    path
        As of :func:`plot_completion`.

    Raises
    ------
    InputError
        As of :func:`plot_completion`.
    """
    path = check_target(path, FIGURE_SUFFIXES)
    figure, views = _figure()
    low_m, high_m = found.surface.vertices_m.min(axis=0), found.surface.vertices_m.max(axis=0)
    mesh = found.surface.welded(float((high_m - low_m).max()) / _DRAWN_VERTICES)
    colors = np.broadcast_to(_GREY, (len(mesh.faces), 4))
    for axes, azimuth_deg in zip(views, _AZIMUTHS_DEG, strict=True):
        _draw(axes, azimuth_deg, mesh, colors, low_m, high_m)
        points = axes.scatter(*(1e3 * found.points_m.T), c=found.scores, s=4, cmap="viridis", zorder=3)
    if len(found.points_m):
        figure.colorbar(points, ax=views, label="score of transparency", shrink=0.7)
    panes = f", {len(found.panes)} flat pane{'s' * (len(found.panes) != 1)}" if found.panes else ""
    figure.suptitle(f"{len(found.regions)} transparent parts{panes} in {found.search.views} views")
    save_figure(path, figure)


def _figure() -> tuple[Any, list[Any]]:
    figure, views = new_figure(1, 2, size=(11.0, 5.2), projection="3d")
    # The automatic layout ignores the labels of 3D axes.
    figure.set_layout_engine("constrained", wspace=0.15)
    for axes in views:
        axes.computed_zorder = False  # draw points over surfaces
    return figure, list(views)


def _draw(
    axes: Any,
    azimuth_deg: float,
    mesh: SurfaceMesh,
    colors: Float[np.ndarray, "f 4"],
    low_m: Float[np.ndarray, "3"],
    high_m: Float[np.ndarray, "3"],
) -> None:
    """Draw the shaded triangles of a mesh inside a box, in millimetres."""
    centres_m = mesh.vertices_m[mesh.faces].mean(axis=1)
    chosen = np.flatnonzero(((centres_m >= low_m) & (centres_m <= high_m)).all(axis=1))
    shade = 0.75 + 0.25 * mesh.face_normals[chosen] @ np.array([0.48, -0.6, 0.64])
    shaded = np.column_stack([colors[chosen, :3] * shade[:, None], colors[chosen, 3]])
    triangles = 1e3 * mesh.vertices_m[mesh.faces[chosen]]
    draw_surface(axes, triangles, shaded)
    frame_box(
        axes, 1e3 * low_m, 1e3 * high_m, azimuth_deg=azimuth_deg, elevation_deg=_ELEVATION_DEG, zoom=0.85
    )
    for name in "xyz":
        getattr(axes, f"set_{name}label")(f"{name} [mm]", labelpad=6 if name == "z" else 18)
    edges_m = np.maximum(high_m - low_m, 1e-3)
    # Limit the number of tick labels by the length of the edge.
    for name, part in zip("xyz", edges_m / edges_m.max(), strict=True):
        axes.locator_params(axis=name, nbins=max(1, round(4 * float(part))))
    axes.tick_params(labelsize=8)
