"""Open containers, air and water: stiffening of a wall by an enclosed volume, and agreement with Boyle's law.

python -m benchmarks contents    stiffness ratios, gas law under large deformation, order of figure 3.13b, CPU time
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from benchmarks.peers.damped_iteration import damped_iteration
from visuohaptic.deformation.nonlinear import (
    Contents,
    closed_compliance,
    contained_curve,
    enclosed_gradient,
)
from visuohaptic.deformation.nonlinear.contents import pinch_load
from visuohaptic.deformation.shapes import ContainerDescription, ShellObject, mesh_container
from visuohaptic.deformation.shells import CorotationalShell, dual_tip_compliance, opposing_points

AROUND = 64


def run() -> list[dict[str, Any]]:
    """Rows of the table."""
    rows: list[dict[str, Any]] = []
    states = [Contents(), Contents(fill=0.95)]
    for base, wanted in (("ellipse", (1.33, 1.57)), ("circle", (1.0, 1.0))):
        thing = _tube(base, AROUND)
        model = thing.model()
        tips = opposing_points(thing.mesh, _middle(thing, AROUND))
        c = dual_tip_compliance(model, tips)
        ratio = (c / closed_compliance(thing, model, tips, c, states))[:, 0]
        for what, value, reference in zip(("air", "95 % water"), ratio, wanted, strict=True):
            rows.append(
                {
                    "name": f"{base}, free mouth, {what}: k closed by k open {value:.3f}, expected {reference}",
                    "ours": 100 * abs(float(value) / reference - 1),
                    "unit": "% off",
                    "floor": 3.0,
                    "aim": 1.0,
                }
            )
    thing = _tube("ellipse", AROUND)
    model = thing.model()
    tips = opposing_points(thing.mesh, _middle(thing, AROUND))
    load = pinch_load(model, tips, 0)
    c = dual_tip_compliance(model, tips)
    begin = time.process_time()
    closed = closed_compliance(thing, model, tips, c, [Contents(fill=0.5)])[0, 0]
    update_s = time.process_time() - begin
    for damping in (0.1, 0.5, 1.0):
        begin = time.process_time()
        found = damped_iteration(thing, model, load, Contents(fill=0.5), damping=damping)
        iteration_s = time.process_time() - begin
        off = abs(np.sum(load * found.displacement) / closed - 1)
        said = f"{found.passes} passes, {100 * off:.1g} % off" if found.converged else "diverges"
        rows.append(
            {
                "name": "rank-one update for all pinches",
                "ours": 1e3 * update_s,
                "unit": "ms CPU",
                "peer": 1e3 * iteration_s,
                "peer_name": f"Eq. (6.2) for one pinch, c = {damping}, with the same factor",
                "note": said,
            }
        )
    rows += _boyle()
    return rows


def _boyle() -> list[dict[str, Any]]:
    thing = _tube("ellipse", 32)
    model = thing.model()
    tips = opposing_points(thing.mesh, _middle(thing, 32))
    worst, force = 0.0, []
    for what in (None, Contents(), Contents(fill=0.5), Contents(fill=0.95)):
        path = contained_curve(thing, model, tips, 0, [0.001, 0.003, 0.006], what)
        force.append(path.load)
        if what is None:
            continue
        for point in path.points:
            shell = CorotationalShell(model, lid=thing.lid)
            gradient = shell.volume_gradient(point.state)
            free = ~model.fixed
            # Load for the equilibrium of the wall in addition to the tips.
            rest = CorotationalShell(model).internal_force(point.state) - point.load * pinch_load(
                model, tips, 0
            )
            carried = np.sum(rest[free] * gradient[free]) / np.sum(gradient[free] ** 2)
            volume = shell.volume(point.state) - what.fill * thing.volume_m3
            product = (carried + what.ambient_Pa) * volume
            worst = max(worst, abs(product / (what.ambient_Pa * (1 - what.fill) * thing.volume_m3) - 1))
    ordered = bool((np.diff(np.array(force), axis=0) > 0).all())
    spread = np.array(force)[:, [0, -1]]
    return [
        {
            "name": "P V of the gas under large deformation",
            "ours": 100 * worst,
            "unit": "% off",
            "floor": 1.0,
            "note": "pressure from the balance of forces, three fills, to 6 mm",
        },
        {
            "name": "order of figure 3.13b: the fuller the stiffer",
            "ours": float(ordered),
            "unit": "",
            "floor": 1.0,
            "higher_is_better": True,
            "note": "force by that of the open one at 1 mm "
            + ", ".join(f"{value:.2f}" for value in spread[:, 0] / spread[0, 0])
            + "; at 6 mm "
            + ", ".join(f"{value:.2f}" for value in spread[:, 1] / spread[0, 1]),
        },
    ]


def _tube(base: str, around: int) -> ShellObject:
    foot = {"circle": {"radius": 0.035}, "ellipse": {"shape": "ellipse", "radius": 0.045, "radius_y": 0.025}}
    return mesh_container(
        ContainerDescription.model_validate(
            {
                "base": foot[base],
                "sections": [{"height": 0.2}],
                "wall": 0.0005,
                "youngs_modulus": "2.5 GPa",
            }
        ),
        around=around,
    )


def _middle(thing: ShellObject, around: int) -> np.ndarray:
    z = thing.mesh.vertices_m[::around, 2]
    return np.array([int(np.argmin(np.abs(z - z.max() / 2))) * around + around // 4])


def gain(thing: ShellObject, contents: Contents) -> float:
    """Loop gain of the published iteration."""
    model = thing.model()
    a = enclosed_gradient(thing, model)
    return contents.bulk_stiffness(thing.volume_m3) * float(np.sum(a * model.solve(a)))
