"""Classification of nine objects by haptic exploration (Table 6.2).

Fraction of trials in which each tree, and this library's uncertainty-aware planner, identify the class (simulated
objects with another element type than in training, with individual walls and shapes, and with errors of the
gripper's pose).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...recognition import calibrate, explore, fit_model, train_tree, walk
from ...recognition.touch.calibration import EXPLORATIONS
from ...report.style import draw_axes
from .._features import grouped, training_features
from ..output import Output
from ..worlds import virtual_containers as world
from .table_6_1 import TREES

#: Rows of the table: 1 right, 0 wrong, 2/3, NaN not trained.
_N = float("nan")
PRINTED = {
    "cup": (1, 1, 1, 1, 1, _N),
    "cup-rim": (_N, _N, 1, 1, 1, _N),
    "cut-bottle": (0, 0, 1, 1, 1, _N),
    "bottle": (1, 0, 1, 1, 0, _N),
    "smoothie": (_N, _N, 0, 0, 0, _N),
    "isana": (1, 0, 1, 2 / 3, 0, 2 / 3),
    "cien": (1, 0, 1, 1, 1, 0),
    "cleaner": (1, 0, 1, 1, 0, 1),
    "palmo": (1, 1, 1, 1, 1, _N),
}
NUMBERS = (4, 5, 6, 7, 8, 9)


def run(out: Output) -> None:
    """Explore every object with every tree that was trained for it.

    Parameters
    ----------
    out
        Receives the table ``objects``, picture ``table``, and the comparisons; its seed and size are used.
    """
    draws = 1 if out.quick else 3
    names = ("cien",) if out.quick else tuple(world.REAL)
    data = training_features(out)
    folds = 3 if out.quick else 10
    trees = {}
    for number in NUMBERS:
        classes, scheme, _, _ = TREES[number]
        chosen = data.of_classes(classes) if number == 9 else grouped(data, classes)
        trees[number] = train_tree(chosen, scheme=scheme, rng=out.rng(number), folds=folds)
    explorations = EXPLORATIONS // 4 if out.quick else EXPLORATIONS
    model = calibrate(fit_model(data, world.GROUPS), data, out.rng(99), explorations=explorations)
    fraction = np.full((len(names), len(NUMBERS) + 1), np.nan)
    touches: list[int] = []
    for row, name in enumerate(names):
        right = np.zeros(fraction.shape[1])
        for draw in range(draws):
            specimen = world.sample_real_object(name, draw, 2016 + out.seed)
            for column, number in enumerate(NUMBERS):
                truth = name if number == 9 else world.REAL[name]
                touch = world.explore_container(specimen, out.rng(1, row, draw))
                answer, _ = walk(trees[number], world.both_sides(touch))
                right[column] += answer == truth
            found = explore(model, world.explore_container(specimen, out.rng(1, row, draw)), rng=out.rng(2, row, draw),
                            min_touches=2)  # fmt: skip
            right[-1] += found.answer == world.REAL[name]
            touches.append(len(found.readings))
        fraction[row] = right / draws
        for column, number in enumerate(NUMBERS):
            known = name in TREES[number][0] if number == 9 else world.REAL[name] in TREES[number][0]
            if not known:
                fraction[row, column] = np.nan
    columns: dict[str, Any] = {"object": names}
    columns |= {f"tree_{n}": fraction[:, k] for k, n in enumerate(NUMBERS)} | {"planner": fraction[:, -1]}
    columns |= {f"printed_tree_{n}": [PRINTED[name][k] for name in names] for k, n in enumerate(NUMBERS)}
    out.table("objects", columns)
    out.picture("table", draw_axes(1, 1, lambda axes: _draw(axes, names, fraction), size=(8.0, 4.8)))
    for column, number in enumerate(NUMBERS):
        printed = np.array([PRINTED[name][column] for name in names])
        if np.isfinite(fraction[:, column]).any():
            out.compare(f"tree {number}: trials right", 100 * float(np.nanmean(fraction[:, column])), "%",
                        dissertation=100 * float(np.nanmean(printed)), note=f"{draws} trials of each object")  # fmt: skip
    out.compare("planner: trials right", 100 * float(fraction[:, -1].mean()), "%", note="all five classes")
    out.compare("planner: touches, mean", float(np.mean(touches)))


def _draw(axes: Any, names: tuple[str, ...], fraction: np.ndarray) -> None:
    axes.imshow(fraction, cmap="RdYlGn", vmin=-0.3, vmax=1.3, aspect="auto", alpha=0.75)
    heads = [f"tree {n}" for n in NUMBERS] + ["planner"]
    axes.set_xticks(range(len(heads)), heads)
    axes.set_yticks(range(len(names)), names)
    axes.grid(visible=False)
    for (row, column), value in np.ndenumerate(fraction):
        printed = PRINTED[names[row]][column] if column < len(NUMBERS) else _N
        ours = "-" if np.isnan(value) else f"{100 * value:.0f} %"
        text = ours if np.isnan(printed) else f"{ours} ({100 * printed:.0f})"
        axes.text(column, row, text, ha="center", va="center", fontsize=8)
    axes.set_title("trials right; in brackets as printed")
