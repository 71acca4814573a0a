"""Stiffness of a bottle at several heights and with several contents (Fig. 3.13).

Force of one finger against deformation (a) at six heights of the open bottle, (b) in the middle with
different contents, from the shell model of a bottle with a waist; crosses: slope that the foam sensor
measures where the simulated gripper holds a spring of the model's stiffness (simulated bottle, gripper and
foam).
"""

from __future__ import annotations

import tempfile
from typing import Any

import numpy as np

from ...core.errors import CalibrationError
from ...deformation import Contents, GraspCurve, PinchPlane, load_container, mesh_container, side_vertex
from ...report.style import COLOURS, draw_axes
from ...rigs import squeeze_rig as squeezing
from ...rigs.virtual_gripper import GripperSensor
from ...simulation.foam.outline import Outline
from ...simulation.tabletop.gripper_setup import GraspObject
from ..output import Columns, Output

#: Heights h_1 .. h_6 as fractions of the bottle's.
HEIGHTS = (0.08, 0.2, 0.33, 0.45, 0.6, 0.85)
DEFORMATIONS_m = (0.0005, 0.001, 0.002, 0.003, 0.0045, 0.006, 0.008)
CONTENTS = {
    "open": None,
    "closed, air": Contents(),
    "50 % water": Contents(fill=0.5),
    "95 % water": Contents(fill=0.95),
    "100 % water": Contents(fill=1.0),
}
#: Forces at which the gripper stops [N]; a softer wall is pressed with less.
GRIPS_N = (10.0, 20.0, 35.0)


def run(out: Output) -> None:
    """Pinch the model; then measure the same stiffness with the gripper.

    Parameters
    ----------
    out
        Receives the table ``stiffness``, picture ``stiffness``, and the comparisons; its seed and size are used.
    """
    container = mesh_container(load_container("bottle").middle(), around=24 if out.quick else 40)
    plane = PinchPlane(container)
    fractions = HEIGHTS[1::3] if out.quick else HEIGHTS
    vertices = [side_vertex(container, "x+", fraction * container.height_m) for fraction in fractions]
    heights = [plane.curve(vertex, deformation_m=DEFORMATIONS_m) for vertex in vertices]
    middle = side_vertex(container, "x+", 0.45 * container.height_m)
    fills = {name: plane.curve(middle, deformation_m=DEFORMATIONS_m, contents=what)
             for name, what in CONTENTS.items() if not out.quick or name in ("open", "100 % water")}  # fmt: skip
    names = [f"h{number + 1}, {100 * fraction:.0f} %" for number, fraction in enumerate(fractions)]
    _write(out, "heights", dict(zip(names, heights, strict=True)))
    _write(out, "contents", fills)
    radii = [float(np.hypot(*container.mesh.vertices_m[vertex, :2])) for vertex in vertices]
    stiff = np.array([curve.force_N[0] / curve.deformation_m[0] for curve in heights])
    measured = _measured(out, stiff, radii)
    out.table("stiffness", {"height_share": fractions, "radius_m": radii, "true_N_per_m": stiff,
                            "measured_N_per_m": measured})  # fmt: skip

    def draw(left: Any, right: Any) -> None:
        for axes, curves in ((left, dict(zip(names, heights, strict=True))), (right, fills)):
            colours = [COLOURS[k] for k in ("blue", "sky", "green", "orange", "pink", "yellow")]
            for (name, curve), colour in zip(curves.items(), colours, strict=False):
                axes.plot(
                    1e3 * np.r_[0, curve.deformation_m],
                    np.r_[0, curve.force_N],
                    ".-",
                    color=colour,
                    label=name,
                )
            axes.set(xlabel="deformation of one side [mm]", ylabel="force [N]", xlim=(0, 8.2), ylim=(0, None))
            axes.legend()
        for k, (value, colour) in enumerate(zip(measured, colours, strict=False)):
            if np.isfinite(value):
                left.plot(0.6 + 0.1 * k, value * 1e-3 * (0.6 + 0.1 * k), "x", color=colour, ms=7, mew=2)
        left.set_title("a  heights, open")
        right.set_title("b  contents, middle")

    out.picture("stiffness", draw_axes(1, 2, draw, size=(11.0, 4.6)))
    soft = float(stiff.min())
    out.compare("stiffness near the bottom by the least", stiff[0] / soft,
                note='printed: "very stiff near the bottom and the top"')  # fmt: skip
    out.compare("stiffness near the top by the least", stiff[-1] / soft, note="the same")
    full, empty = fills["100 % water"], fills["open"]
    count = min(len(full.force_N), len(empty.force_N))
    out.compare("100 % water by open, smallest deformation", full.force_N[0] / empty.force_N[0],
                note='printed: "equal for small deformations"')  # fmt: skip
    out.compare("100 % water by open, largest deformation that both reach",
                full.force_N[count - 1] / empty.force_N[count - 1],
                note='printed: "the bottle with 100% water is the stiffest"')  # fmt: skip
    good = np.isfinite(measured)
    if good.any():
        away = np.abs(np.array(measured)[good] / stiff[good] - 1)
        out.compare("stiffness by the foam sensor: largest error", 100 * float(away.max()), "%",
                    note=f"at {int(good.sum())} heights")  # fmt: skip


def _write(out: Output, name: str, curves: dict[str, GraspCurve]) -> None:
    rows = Columns("curve deformation_m force_N")
    for key, curve in curves.items():
        for point in zip(curve.deformation_m, curve.force_N, strict=True):
            rows.add(key, *point)
    out.table(name, rows)


def _measured(out: Output, stiffness: np.ndarray, radii: list[float]) -> list[float]:
    """Stiffness measured by the gripper's foam sensor on springs of these stiffnesses; NaN if not measured."""
    rng = out.rng(1)
    rig = GripperSensor(stripe=True)
    found = []
    with tempfile.TemporaryDirectory() as folder:
        sensor = rig.build(folder, rng, zero_frames=8 if out.quick else 20)
        for k, radius in zip(stiffness[:1] if out.quick else stiffness, radii, strict=False):
            container = GraspObject(Outline.disc((0.065, 0.0), radius), stiffness_N_per_m=float(k))
            # A soft wall is deformed by at most 4 mm, as the curves are nearly linear there.
            grips = [force for force in GRIPS_N if force < 4e-3 * k] or [1e-3 * k, 2e-3 * k, 4e-3 * k]
            if len(grips) < 2:
                grips = [0.5 * grips[0], grips[0]]
            try:
                sensor.reset()
                states = squeezing.squeeze(sensor, rig.gripper(container, rng=rng), grips)
                found.append(squeezing.stiffness_N_per_m(states))
            except CalibrationError:
                found.append(float("nan"))
    return found + [float("nan")] * (len(stiffness) - len(found))
