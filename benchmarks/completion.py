"""Completion by touch: accuracy on 700 parametric bottles, and the computing time of every part.

The middle 46 % of the height of each bottle is hidden and touched, at planned
and at random places. The error is the mean square distance of a regular grid on the
true wall from the estimated surface.

    python -m benchmarks completion                                   a slice of the study, and the times
    python -m benchmarks.completion --objects 700 --report out.json   the study: touches needed, error against sigma; resumable
"""

from __future__ import annotations

import argparse
import json
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from visuohaptic.cli._arguments import Add
from visuohaptic.cli._workers import add_worker_arguments, chosen_workers
from visuohaptic.core.files import write_text
from visuohaptic.reconstruction.completion import Completion
from visuohaptic.reproduce.worlds import HOLE, SIGMA_M, TOUCHES, explore, touches_to_tenth
from visuohaptic.simulation.tabletop import Bottle, random_bottle

from . import harness
from ._journal import Journal

SEED = 20261121
#: Numbers of touches at which the deviation is compared with the error.
STAGES = (0, 1, 2, 3, 5, 8, 10, 15)


def study(
    objects: int,
    seed: int = SEED,
    *,
    touches: int = TOUCHES,
    priors: bool = True,
    journal: Path | None = None,
    workers: int | str = 1,
) -> dict[str, Any]:
    """Planned and random exploration of many bottles; ``journal`` keeps each, so that a stopped study goes on.

    ``workers`` as of :func:`map_tasks`.
    """
    about = {"study": "completion", "seed": seed, "touches": touches, "priors": priors}
    done = Journal(journal, about)
    names = ("planned", "random")
    tasks = {f"{number} {name}": (seed, number, name) for number in range(objects) for name in names}
    done.fill(partial(_explored, priors=priors, touches=touches), tasks, workers)
    runs = {name: [done.rows[f"{number} {name}"] for number in range(objects)] for name in names}
    mean = {name: np.mean([run["mse"] for run in found], axis=0) for name, found in runs.items()}
    ratio = {
        name: np.mean([np.array(run["mse"]) / run["mse"][0] for run in found], axis=0)
        for name, found in runs.items()
    }
    planned = runs["planned"]
    return {
        "objects": objects,
        "priors": priors,
        "touches_to_tenth": {
            name: float(np.median([touches_to_tenth(run["mse"]) for run in found]))
            for name, found in runs.items()
        },
        "mean_mse_m2": {name: curve.tolist() for name, curve in mean.items()},
        "mean_ratio": {name: curve.tolist() for name, curve in ratio.items()},
        "steps_not_better_than_random": int((mean["planned"][1:] >= mean["random"][1:]).sum()),
        "blown_up": [number for number, run in enumerate(planned) if blown_up(run["mse"])],
        "spearman": float(np.nanmedian([np.nanmedian(run["spearman"]) for run in planned])),
        "spearman_by_stage": _by_stage(planned, "spearman"),
        "spearman_ceiling": float(np.nanmedian([np.nanmedian(run["spearman_ceiling"]) for run in planned])),
        "spearman_ceiling_by_stage": _by_stage(planned, "spearman_ceiling"),
        "spearman_with_band": float(
            np.nanmedian([np.nanmedian(run["spearman_with_band"]) for run in planned])
        ),
        "told_over_true": float(np.nanmedian([rank for run in planned for rank in run["told_over_true"]])),
        "told_over_true_by_stage": _by_stage(planned, "told_over_true"),
        "spearman_all": float(np.nanmedian([run.get("spearman_all", np.nan) for run in planned])),
        "step_s": float(np.median([step for run in planned for step in run["step_s"]])),
        "never": sum(touches_to_tenth(run["mse"]) == float("inf") for run in planned),
    }


