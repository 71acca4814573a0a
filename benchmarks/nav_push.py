"""Accuracy of the push models: sideward and direct pushes in MuJoCo and in reality, speed, and the benefit of contact tracking.

python -m benchmarks nav_push               a slice
python -m benchmarks.nav_push --count 200   the campaign of random objects: errors of position and turn
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._push_direct import drive_direct, predicted, random_direct
from benchmarks._push_loop import closed_loop
from benchmarks._push_world import RADIUS_M, random_case
from benchmarks._zhou2016 import TRIANGLE_M, RealPush, read_pushes, support_points
from benchmarks.peers.impulse_push import simulate_impulses
from visuohaptic.navigation.pushing import (
    PushModel,
    PushTrace,
    PushUncertainty,
    covariance_of_ends,
    load_of_feet,
    sampled_pushes,
    simulate_push,
)

__all__ = ["real_centres", "real_ends", "real_push_errors", "run", "sideward_errors"]

SEED = 20161204
#: Steel pusher on aluminium; chosen from 0.1 to 0.5 on the log 30_90_30, hard floor.
REAL_FRICTION = 0.5
#: Of the pusher (m), from the authors' own simulation.
REAL_RADIUS_M = 0.001
CHI2_90 = 6.251  #: of a vector of three normal variables
#: Centroid of the triangle in its frame (m).
CENTRE_M = np.array([0.05, 0.05])


def sideward_errors(count: int, seed: int = SEED) -> dict[str, np.ndarray]:
    """Errors of final position (m) and turn (rad) against MuJoCo, and correctly predicted releases, for both models."""
    rng = np.random.default_rng(seed)
    rows: dict[str, list[float]] = {
        f"{model} {what}": [] for model in ("ours", "algorithm 2") for what in ("position", "turn", "drop")
    }
    for index in range(count):
        case = random_case(rng, index)
        truth = case.truth()
        if not truth.touching.any():
            continue
        path = case.path_m[::2]
        for name, simulate in (("ours", simulate_push), ("algorithm 2", simulate_impulses)):
            trace = simulate(case.model, case.start_m, path, RADIUS_M)
            off = trace.object_m[-1] - truth.object_m[-1]
            rows[f"{name} position"].append(float(np.hypot(off[0], off[1])))
            rows[f"{name} turn"].append(abs(float(np.angle(np.exp(1j * off[2])))))
            rows[f"{name} drop"].append(float(trace.released == truth.dropped))
    return {name: np.array(values) for name, values in rows.items()}


def real_push_errors(folder: Path) -> dict[str, dict[str, np.ndarray]]:
    """For every log of the CMU pushes: moved, and errors of position (m) and turn (rad) of both models."""
    found = {}
    for log, supports, pushes in _real_logs(folder):
        model = _triangle(supports)
        rows: dict[str, list[float]] = {}
        for begin, end, drive in pushes:
            rows.setdefault("moved", []).append(float(np.hypot(*(end - begin)[:2])))
            traces: dict[str, PushTrace] = {
                "ours": simulate_push(model, begin, drive, REAL_RADIUS_M),
                "algorithm 2": simulate_impulses(model, begin, drive, REAL_RADIUS_M, contact_range_m=5e-4),
            }
            for name, trace in traces.items():
                off = trace.object_m[-1] - end
                rows.setdefault(f"{name} position", []).append(float(np.hypot(off[0], off[1])))
                rows.setdefault(f"{name} turn", []).append(abs(float(np.angle(np.exp(1j * off[2])))))
        found[log] = {what: np.array(values) for what, values in rows.items()}
    return found


def real_centres(folder: Path) -> np.ndarray:
    """Centres of friction of the CMU triangle that explain its pushes best, from its centroid by the lever of its bottom.

    Six numbers: x, y of the centre of mass, which the loads of three supports tell (mean of three logs), and of the
    centre of pressure of the flat bottom on each of two floors.
    """
    from scipy.optimize import minimize

    supported, flat = [], []
    for _, supports, pushes in _real_logs(folder):
        scale_m = _triangle(supports).gyration_m

        def loss(
            centre: np.ndarray, supports: Any = supports, pushes: Any = pushes, scale_m: float = scale_m
        ) -> float:
            model = _triangle(supports, centre)
            total = 0.0
            for begin, end, drive in pushes:
                off = simulate_push(model, begin, drive, REAL_RADIUS_M).object_m[-1] - end
                total += np.hypot(off[0], off[1]) + scale_m * abs(np.angle(np.exp(1j * off[2])))
            return total / len(pushes)

        corners = [[0.0, 0.0], [0.004, 0.0], [0.0, 0.004]]
        options = {"initial_simplex": corners, "maxfev": 60, "xatol": 1e-4, "fatol": 1e-6}
        centre_m = minimize(loss, corners[0], method="Nelder-Mead", options=options).x
        (flat if supports is None else supported).append(centre_m)
    return np.concatenate([np.mean(supported, axis=0), *flat]) / _triangle(None).lever_m


def real_ends(folder: Path, samples: int = 400) -> np.ndarray:
    """Squared lengths of the errors of the CMU pushes of a flat bottom, by the covariance of simulated ends.

    What is told to the simulation is the outline alone.
    """
    # Pusher and object are 1.2 mm apart (rms) when they should touch: error of the position, along and across.
    known = PushUncertainty(place_m=0.0012, yaw_rad=0.0012 / _triangle(None).gyration_m)
    found = []
    for _, supports, pushes in _real_logs(folder):
        for begin, end, drive in pushes if supports is None else ():
            model, rng = PushModel.of_footprint(TRIANGLE_M - CENTRE_M), np.random.default_rng(0)
            _, along, _ = sampled_pushes(
                model, begin, drive, REAL_RADIUS_M, rng, uncertainty=known, samples=samples
            )
            middle = along[:, -1].mean(axis=0)
            error = end - middle
            error[2] = np.angle(np.exp(1j * error[2]))
            found.append(error @ np.linalg.solve(covariance_of_ends(along[:, -1] - middle), error))
    return np.array(found)


def _triangle(supports: np.ndarray | None, centre_m: Any = (0.0, 0.0)) -> PushModel:
    """The CMU triangle about its centroid, its centre of friction elsewhere."""
    outline = TRIANGLE_M - CENTRE_M
    if supports is None:
        return PushModel.patch(outline, REAL_FRICTION).with_centre_moved(*centre_m)
    feet_m = supports - CENTRE_M
    return PushModel(outline, feet_m, load_of_feet(feet_m, tuple(centre_m)), REAL_FRICTION)


def _real_logs(folder: Path) -> list[tuple[str, np.ndarray | None, list[tuple[np.ndarray, ...]]]]:
    """Name, supports and pushes of every log."""
    return [
        (path.name, support_points(path.name), [_push_frame(push) for push in read_pushes(path)])
        for path in sorted(folder.glob("*_50*.txt.gz"))
    ]


def _push_frame(push: RealPush) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses of the centroid before and after, and the pusher's path half a millimetre apart."""

    def centroid(pose: np.ndarray) -> np.ndarray:
        c, s = np.cos(pose[2]), np.sin(pose[2])
        return np.array([*(pose[:2] + CENTRE_M @ np.array([[c, s], [-s, c]])), pose[2]])

    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(push.tip_m, axis=0).T))])
    at = np.linspace(0.0, way[-1], 33)
    drive = np.column_stack([np.interp(at, way, push.tip_m[:, i]) for i in (0, 1)] + [np.zeros(33)])
    return centroid(push.before_m), centroid(push.after_m), drive


