"""Planned grasps lifted in an independent simulation: fraction that holds, and calibration of the declared probability.

    python -m benchmarks.grasp_evidence --seeds open --count 50 --report out.json

Containers of twelve kinds are described to the library, which plans the best grasp and its force; the lifted object has
its own wall, modulus, fill and friction (``tests/worlds/lifts.py``). A grasp holds if the object follows upright and its wall
deforms by less than the limit. The force has the library's default factor of safety, and two smaller ones, for
which a calibrated forecast must predict failures. Three metrics of the same grasps are compared: the declared probability, the
score of the dissertation, and the minimal work (Xu et al. 2020). ``--unselected`` compares them on grasps at random places with a
force of 1 N: of planned ones, most hold. ``--rims`` lifts open containers, including bowls, by a pinch of the wall at
the mouth where the planner offers one. Odd seeds are closed. An interrupted campaign is continued.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr
from tests.worlds.lifts import KINDS, RIM_KINDS, Lifted, LiftObject, lift, lift_object, lift_rim

from visuohaptic.core.files import write_text
from visuohaptic.core.objects import StiffnessMap
from visuohaptic.core.resources import one_blas_thread
from visuohaptic.deformation.maps import object_map
from visuohaptic.deformation.nonlinear import Contents
from visuohaptic.deformation.shapes import ContainerDescription, ShellObject, mesh_container
from visuohaptic.grasping import (
    Grasp,
    GraspPlan,
    GraspTask,
    Handling,
    Load,
    Verdict,
    object_load,
    plan_grasps,
    success_probability,
)

from ._forecasts import calibration_error
from ._journal import Journal
from ._seeds import add_seeds, seeds_of

#: Factors of safety: the default first.
SAFETY = (Handling().safety, 1.2, 1.0)
#: Force of grasps that no planner selected [N]: about half of the containers need more; with 5 N, 47 of 48 open ones hold.
UNSELECTED_N = 1.0


def lift_row(
    thing: LiftObject,
    container: ShellObject,
    surface: StiffnessMap,
    safety: float,
    *,
    confirm: bool | None = None,
    rim: bool = False,
) -> dict[str, Any]:
    """The best grasp of a container, or the best at its rim, and its result."""
    task = GraspTask(closed=thing.fill > 0, fill=thing.fill, handling=Handling(safety=safety))
    plan = plan_grasps(container, task, count=20 if rim else 1, confirm=confirm, surface=surface)
    found = [grasp for grasp in plan.grasps if grasp.rim or not rim]
    row: dict[str, Any] = {"kind": thing.kind, "fill": thing.fill, "safety": safety, "reason": plan.reason}
    if not found:
        return row | {"declared": 0.0, "success": False, "offered": False}
    best = found[0]
    lifted, give = carried(thing, best)
    assert best.approach is not None  # a grasp without a free approach is invalid
    return row | {
        "declared": best.success,
        "score": best.score,
        "work_J": best.work_J,
        "success": bool(lifted.held and give < task.parameters.max_deformation_m),
        "offered": True,
        "rim": best.rim,
        "height_m": float(best.first_m[2]),
        "force_N": best.force_N,
        "from_above": bool(best.approach.elevation_rad > np.pi / 4),
        "slip_m": lifted.slip_m,
        "turn_rad": lifted.turn_rad,
        "give_m": give,
    }


def carried(thing: LiftObject, best: Grasp) -> tuple[Lifted, float]:
    """Result of a lift, and deformation of the sides [m], which is zero for a pinch of the rim."""
    height = float(best.first_m[2])
    if not best.rim:
        return lift(thing, height, best.force_N), thing.give_m(height, best.force_N)
    middle = 0.5 * (best.first_m + best.second_m)
    radius = float(np.hypot(middle[0], middle[1]))
    outward = (-float(best.direction[:2] @ middle[:2]) / radius, -float(best.direction[2]))
    return lift_rim(thing, (radius, float(middle[2])), outward, best.force_N), 0.0


def described(seed: int, kinds: Sequence[str]) -> tuple[LiftObject, ShellObject, StiffnessMap]:
    """A container as it is, and as the planner knows it."""
    thing = lift_object(seed, kinds)
    text = ContainerDescription.model_validate({"name": thing.kind.replace(" ", "-"), **thing.described})
    container = mesh_container(text)
    return thing, container, object_map(container, Contents(fill=thing.fill) if thing.fill else None)


def unselected_row(seed: int, place: int) -> dict[str, Any]:
    """A grasp with a given force at a random place that the fingers reach, and its result; not a place that a planner chose."""
    thing, container, surface = described(seed, KINDS)
    task = GraspTask(force_N=UNSELECTED_N, closed=thing.fill > 0, fill=thing.fill)
    plan = plan_grasps(container, task, count=1, confirm=False, surface=surface)
    verdict = plan.feasibility.verdict
    reached = np.isin(verdict, (Verdict.FEASIBLE, Verdict.TOO_SOFT, Verdict.SPILLS, Verdict.TOO_WEAK))
    reached &= np.isin(np.arange(len(verdict)), surface.faces)
    heights = np.round(surface.vertices_m[:, 2], 6)
    height = float(np.random.default_rng([seed, place, 42]).choice(np.unique(heights[reached])))
    give = thing.give_m(height, UNSELECTED_N)
    held = give < task.parameters.max_deformation_m and lift(thing, height, UNSELECTED_N).held
    vertex = int(np.flatnonzero(reached & (heights == height))[0])
    return {
        "seed": seed, "kind": thing.kind, "fill": thing.fill, "offered": True, "height_m": height, "give_m": give,
        "success": bool(held), **metrics(plan, object_load(container, thing.fill), vertex),
    }  # fmt: skip


def metrics(plan: GraspPlan, load: Load, vertex: int) -> dict[str, float]:
    """Metrics of the grasp at a vertex, whether or not the plan selects it."""
    task, found, surface = plan.task, plan.feasibility, plan.surface
    needed, stiffness = float(found.needed_N[vertex]), float(surface.stiffness_N_per_m[vertex])
    both = np.minimum(plan.scores.perpendicular, plan.scores.opposite(plan.scores.perpendicular))[vertex]
    holds = success_probability(
        found.force_N[[vertex]], found.needed_N[[vertex]], np.arccos(np.clip([both], -1, 1)), load, task.gripper,
        task.handling, unloaded_sigma_N=found.unloaded_sigma_N[[vertex]],
    )  # fmt: skip
    spread = float(surface.stiffness_sigma_N_per_m[vertex]) / stiffness
    margin = np.log(task.parameters.max_deformation_m / float(plan.scores.deformation_m[vertex]))
    return {
        "score": float(plan.scores.pair[vertex]),
        "work_J": needed**2 / stiffness,
        "declared": float(holds[0] * ndtr(margin / spread)),
    }


@one_blas_thread()
def unselected(chosen: Sequence[int], journal: Path | None = None, places: int = 2) -> list[dict[str, Any]]:
    """Rows of some seeds, at random places; those in the journal are not measured again."""
    done = Journal(journal, {"campaign": "unselected grasps", "force_N": UNSELECTED_N})
    keys = {f"{seed} {place}": (seed, place) for seed in chosen for place in range(places)}
    for key, task in keys.items():
        if key not in done:
            done.put(key, unselected_row(*task))
            print(f"unselected: {key}", flush=True)
    return [done.rows[key] for key in keys]


@one_blas_thread()
def campaign(
    chosen: Sequence[int],
    journal: Path | None = None,
    *,
    factors: Sequence[float] = SAFETY,
    confirm: bool | None = None,
    rim: bool = False,
) -> list[dict[str, Any]]:
    """Rows of some seeds, with each factor of safety; those in the journal are not measured again."""
    done = Journal(journal, {"campaign": "grasp lifts with metrics", "confirm": confirm, "rim": rim})
    rows = []
    for seed in chosen:
        keys = {safety: f"{seed} {safety:g}" for safety in factors}
        missing = [safety for safety in factors if keys[safety] not in done]
        if missing:
            thing, container, surface = described(seed, RIM_KINDS if rim else KINDS)
            for safety in missing:
                done.put(keys[safety], lift_row(thing, container, surface, safety, confirm=confirm, rim=rim))
        rows += [{"seed": seed, **done.rows[key]} for key in keys.values()]
        print(f"lifts: seed {seed}", flush=True)
    return rows


def figures(rows: Sequence[dict[str, Any]], *, rim: bool = False) -> list[dict[str, Any]]:
    """Fraction that holds, and its difference from the declared probability; for rims, of the grasps offered."""
    out: list[dict[str, Any]] = []
    for safety in SAFETY:
        tried = [row for row in rows if row["safety"] == safety]
        some = [row for row in tried if row["offered"] or not rim]
        if not some:
            continue
        success = np.array([row["success"] for row in some], dtype=float)
        declared = np.array([row["declared"] for row in some])
        wrong = ", ".join(
            f"{row['kind']} {row['fill']:g} {row['reason'] or 'slips' if row.get('slip_m', 1) > 0.01 else 'gives way'}"
            for row in some
            if not row["success"]
        )
        above = sum(bool(row.get("from_above")) for row in some)
        default = safety == SAFETY[0]
        label = f"lifts{' by the rim' if rim else ''}, safety {safety:g}"
        out += [
            {"name": f"{label}: held", "ours": float(success.mean()), "unit": "1", "floor": 0.9 if default else None,
             "aim": 0.97 if default else None,
             "note": f"{len(some)} of {len(tried)} containers, {len({row['kind'] for row in some})} kinds, {above} from above; "
             f"failed: {wrong or 'none'}"},
            {"name": f"{label}: expected calibration error", "ours": calibration_error(declared, success), "unit": "1",
             "floor": 0.08 if default else None, "aim": 0.04 if default else None, "higher_is_better": False,
             "note": f"declared {declared.mean():.3f} on average"},
        ]  # fmt: skip
    return out


def separation(value: np.ndarray, success: np.ndarray) -> float:
    """Probability that a grasp that holds has a larger value than one that fails, and half of that of equal values.

    It is the area under the receiver operating characteristic; NaN unless some hold and some fail.
    """
    held, failed = value[success][:, None], value[~success]
    return float(((held > failed) + 0.5 * (held == failed)).mean()) if held.size and failed.size else np.nan


def metric_figures(rows: Sequence[dict[str, Any]], *, draws: int = 1000) -> list[dict[str, Any]]:
    """How well each metric separates the grasps that hold, with its 90 % range over containers (bootstrap)."""
    some = [row for row in rows if row["offered"]]
    success = np.array([row["success"] for row in some], dtype=bool)
    if not some or success.all() or not success.any():
        return []
    seeds = np.array([row["seed"] for row in some])
    of_seed = [np.flatnonzero(seeds == seed) for seed in np.unique(seeds)]
    rng, out = np.random.default_rng(0), []
    resampled = [
        np.concatenate([of_seed[k] for k in rng.integers(len(of_seed), size=len(of_seed))])
        for _ in range(draws)
    ]
    for name, key, sign in (
        ("minimal work", "work_J", -1.0), ("score", "score", 1.0), ("declared probability", "declared", 1.0),
    ):  # fmt: skip
        value = sign * np.array([row[key] for row in some])
        low, high = np.nanquantile([separation(value[one], success[one]) for one in resampled], (0.05, 0.95))
        out.append(
            {"name": f"lifts: area under ROC, {name}", "ours": separation(value, success), "unit": "1", "floor": None,
             "aim": None, "note": f"{low:.2f} to {high:.2f}; {len(some)} lifts, {np.count_nonzero(~success)} failed"}
        )  # fmt: skip
    return out


def run() -> list[dict[str, Any]]:
    """A slice: one container of each kind."""
    rows = campaign(range(0, 2 * len(KINDS), 2))
    return figures(rows) + metric_figures(rows)


def main() -> None:
    """Run the campaign."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.grasp_evidence",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_seeds(parser, 50, "containers")
    parser.add_argument(
        "--factors", type=float, nargs="+", choices=SAFETY, default=SAFETY, help="factors of safety"
    )
    parser.add_argument(
        "--confirm",
        action=argparse.BooleanOptionalAction,
        help="with the nonlinear simulation of each grasp; by default as the planner thinks fit",
    )
    parser.add_argument(
        "--unselected", action="store_true", help="compare the metrics at two random places of each"
    )
    parser.add_argument("--rims", action="store_true", help="open containers by their rims")
    parser.add_argument("--report", type=Path, help="JSON with all rows and figures")
    arguments = parser.parse_args()
    journal = arguments.report and arguments.report.with_name(
        f"{arguments.report.stem}{'_rims' if arguments.rims else ''}_{arguments.seeds}.jsonl"
    )
    chosen = seeds_of(arguments.seeds, arguments.count, arguments.first)
    rims = arguments.rims
    if arguments.unselected:
        path = journal and journal.with_name(f"{journal.stem}_unselected.jsonl")
        for row in metric_figures(unselected(chosen, path)):
            print(f"{row['name']:45s} {row['ours']:7.3f}  {row['note']}")
        return
    rows = campaign(chosen, journal, factors=arguments.factors, confirm=arguments.confirm, rim=rims)
    found = figures(rows, rim=rims) + ([] if rims else metric_figures(rows))
    for row in found:
        print(f"{row['name']:45s} {row['ours']:7.3f}  floor {row['floor']}  aim {row['aim']}  {row['note']}")
    if arguments.report:
        write_text(arguments.report, json.dumps({"rows": rows, "figures": found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
