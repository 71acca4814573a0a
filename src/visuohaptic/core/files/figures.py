"""Figures of matplotlib: created without global state, written atomically, with coloured surfaces in space."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float, UInt8

from ..errors import needs
from .atomic import atomic_path
from .regular import check_target

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Formats of figures.
FIGURE_SUFFIXES = (".png", ".pdf", ".svg")
#: Viridis from dark to bright: perceptually uniform.
_VIRIDIS = np.array(
    [[68, 1, 84], [65, 68, 135], [42, 120, 142], [34, 168, 132], [122, 209, 81], [253, 231, 37]], float
)


def new_figure(
    rows: int,
    columns: int,
    *,
    size: tuple[float, float],
    sharex: bool = False,
    height_ratios: Sequence[float] | None = None,
    layout: Literal["constrained"] | None = None,
    projection: Literal["3d"] | None = None,
) -> tuple[Figure, tuple[Any, ...]]:
    """Create a figure that is not registered in matplotlib's global list, and its axes by rows.

    Parameters
    ----------
    rows, columns
        Number of axes.
    size
        Width and height [in].
    sharex
        Share one x axis.
    height_ratios
        Height ratios of the rows.
    layout
        ``constrained``, or ``None`` for fixed margins.
    projection
        ``3d`` for axes in space.

    Raises
    ------
    MissingExtraError
        matplotlib is not installed.
    """
    with needs("matplotlib", "plot", "drawing figures"):
        from matplotlib.figure import Figure
    figure = Figure(figsize=size, layout=layout)
    axes = figure.subplots(
        rows,
        columns,
        squeeze=False,
        sharex=sharex,
        height_ratios=height_ratios,
        subplot_kw={"projection": projection},
    )
    return figure, tuple(axes.ravel())


def save_figure(path: Path | str, figure: Figure, *, dpi: float = 120) -> None:
    """Write a figure atomically.

    Parameters
    ----------
    path
        .png, .pdf or .svg.
    figure
        Figure.
    dpi
        Resolution of a PNG.

    Raises
    ------
    InputError
        Another suffix, or the file cannot be written.
    """
    path = check_target(path, FIGURE_SUFFIXES)
    replace_undrawable(figure)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=dpi, format=path.suffix[1:].lower())


def replace_undrawable(figure: Figure) -> None:
    """Replace what is not Unicode in the texts of a figure: the name of a file need not be UTF-8.

    Parameters
    ----------
    figure
        Figure.
    """
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        text.set_text(text.get_text().encode(errors="replace").decode())


def literal(name: object) -> str:
    r"""Text that a figure shows as it is: matplotlib reads pairs of ``$`` as formulas and omits ``_name`` from legends.

    Parameters
    ----------
    name
        Name that a user has given: of a file, a template, an object, a class.

    Examples
    --------
    >>> literal("box $3_b$")
    'box \\$3_b\\$'
    """
    text = str(name).replace("$", r"\$")
    # A space without width hides the underscore from the legend.
    return f"\u200b{text}" if text.startswith("_") else text


def ramp_colours(
    fraction: Float[np.ndarray, "v"], ramp: Float[np.ndarray, "k 3"] = _VIRIDIS
) -> UInt8[np.ndarray, "v 3"]:
    """Colours on a ramp.

    Parameters
    ----------
    fraction
        Place on the ramp, limited to 0 to 1; NaN is 0.
    ramp
        RGB colours, 0 to 255, at equal distances; by default viridis.
    """
    place = np.clip(np.nan_to_num(fraction), 0, 1) * (len(ramp) - 1)
    found = np.stack([np.interp(place, np.arange(len(ramp)), ramp[:, k]) for k in range(3)], axis=1)
    return found.round().astype(np.uint8)


def draw_surface(axes: Any, corners: Float[np.ndarray, "f 3 3"], colours: Float[np.ndarray, "f c"]) -> None:
    """Draw coloured triangles.

    Parameters
    ----------
    axes
        Axes in space.
    corners
        Corners of the triangles, in the unit of the axes.
    colours
        RGB or RGBA of each triangle, 0 to 1.
    """
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    axes.add_collection3d(Poly3DCollection(corners, facecolors=colours, edgecolors="none"))


def frame_box(
    axes: Any,
    low: Float[np.ndarray, "3"],
    high: Float[np.ndarray, "3"],
    *,
    azimuth_deg: float = -60.0,
    elevation_deg: float = 15.0,
    zoom: float = 1.0,
) -> None:
    """Limit axes in space to a box, with equal units on all sides; a flat scene may be enlarged.

    Parameters
    ----------
    axes
        Axes in space.
    low, high
        Opposite corners, in the unit of the axes.
    azimuth_deg, elevation_deg
        Direction of the view.
    zoom
        Enlargement.
    """
    for name, first, last in zip("xyz", low, high, strict=True):
        getattr(axes, f"set_{name}lim")(first, last)
    axes.set_box_aspect(np.maximum(high - low, 1e-3), zoom=zoom)
    axes.view_init(elev=elevation_deg, azim=azimuth_deg)