def _sideward(count: int) -> list[dict[str, Any]]:
    errors = sideward_errors(count)
    number = len(errors["ours drop"])
    note = (
        f"{number} things: boxes, discs, polygons, L; friction 0-0.4, line and arc of 1 m; peer: Algorithm 2"
    )

    def row(
        name: str, what: str, of: Any, scale: float, unit: str, floor: float | None, aim: float
    ) -> dict[str, Any]:
        ours, peer = (scale * float(of(errors[f"{model} {what}"])) for model in ("ours", "algorithm 2"))
        limits = {} if floor is None else {"floor": floor}
        return {"name": name, "ours": ours, "peer": peer, "unit": unit, "aim": aim, "note": note, **limits}

    return [
        row("sideward push, position off MuJoCo's, median", "position", np.median, 100, "cm", 4.0, 1.5),
        row("sideward push, position, p90", "position", lambda e: np.quantile(e, 0.9), 100, "cm", 19.0, 5.0),
        row("sideward push, turn, median", "turn", np.median, 180 / np.pi, "deg", 4.5, 2.0),
        row("sideward push, drop told right", "drop", np.mean, 100, "%", 95.0, 99.0),
    ]


def _speed() -> list[dict[str, Any]]:
    from .harness import cpu_seconds

    rng = np.random.default_rng(SEED)
    cases = [random_case(rng, index) for index in range(40)]
    ours, peer = [], []
    for case in cases:
        path = case.path_m[::2]
        ours.append(
            cpu_seconds(
                lambda c=case, p=path: simulate_push(c.model, c.start_m, p, RADIUS_M),
                repeats=3,
                min_s=0.005,
            )
        )
        peer.append(
            cpu_seconds(
                lambda c=case, p=path: simulate_impulses(c.model, c.start_m, p, RADIUS_M),
                repeats=3,
                min_s=0.005,
            )
        )
    return [
        {
            "name": "one push candidate of 1 m, median",
            "ours": 1e3 * float(np.median(ours)),
            "peer": 1e3 * float(np.median(peer)),
            "unit": "ms",
            "floor": 5.0,
            "aim": 0.1,
            "peer_name": "Algorithm 2, compiled by us too",
            "note": f"p90 {1e3 * float(np.quantile(ours, 0.9)):.2f} ms",
        }
    ]


