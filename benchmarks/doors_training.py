"""Weights of the log-odds that an opening is a door: logistic regression on the buildings for training.

    python -m benchmarks.doors_training --count 24 --write
                                      prints cross-validated recall and precision and the weights, and stores them

Floors, their truth and the counting are those of :mod:`benchmarks.doors_evidence`: even seeds and the real
buildings for training. The table is of floors whose building was left out of the fit; ``--write`` stores the
weights of the fit to all. The sign of a weight is prescribed where the measure has a physical meaning; a fit without
prescribed signs learns from generated buildings that clutter is straight, and fails on the real ones.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import visuohaptic.navigation.mapping as mapping
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.mapping import (
    DoorSettings,
    DoorSpace,
    Opening,
    door_candidates,
    door_probability,
    plan_measures,
    room_pairs,
    select_doors,
)
from visuohaptic.navigation.mapping.door_openings import MEASURES
from visuohaptic.navigation.mapping.doors import PLAN_MEASURES

from ._plan_judge import Row
from ._seeds import seeds_of
from .doors_evidence import floor, judged, real_names, table
from .nav_doors import TOLERANCE_M, matched_places
from .plan_evidence import print_rows

__all__ = ["fit", "main"]

TABLE = Path(mapping.__file__).with_name("door_weights.json")
#: Sign of each weight; 0 where the measure has an optimum or the sign is open.
SIGNS = (0, 1, 1, 1, 1, 1, -1, 1, 1)
RIDGE, FOLDS = 1.0, 4


@dataclass(frozen=True, slots=True, eq=False)
class Labelled:
    """The openings of one floor, and which of them are doors."""

    fold: str  #: floors of the same building are left out together
    kind: str
    grid: OccupancyMap
    found: tuple[DoorSpace, list[Opening], np.ndarray]  #: measures last
    is_door: np.ndarray  #: (n,) bool
    weight: np.ndarray  #: (n,) 0 where nobody can say
    jambs_m: np.ndarray
    unclear_m: np.ndarray
    rooms: tuple[list[tuple[int, int]], np.ndarray]  #: that each opening connects, and their areas

    def with_rooms(self, weights: np.ndarray) -> np.ndarray:
        """Measures, and those in the plan of the rooms by the weights of the measures alone."""
        measures = self.found[2]
        return np.column_stack([measures, plan_measures(*self.rooms, door_probability(measures, weights))])


def labelled(key: str, fold: str) -> Labelled:
    """Openings of a floor: the opening of each true door is positive; others near it, or near an ambiguous one, are ignored."""
    kind, grid, jambs_m, unclear_m = floor(key)
    found = door_candidates(grid, DoorSettings())
    cells = np.array([opening.middle for opening in found[1]]).reshape(-1, 2)
    middles = grid.world_from_cell(np.rint(cells).astype(np.int64))
    true_m = jambs_m.mean(axis=1)
    is_door = np.zeros(len(middles), dtype=bool)
    is_door[[i for i, _ in matched_places(middles, true_m)]] = True
    known = np.concatenate([true_m, unclear_m])
    far = np.hypot(*(middles[:, None] - known).transpose(2, 0, 1)).min(axis=1, initial=np.inf)
    weight = (is_door | (far > TOLERANCE_M)).astype(np.float64)
    return Labelled(fold, kind, grid, found, is_door, weight, jambs_m, unclear_m, room_pairs(*found[:2]))


def fit(measures: np.ndarray, is_door: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Weights of the measures and the constant: least log loss and ridge, signs as known."""
    from scipy.optimize import minimize

    mean, std = measures.mean(axis=0), measures.std(axis=0) + 1e-9
    design = np.c_[(measures - mean) / std, np.ones(len(measures))]

    def loss(at: np.ndarray) -> tuple[float, np.ndarray]:
        log_odds = design @ at
        ridge = RIDGE * np.append(at[:-1], 0.0)
        value = weight @ (np.logaddexp(0, log_odds) - is_door * log_odds) + 0.5 * ridge @ at
        return float(value), design.T @ (weight * (1 / (1 + np.exp(-log_odds)) - is_door)) + ridge

    bounds = [{1: (0, None), -1: (None, 0)}.get(sign, (None, None)) for sign in SIGNS[: measures.shape[1]]]
    start = np.zeros(design.shape[1])
    best = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=[*bounds, (None, None)]).x
    return np.append(best[:-1] / std, best[-1] - best[:-1] @ (mean / std))


def fit_to(floors: list[Labelled]) -> tuple[np.ndarray, np.ndarray]:
    """The fit to all openings of some floors, without and with the plan of the rooms."""
    labels = [np.concatenate([getattr(one, k) for one in floors]) for k in ("is_door", "weight")]
    by_shape = fit(np.concatenate([one.found[2] for one in floors]), *labels)
    return by_shape, fit(np.concatenate([one.with_rooms(by_shape) for one in floors]), *labels)


def left_out(floors: list[Labelled]) -> list[Row]:
    """Each floor evaluated with the weights of the other buildings."""
    rows = []
    for one in floors:
        by_shape, in_plan = fit_to([other for other in floors if other.fold != one.fold])
        confidence = door_probability(one.with_rooms(by_shape), in_plan)
        doors = select_doors(one.grid, *one.found[:2], confidence, DoorSettings().min_confidence)
        rows.append({"kind": one.kind, "cpu_s": np.nan, **judged(doors, one.jambs_m, one.unclear_m)})
    return rows


def main(arguments: list[str] | None = None) -> None:
    """Fit, print the results on buildings that were left out, store."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=24, help="generated buildings")
    parser.add_argument("--write", action="store_true", help="store the weights")
    given = parser.parse_args(arguments)
    floors = [
        labelled(f"generated {s}", f"generated {s // 2 % FOLDS}") for s in seeds_of("open", given.count)
    ]
    floors += [
        labelled(f"real {name}", name.split("/")[0].rstrip("_0123456789")) for name in real_names("open")
    ]
    rows = left_out(floors)
    for name, real in (("left out, real", True), ("left out, generated", False)):
        print_rows(table(name, [row for row in rows if (row["kind"] == "real") == real])[:-1])
    names = ("by_shape", (*MEASURES, "constant")), ("in_plan", (*MEASURES, *PLAN_MEASURES, "constant"))
    weights = {
        name: dict(zip(measures, found.round(3).tolist(), strict=True))
        for (name, measures), found in zip(names, fit_to(floors), strict=True)
    }
    print(json.dumps(weights, indent=1))
    if given.write:
        TABLE.write_text(json.dumps(weights, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