def _explored(task: tuple[int, int, str], *, priors: bool, touches: int) -> dict[str, Any]:
    seed, number, name = task
    rng = np.random.default_rng([seed, number])
    bottle = random_bottle(rng)
    stages: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def compare(number: int, completion: Completion) -> None:
        if number in STAGES:
            # Deviation of every point of the surface, its distance from the true wall, and whether it was not seen.
            found = completion.uncertainty()
            stages.append((found.sigma_m, wall_distance_m(bottle, found.mesh.vertices_m), found.missing))

    found = explore(bottle, rng, planned=name == "planned", priors=priors, touches=touches, on_plan=compare)
    hidden = [(told[missing], true[missing]) for told, true, missing in stages]
    found["spearman"] = [float(spearmanr(told, true).statistic) for told, true in hidden]
    found["spearman_ceiling"] = [spearman_ceiling(told, seed) for told, _ in hidden]
    #: With the visible band around the hole, which is part of the completed surface.
    found["spearman_with_band"] = [float(spearmanr(told, true).statistic) for told, true, _ in stages]
    found["told_over_true"] = [float(np.sqrt(np.mean(told**2) / np.mean(true**2))) for told, true in hidden]
    if stages:
        # All stages of one exploration together: does sigma decrease when and where the error does?
        told, true = (np.concatenate(part) for part in zip(*hidden, strict=True))
        found["spearman_all"] = float(spearmanr(told, true).statistic)
    return found


def spearman_ceiling(sigma_m: np.ndarray, seed: int, draws: int = 20) -> float:
    """Mean rank correlation of deviations with normal errors that have exactly these deviations.

    No declaration has a larger one in expectation unless deviations differ more between points than the declared ones do:
    the error of a point is one draw, so that equal deviations show different errors. Two halves of points whose deviations
    differ by a factor q have sqrt(3) (2 / pi arctan(q) - 1 / 2): .51 for q = 3, at most .87.

    Parameters
    ----------
    sigma_m
        Declared deviations (n) [m].
    seed
        Seed of the draws.
    draws
        Number of draws.
    """
    rng = np.random.default_rng([seed, 5])
    errors = np.abs(sigma_m * rng.standard_normal((draws, len(sigma_m))))
    return float(np.mean([spearmanr(sigma_m, error).statistic for error in errors]))


def wall_distance_m(bottle: Bottle, points: np.ndarray) -> np.ndarray:
    """Distance of points near the wall from it [m]: along the normal, of second order in the radial distance.

    Parameters
    ----------
    bottle
        Object.
    points
        Points (n, 3) [m].
    """
    theta = np.arctan2(points[:, 1], points[:, 0])
    z = np.clip(points[:, 2], 0.0, bottle.height_m)
    rho = bottle.radius_m(theta, z)
    step = 1e-5
    climb = (bottle.radius_m(theta, z + step) - bottle.radius_m(theta, z - step)) / (2 * step)
    turn = (bottle.radius_m(theta + step, z) - bottle.radius_m(theta - step, z)) / (2 * step) / rho
    return np.abs(np.hypot(points[:, 0], points[:, 1]) - rho) / np.sqrt(1 + climb**2 + turn**2)


def blown_up(mse: list[float]) -> bool:
    """Whether the error rises above twice the untouched one, or tenfold in one step to a fifth of it.

    Parameters
    ----------
    mse
        Mean square error [m^2] before and after each touch.
    """
    found = np.array(mse)
    jump = (found[1:] > 10 * found[:-1]) & (found[1:] > 0.2 * found[0])
    # Half a millimetre is noise, not a blow-up, however good the start was.
    return bool(((found > 2 * found[0]) & (found > 0.0005**2)).any() or jump.any())


def _by_stage(runs: list[dict[str, Any]], name: str) -> dict[str, float]:
    """Median over objects at each number of touches."""
    values = np.array([run[name] for run in runs if len(run[name]) == len(STAGES)]).reshape(-1, len(STAGES))
    if not len(values):
        return {}
    return {
        str(stage): float(value) for stage, value in zip(STAGES, np.nanmedian(values, axis=0), strict=True)
    }


