"""Opening a crown cap (Table 3.1).

Steps of the task with their input, end time and remaining distance of the tip from the cap, median
over the opened bottles; plot: forces and moments of one bottle (simulated arm, opener, beam
sensor and camera).
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np

from ...report.style import COLOURS, draw_axes
from ...rigs.virtual_crown_cap import OpenerTrial, open_virtual_cap, virtual_opener
from ...tasks.manipulation.crown_cap_records import CapState
from ..output import Output

#: Step -> input and goal, as printed.
STEPS = {
    CapState.FIND: ("features (V)", "find object", "1 cm, 1 cm, > 1 cm"),
    CapState.TRACK: ("template (V)", "track object", "1 mm, 1 mm, < 1 cm"),
    CapState.APPROACH: ("-", "tool is near object", "> 1 mm, > 1 mm, 1 cm"),
    CapState.PUSH_DOWN: ("F_z (H)", "F_z > const.", "Z 1 mm"),
    CapState.FEEL: ("M_y (H)", "M_y about 0", "X 1 mm"),
    CapState.FORWARD: ("F_y (H)", "F_y > const.", "Y < 1 mm"),
    CapState.ROTATE: ("M_x (H)", "M_x > const.", ""),
    CapState.CHECK: ("M_x (H), template (V)", "M_x about 0, template not on bottle", ""),
}


def run(out: Output) -> None:
    """Open bottles with vision as in the table, and without improvement of the initial position error.

    Parameters
    ----------
    out
        Receives the table ``steps``, picture ``forces``, and the comparisons; its seed and size are used.
    """
    bottles = 3 if out.quick else 20
    trials = [open_virtual_cap(out.seed + k, "tracked") for k in range(bottles)]
    blind = [open_virtual_cap(out.seed + k, "start") for k in range(2 if out.quick else 10)]
    good = [trial for trial in trials if trial.opening.opened]
    ends = {state: np.array([e for t in good if (e := _end(t, state)) is not None]) for state in STEPS}
    kept = [state for state, values in ends.items() if len(values)]
    middle = {state: np.median(ends[state], axis=0) for state in kept}
    out.table(
        "steps",
        {
            "step": [state.value for state in kept],
            "input": [STEPS[state][0] for state in kept],
            "goal": [STEPS[state][1] for state in kept],
            "printed_certainty": [STEPS[state][2] for state in kept],
            "ended_s": [middle[state][0] for state in kept],
            "to_cap_x_mm": [1e3 * middle[state][1] for state in kept],
            "to_cap_y_mm": [1e3 * middle[state][2] for state in kept],
            "to_cap_z_mm": [1e3 * middle[state][3] for state in kept],
            "bottles": [len(ends[state]) for state in kept],
        },
    )
    first = (good or trials)[0]
    out.picture("forces", draw_axes(2, 1, lambda *axes: _draw(axes, first), size=(9.0, 5.6)))
    out.compare("bottles opened, sight as in the table", len(good), f"of {bottles}")
    out.compare("bottles opened, sight up to 1 cm off on each axis", sum(t.opening.opened for t in blind),
                f"of {len(blind)}")  # fmt: skip
    out.compare("wrong claims", sum(not t.right for t in [*trials, *blind]))
    presses = [_visits(t, CapState.FEEL) for t in good]
    if presses:
        out.compare("presses until the opener is centred, median", float(np.median(presses)))
        lasted = [t.opening.trace.steps[-1].t_s for t in good]
        out.compare("time of the robot, median", float(np.median(lasted)), "s")


def _end(trial: OpenerTrial, state: CapState) -> tuple[float, float, float, float] | None:
    """Time at which a state was last left, and the distance of the tip from the cap on each axis."""
    cap = virtual_opener(trial.seed, "tracked").position_base_m
    for step in reversed(trial.opening.trace.steps):
        if step.state == state:
            away = np.abs(np.array(step.observation["tip_m"], dtype=float) - cap)
            return step.t_s, float(away[0]), float(away[1]), float(away[2])
    return None


def _visits(trial: OpenerTrial, state: CapState) -> int:
    states = [step.state for step in trial.opening.trace.steps]
    return sum(now == state and before != state for before, now in zip(["", *states], states, strict=False))


def _draw(axes: Any, trial: OpenerTrial) -> None:
    steps = [step for step in trial.opening.trace.steps if step.observation["felt"]]
    t = np.array([step.t_s for step in steps])
    force = np.array([step.observation["force_N"] for step in steps], dtype=float)
    moment = np.array([step.observation["moment_Nm"] for step in steps], dtype=float)
    colours = [COLOURS[name] for name in ("blue", "orange", "green")]
    for k, (name, colour) in enumerate(zip("XYZ", colours, strict=True)):
        axes[0].plot(t, force[:, k], color=colour, lw=1.1, label=f"F_{name}")
        axes[1].plot(t, moment[:, k], color=colour, lw=1.1, label=f"M_{name}")
    axes[0].set(ylabel="force [N]")
    axes[1].set(ylabel="moment [Nm]", xlabel="time [s]")
    # Before the contact with the cap there is only noise.
    axes[0].legend(loc="lower left", ncols=3)
    axes[1].legend(loc="upper left", ncols=3)
    top = math.inf
    for before, step in pairwise(steps):
        if step.state != before.state:
            axes[0].axvline(step.t_s, color=COLOURS["grey"], lw=0.6)
            axes[1].axvline(step.t_s, color=COLOURS["grey"], lw=0.6)
            if step.t_s > top + 0.6 or top == math.inf:
                axes[0].annotate(str(step.state).replace("_", " "), (step.t_s, 1.01), fontsize=7, rotation=60,
                                 xycoords=("data", "axes fraction"))  # fmt: skip
                top = step.t_s
