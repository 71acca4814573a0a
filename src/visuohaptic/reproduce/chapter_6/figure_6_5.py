"""Stiffness maps of models in the data base (Fig. 6.5).

Local stiffness in N/m, one logarithmic scale for all: blue soft, red stiff (simulated, as in the
dissertation).
"""

from __future__ import annotations

import numpy as np

from ...core.files import draw_surface, new_figure
from ...deformation import load_object, object_map
from .._solid import frame_3d
from ..output import Columns, Output

NAMES = ("elliptic", "cleaner", "cien", "bottle", "cup", "cup-rim")


def run(out: Output) -> None:
    """Stiffness maps of the nominal objects of six classes.

    Parameters
    ----------
    out
        Receives the table ``profiles``, picture ``maps``, and the comparisons; its seed and size are used.
    """
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

    names = NAMES[3:5] if out.quick else NAMES
    maps = {name: object_map(load_object(name, around=32 if out.quick else 48), band=False) for name in names}
    values = np.concatenate(
        [found.stiffness_N_per_m[np.isfinite(found.stiffness_N_per_m)] for found in maps.values()]
    )
    norm = LogNorm(*np.percentile(values, [2, 97]))
    figure, axes = new_figure(
        1, len(names), size=(2.3 * len(names), 4.0), layout="constrained", projection="3d"
    )
    rows = Columns("object height_share p10_N_per_m median_N_per_m p90_N_per_m")
    for axis, (name, found) in zip(axes, maps.items(), strict=True):
        points, stiffness = found.vertices_m, found.stiffness_N_per_m
        per_face = np.nanmean(np.where(np.isfinite(stiffness), stiffness, np.nan)[found.faces], axis=1)
        colours = colormaps["viridis"](norm(np.nan_to_num(per_face, nan=float(values.max()))))
        draw_surface(axis, 1e3 * points[found.faces], colours)
        frame_3d(axis, points.min(axis=0), points.max(axis=0))
        axis.set_title(name, fontsize=10)
        fraction = points[:, 2] / points[:, 2].max()
        used = np.isfinite(stiffness)
        for low in np.arange(0.0, 1.0, 0.1):
            here = used & (fraction >= low) & (fraction < low + 0.1)
            if here.any():
                rows.add(name, low + 0.05, *np.percentile(stiffness[here], [10, 50, 90]))
    figure.colorbar(ScalarMappable(norm, "viridis"), ax=list(axes), label="stiffness [N/m]", shrink=0.6)
    out.picture("maps", figure, dpi=80)
    out.table("profiles", rows)
    by = {(name, round(height, 2)): median for name, height, _, median, _ in zip(*rows.values(), strict=True)}
    if "cup-rim" in maps:
        out.compare("cup-rim by cup, top tenth", by["cup-rim", 0.95] / by["cup", 0.95])
        out.compare("cleaner: top tenth by the middle", by["cleaner", 0.95] / by["cleaner", 0.55])
    out.compare("softest tenth of all maps", float(np.percentile(values, 10)), "N/m")
    out.compare("stiffest tenth of all maps", float(np.percentile(values, 90)), "N/m")