def _band_surface(count: int = 1000) -> tuple[np.ndarray, np.ndarray]:
    """Centres of a bottle's two bands: on, outside and inside."""
    rng = np.random.default_rng(SEED)
    n = count // 3
    theta = rng.uniform(0, 2 * np.pi, n)
    z = np.where(rng.random(n) < 0.5, rng.uniform(0, 0.05, n), rng.uniform(0.13, 0.18, n))
    normals = np.column_stack([np.cos(theta), np.sin(theta), 0 * theta])
    points = 0.035 * normals + np.column_stack([0 * z, 0 * z, z])
    centers = np.concatenate([points, points + 0.005 * normals, points - 0.005 * normals])
    return centers, np.concatenate([np.zeros(n), np.full(n, 0.005), np.full(n, -0.005)])


def speeds() -> list[dict[str, Any]]:
    """Time of the fit, the surface, the score."""
    from scipy.interpolate import RBFInterpolator
    from scipy.spatial import cKDTree

    from visuohaptic.reconstruction.fusion import SpaceGrid
    from visuohaptic.reconstruction.surfaces import BiharmonicMesh, RbfSurface, isosurface

    centers, values = _band_surface()
    grid = SpaceGrid.around(np.array([-0.06, -0.06, 0.03]), np.array([0.06, 0.06, 0.15]), 0.12 / 64)
    fitted = RbfSurface(centers, values, 1e-8)
    contact = np.array([[0.037, 0.0, 0.09]])
    full_s = harness.cpu_seconds(lambda: isosurface(RbfSurface(centers, values, 1e-8), grid))
    one_s = harness.cpu_seconds(lambda: isosurface(fitted.added(contact, np.zeros(1), 1e-6), grid))

    def peer() -> object:
        from skimage.measure import marching_cubes

        model = RBFInterpolator(centers, values, kernel="cubic", degree=1)
        return marching_cubes(model(grid.all_centres_m).reshape(grid.shape), 0.0)

    started_s = time.process_time()
    peer()
    peer_s = time.process_time() - started_s
    rows = [
        {"name": "RBF fit + isosurface, 1000 centres, 64^3", "ours": 1e3 * full_s, "unit": "ms CPU",
         "peer": 1e3 * peer_s, "peer_name": "scipy + scikit-image", "floor": 150.0, "aim": 80.0},
        {"name": "RBF + isosurface after one touch", "ours": 1e3 * one_s, "unit": "ms CPU",
         "floor": 60.0, "aim": 30.0},
    ]  # fmt: skip
    for count, floor, aim in ((2000, 140.0, 40.0), (5000, 330.0, 100.0)):
        # Vertices of the surface grow with the square of the nodes.
        step = 0.12 / 63 * np.sqrt(len(isosurface(fitted, grid)[0]) / count)
        vertices, faces = isosurface(fitted, SpaceGrid.around(grid.low_m, grid.low_m + 0.12, float(step)))
        supports = cKDTree(vertices).query(centers[:300])[1]
        spent_s = harness.cpu_seconds(lambda v=vertices, f=faces, s=supports: BiharmonicMesh(v, f).score(s))
        rows.append(
            {"name": f"biharmonic score, {len(vertices)} vertices, 300 supports", "ours": 1e3 * spent_s,
             "unit": "ms CPU", "floor": floor, "aim": aim}
        )  # fmt: skip
    return [*rows, {"name": "least supported place as by dense reference", "unit": "of meshes",
                    "ours": argmax_agreement(12), "floor": 0.95, "note": "12 bottles"}]  # fmt: skip


def argmax_agreement(count: int, seed: int = SEED) -> float:
    """Fraction of meshes on which the fast score and all exact distances select the same vertex."""
    from visuohaptic.reconstruction.surfaces import BiharmonicMesh

    equal = 0
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        bottle = random_bottle(rng)
        vertices, faces = bottle.mesh(0.0, bottle.height_m, step_m=0.008)
        low = vertices[:, 2] < HOLE[0] * bottle.height_m
        known = np.flatnonzero(low | (vertices[:, 2] > HOLE[1] * bottle.height_m))
        touched = rng.choice(len(vertices), int(rng.integers(0, 12)), replace=False)
        supports = np.union1d(rng.choice(known, 200), touched)
        # A bottle of equal stacked rings has many equivalent places: add the roughness of a fused surface.
        mesh = BiharmonicMesh(vertices + rng.normal(0, 2e-4, vertices.shape), faces)
        exact = mesh.distance(np.arange(len(vertices)), supports).min(axis=1)
        best = int(np.argmax(mesh.score(supports)))
        equal += bool(exact[best] >= exact.max() * (1 - 1e-9))
    return equal / count


