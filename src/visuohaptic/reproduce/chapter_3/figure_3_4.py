"""Sensitivity of stress to the image position (Fig. 3.4, Eq. (3.9)).

Change of stress per pixel over strain at d = 0.3 m, gamma = 70 deg, f = 1800 px. The triangle is low and
nearly constant, the trapezoid reduces the barrier at zero strain, the rectangle is steep at both ends (simulated foam;
triangle and trapezoid follow from the rectangle's curve).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...report.style import COLOURS, draw_axes
from ...sensing.foam.material.section import Section, section_material, sensitivity
from .._press import FOAMS, pressed
from ..output import Output

_SECTIONS: tuple[Section, ...] = ("rectangle", "trapezoid", "triangle")


def run(out: Output) -> None:
    """Press the rectangle, cut the other sections from the same foam, plot Eq. (3.9).

    Parameters
    ----------
    out
        Receives the table ``sensitivity``, picture ``sensitivity``, and the comparisons; its seed and size are used.
    """
    base = pressed(out, FOAMS["soft (as PUR)"], 0, curve="spline").material
    strain = np.linspace(0.0, 0.6, 121)
    rods = {section: section_material(base, section) for section in _SECTIONS}
    curves = {}
    for section, rod in rods.items():
        values = sensitivity(rod, np.minimum(strain, rod.loading.max_strain))
        curves[section] = np.where(strain <= rod.loading.max_strain, values, np.nan)
    out.table("sensitivity", {"strain": strain, **{f"{s}_Pa_per_px": v for s, v in curves.items()}})

    def draw(axes: Any) -> None:
        for (section, values), colour in zip(curves.items(), ("orange", "blue", "green"), strict=True):
            axes.plot(strain, values, color=COLOURS[colour], label=section)
        axes.set(xlabel="normalised strain", ylabel="change of stress [Pa/px]", ylim=(0, None))
        axes.legend()

    out.picture("sensitivity", draw_axes(1, 1, draw, size=(6.0, 4.0)))
    start = {section: float(values[0]) for section, values in curves.items()}
    middle = (strain > 0.15) & (strain < 0.4)
    for section in ("trapezoid", "triangle"):
        out.compare(
            f"{section}: sensitivity at zero strain by the rectangle's",
            start[section] / start["rectangle"],
            note='printed: "the barrier at zero strain is significantly reduced"',
        )
    triangle = curves["triangle"][middle]
    out.compare(
        "triangle: largest by smallest sensitivity, strain 0.15-0.4",
        float(triangle.max() / triangle.min()),
        note='printed: "almost constant"',
    )