def _real() -> list[dict[str, Any]]:
    named = os.environ.get("VISUOHAPTIC_DATA")
    data = Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = data / "navigation" / "dev" / "push" / "zhou2016"
    if not folder.is_dir():
        return []
    rows = []
    for name, errors in real_push_errors(folder).items():
        for what, scale, unit in (("position", 1e3, "mm"), ("turn", 180 / np.pi, "deg")):
            ours, peer = (errors[f"{model} {what}"] for model in ("ours", "algorithm 2"))
            rows.append(
                {
                    "name": f"real pushes, {what} off, {name.split('_exp')[0]}",
                    "ours": scale * float(np.median(ours)),
                    "peer": scale * float(np.median(peer)),
                    "ratio": float(np.median(peer) / np.median(ours)),
                    "unit": unit,
                    "peer_name": "Algorithm 2",
                    "note": f"p90 {scale * float(np.quantile(ours, 0.9)):.2f}, "
                    f"moved {1e3 * float(np.median(errors['moved'])):.1f} mm",
                }
            )
    squares = real_ends(folder)
    rows.append(
        {
            "name": "real pushes of a flat bottom inside the declared 90 % ellipsoid",
            "ours": 100.0 * float(np.mean(squares < CHI2_90)),
            "unit": "%",
            "note": f"{len(squares)} pushes, 85 to 95 %; mean squared length {squares.mean():.2f} of 3",
        }
    )
    rows.append(
        {
            "name": "real pushes, centre of friction from the centroid, by the lever of the bottom, rms",
            "ours": float(np.sqrt(np.mean(real_centres(folder) ** 2))),
            "unit": "",
            "note": "a centre of mass and two of pressure, x and y",
        }
    )
    return rows


def _loop(count: int) -> list[dict[str, Any]]:
    trials = [trial for seed in range(count) if (trial := closed_loop(SEED + seed)) is not None]
    return [
        {
            "name": "object dropped although friction and centre of mass are not those of the plan",
            "ours": 100.0 * float(np.mean([trial.corrected for trial in trials])),
            "peer": 100.0 * float(np.mean([trial.plain for trial in trials])),
            "higher_is_better": True,
            "unit": "%",
            "peer_name": "the plan driven as it was",
            "note": f"{len(trials)} boxes, corrected from the tracked contact, MuJoCo",
        }
    ]


def direct_errors(count: int, length_m: float = 0.5) -> dict[str, np.ndarray]:
    """Direct pushes of boxes and polygons with off-centre mass: errors of position (m) and turn (rad).

    ``steered`` looks at the object and steers, ``straight`` drives as planned,
    ``model`` is what :func:`simulate_push`, told the truth, foresees of the straight one.
    """
    rows: dict[str, list[float]] = {
        f"{how} {what}": [] for how in ("steered", "straight", "model") for what in ("off", "turn")
    }
    for index in range(count):
        rng = np.random.default_rng([SEED, index])
        case = random_direct(rng)
        for how in ("steered", "straight"):
            end = drive_direct(case, length_m, see=how == "steered")
            rows[f"{how} off"].append(float(np.hypot(end[0] - length_m, end[1])))
            rows[f"{how} turn"].append(abs(float(end[2])))
            if how == "straight":
                told = predicted(case, length_m)
                rows["model off"].append(float(np.hypot(*(told - end)[:2])))
                rows["model turn"].append(abs(float(told[2] - end[2])))
    return {name: np.array(values) for name, values in rows.items()}


def _direct(count: int) -> list[dict[str, Any]]:
    errors = direct_errors(count)
    note = f"{count} boxes and polygons, mass 2 cm off the middle, friction 0.1-0.5, 0.5 m, MuJoCo"
    rows = []
    for what, scale, unit in (("off", 100.0, "cm"), ("turn", 180 / np.pi, "deg")):
        ours, peer = (scale * float(np.median(errors[f"{how} {what}"])) for how in ("steered", "straight"))
        rows.append(
            {
                "name": f"direct push, {'off its goal' if what == 'off' else 'turned'}, median",
                "ours": ours,
                "peer": peer,
                "peer_name": "the same push, not steered",
                "unit": unit,
                "note": f"{note}; p90 {scale * float(np.quantile(errors[f'steered {what}'], 0.9)):.1f}",
            }
        )
        rows.append(
            {
                "name": f"direct push, model off MuJoCo's {'place' if what == 'off' else 'turn'}, median",
                "ours": scale * float(np.median(errors[f"model {what}"])),
                "unit": unit,
                "note": f"told the truth, straight; p90 {scale * float(np.quantile(errors[f'model {what}'], 0.9)):.1f}",
            }
        )
    return rows


def run(count: int = 12, loops: int = 8) -> list[dict[str, Any]]:
    """Rows of the table; 200 and 100 are the campaign."""
    return [*_sideward(count), *_direct(count), *_speed(), *_real(), *_loop(loops)]


if __name__ == "__main__":
    from benchmarks import harness

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=12, help="random things")
    parser.add_argument("--loops", type=int, default=8, help="closed loops")
    arguments = parser.parse_args()
    harness.use_one_thread()
    report = harness.run([], "benchmarks")
    report.rows.extend(harness._judged("nav_push", row) for row in run(arguments.count, arguments.loops))
    print(harness.table(report))
    sys.exit(0)
