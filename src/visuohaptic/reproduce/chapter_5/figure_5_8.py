"""Error of the extrapolated geometry by simulated haptic exploration (Fig. 5.8).

Mean square error over the number of touches: grey for single objects, blue the mean of the data set; orange
for random touches (as in the dissertation, simulation on parametric bottles; a subset of its 700,
see `python -m benchmarks.completion --objects 700` for all).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...report.style import COLOURS, draw_axes
from ...simulation.tabletop.bottles import random_bottle
from ..output import Output
from ..worlds.virtual_completion import TOUCHES, explore, touches_to_tenth

#: Of the dissertation's 700. Three seconds each; the mean over fifty separates planned from random touches.
OBJECTS = 50


def run(out: Output) -> None:
    """Explore bottles with planned and with random touches.

    Parameters
    ----------
    out
        Receives the tables ``mean`` and ``objects``, picture ``error``, and the comparisons; its seed and size are used.
    """
    objects, touches = (2, 4) if out.quick else (OBJECTS, TOUCHES)
    curves: dict[str, list[list[float]]] = {"planned": [], "random": []}
    kinds = []
    for number in range(objects):
        for name, found in curves.items():
            rng = out.rng(number)
            bottle = random_bottle(rng)
            run_ = explore(bottle, rng, planned=name == "planned", touches=touches)
            found.append(run_["mse"])
        kinds.append(bottle.kind)
    planned, random = (np.array(curves[name]) for name in ("planned", "random"))
    steps = np.arange(planned.shape[1])
    out.table("mean", {"touches": steps, "planned_mse_m2": planned.mean(axis=0),
                       "random_mse_m2": random.mean(axis=0)})  # fmt: skip
    columns: dict[str, Any] = {"object": np.arange(objects), "kind": kinds}
    columns |= {f"planned_mse_m2_{k}": planned[:, k] for k in steps}
    out.table("objects", columns)

    def draw(axes: Any) -> None:
        axes.semilogy(steps, 1e6 * planned.T, color=COLOURS["grey"], lw=0.5, alpha=0.5)
        axes.semilogy(steps, 1e6 * planned.mean(axis=0), color=COLOURS["blue"], lw=2.4, label="mean, planned")
        axes.semilogy(steps, 1e6 * random.mean(axis=0), color=COLOURS["orange"], lw=2.0, label="mean, random")
        axes.set(
            xlabel="touches", ylabel="mean square error [mm$^2$]", xticks=steps[:: max(1, len(steps) // 10)]
        )
        axes.legend()

    out.picture("error", draw_axes(1, 1, draw, size=(7.0, 4.6)))
    mean = planned.mean(axis=0)
    at = min(10, len(mean) - 1)
    out.compare(f"error after {at} touches by that of the untouched extrapolation", mean[at] / mean[0],
                dissertation=0.1, note=f"after 10 touches, mean of 700 objects; here of {objects}")  # fmt: skip
    reached = [touches_to_tenth(list(one)) for one in planned]
    if np.isfinite(np.median(reached)):
        out.compare("touches to a tenth of the error, median", float(np.median(reached)), dissertation=10)
    out.compare("planned by random, error after the last touch", mean[-1] / random.mean(axis=0)[-1],
                note='printed: "better than random"')  # fmt: skip
    out.compare("objects whose error blows up", float((planned[:, -1] > 2 * planned[:, 0]).sum()),
                note="the dissertation shows one, at its 19th touch")  # fmt: skip