def run(objects: int = 12) -> list[dict[str, Any]]:
    """Rows of the table; the study on a slice of the 700 bottles."""
    found = study(objects)
    note = f"{objects} of 700 bottles, {TOUCHES} touches, noise {1e3 * SIGMA_M:g} mm"
    return [*speeds(), *study_rows(found, note)]


def study_rows(found: dict[str, Any], note: str) -> list[dict[str, Any]]:
    """Figures of a study."""
    return [
        {"name": "touches to a tenth of the error, median", "ours": found["touches_to_tenth"]["planned"],
         "peer": found["touches_to_tenth"]["random"], "peer_name": "random", "unit": "touches",
         "floor": 8.0, "aim": 5.0, "higher_is_better": False, "note": note},
        {"name": "steps not better than random", "ours": float(found["steps_not_better_than_random"]),
         "unit": "steps", "floor": 0.0, "aim": 0.0, "higher_is_better": False, "note": note},
        {"name": "blown up objects", "ours": float(len(found["blown_up"])), "unit": "objects",
         "floor": 0.0, "aim": 0.0, "higher_is_better": False, "note": note},
        {"name": "uncertainty against true error, Spearman over the hidden part, median of stages and objects",
         "ours": found["spearman"], "unit": "", "floor": 0.55, "aim": 0.7, "higher_is_better": True,
         "peer": found["spearman_ceiling"], "peer_name": "normal errors with the declared deviations",
         "note": " ".join(
             f"{stage}: {value:.2f} of {found['spearman_ceiling_by_stage'][stage]:.2f}"
             for stage, value in found["spearman_by_stage"].items()
         )},
        {"name": "the same of normal errors drawn with exactly the declared deviations: the largest that a true declaration can have",
         "ours": found["spearman_ceiling"], "unit": "", "floor": None, "aim": None, "note": note},
        {"name": "the same with the visible band around the hole",
         "ours": found["spearman_with_band"], "unit": "", "floor": 0.5, "aim": 0.7, "higher_is_better": True,
         "note": note},
        {"name": "the same of the hidden part, all stages of an object together",
         "ours": found["spearman_all"], "unit": "", "floor": 0.5, "aim": 0.7, "higher_is_better": True, "note": note},
        {"name": "declared deviation over true rms error, median", "ours": found["told_over_true"], "unit": "",
         "floor": (0.8, 1.25),
         "note": " ".join(f"{stage}: {value:.2f}" for stage, value in found["told_over_true_by_stage"].items())},
        {"name": "whole exploration step", "ours": 1e3 * found["step_s"], "unit": "ms CPU",
         "floor": 150.0, "aim": 50.0, "note": "plan, join, surface"},
    ]  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--objects", type=int, default=700)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--touches", type=int, default=TOUCHES)
    parser.add_argument("--no-priors", action="store_true")
    parser.add_argument("--report", type=Path)
    add_worker_arguments(Add(parser))
    arguments = parser.parse_args()
    harness.use_one_thread()
    result = study(
        arguments.objects,
        arguments.seed,
        touches=arguments.touches,
        priors=not arguments.no_priors,
        journal=arguments.report and arguments.report.with_suffix(".jsonl"),
        workers=chosen_workers(arguments),
    )
    figures = study_rows(result, f"{arguments.objects} bottles")
    if arguments.report:
        write_text(arguments.report, json.dumps({**result, "figures": figures}, indent=1) + "\n")
    for row in figures:
        print(
            f"{row['name']:95s} {row['ours']:8.3f} {row['unit']:8s} floor {row['floor']}  aim {row.get('aim')}  {row['note']}"
        )
    print(f"never down to a tenth: {result['never']} of {result['objects']} objects")
