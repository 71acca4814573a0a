"""Navigation with pushes on real maps, executed in MuJoCo: fraction of goals reached.

``python -m benchmarks.nav_scenes --scenes 300 --report out.json`` runs the campaign and prints the fractions of goals reached;
scenes in the report are not run again. A scene is a window of a real map with 1 to 10 objects, one of them at a narrow passage,
tagged with earlier observations; friction and centre of mass differ from the tag by its standard deviation, some objects are too
heavy, some were never touched. It counts as solvable when the planner, with the true properties and more time than during
navigation, has a plan for a robot that is larger by half a cell: a disc of the true radius among square cells. The robot's
pose is known to 6 mm.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._nav_scene import SEED, Scene, larger, make_scene
from visuohaptic.core.files import write_text
from visuohaptic.navigation.planning import make_plan, without_pushing
from visuohaptic.navigation.planning.search import SearchLimits
from visuohaptic.navigation.problem import PlanningProblem
from visuohaptic.simulation.floor import FloorRobot, FloorSenses, FloorWorld
from visuohaptic.tasks.mobile.travel import Travel, travel

from .harness import use_one_thread
from .nav_doors import data_folder

__all__ = ["play", "run"]

LIMITS = SearchLimits(budget_s=2.0)


#: Budget for deciding whether a scene is solvable: larger than during navigation.
PATIENT = SearchLimits(budget_s=20.0)


def plan(problem: PlanningProblem) -> Any:
    """The planner with a budget of seconds."""
    return make_plan(problem, limits=LIMITS)


def execute(scene: Scene) -> tuple[Travel, FloorWorld]:
    """One navigation run in physics."""
    problem = scene.problem
    world = FloorWorld(
        scene.walls,
        scene.items,
        (*problem.start_m, scene.heading_rad),
        FloorRobot(problem.robot.radius_m, problem.robot.push_force_max_N),
    )
    senses = FloorSenses(world, np.random.default_rng([SEED, scene.index, 1]))
    return travel(problem, world.base, senses, world.step, plan=plan), world


def play(folder: Path, index: int, *, hopeless: bool = True) -> dict[str, Any]:
    """Plan and execute one scene; if no plan exists for the true scene, it is executed only if ``hopeless``."""
    begin_s = time.process_time()
    scene = make_scene(folder, index)
    made_s = time.process_time()
    free = without_pushing(larger(scene.problem)).reachable
    solvable = free or make_plan(larger(scene.truth), limits=PATIENT).reachable
    asked_s = time.process_time()
    known = {
        "index": index,
        "map": scene.name,
        "things": len(scene.items),
        "free": bool(free),
        "solvable": bool(solvable),
    }
    if not solvable and not hopeless:
        return {
            **known,
            "arrived": None,
            "cpu_s": [round(made_s - begin_s, 2), round(asked_s - made_s, 2), 0.0],
        }
    done, world = execute(scene)
    end_s = time.process_time()
    off_m = float(np.hypot(*(world.pose_m()[:2] - scene.problem.goal_m)))
    return {
        **known,
        "arrived": bool(done.arrived and off_m < 0.1),
        "outcome": str(done.outcome),
        "reason": done.reason,
        "off_m": round(off_m, 3),
        "seconds": round(done.duration_s, 1),
        "pushes": done.pushes,
        "plans": done.plans,
        "wall_s": round(world.wall_s, 2),
        "steps": world.steps,
        "cpu_s": [round(made_s - begin_s, 2), round(asked_s - made_s, 2), round(end_s - asked_s, 2)],
    }


def campaign(
    indices: Sequence[int], report: Path | None = None, *, verbose: bool = False, hopeless: bool = True
) -> list[dict[str, Any]]:
    """Run scenes that are not in the report yet."""
    logging.getLogger("visuohaptic").setLevel(logging.ERROR)
    known: dict[int, dict[str, Any]] = {}
    if report is not None and report.exists():
        known = {entry["index"]: entry for entry in json.loads(report.read_text())}
    for index in indices:
        if index not in known:
            known[index] = play(data_folder(), index, hopeless=hopeless)
            if verbose:
                print(json.dumps(known[index]), flush=True)
            if report is not None:
                write_text(report, json.dumps(list(known.values()), indent=1))
    return [known[index] for index in indices]


def rows_of(entries: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of the table."""
    solvable = [entry for entry in entries if entry["solvable"]]
    tried = [entry for entry in entries if not entry["solvable"] and entry["arrived"] is not None]
    blocked = [entry for entry in solvable if not entry["free"]]

    def fraction(chosen: Sequence[dict[str, Any]], key: str) -> float:
        return 100.0 * float(np.mean([entry[key] for entry in chosen])) if chosen else float("nan")

    cpu_s = float(np.sum([sum(entry["cpu_s"]) for entry in entries]))
    return [
        {
            "name": "travels that arrive, of the solvable",
            "ours": fraction(solvable, "arrived"),
            "peer": fraction(solvable, "free"),
            "peer_name": "push-free planner, plans alone",
            "unit": "%",
            "floor": 95.0,
            "aim": 99.0,
            "higher_is_better": True,
            "note": f"{len(entries)} scenes on real maps, {len(solvable)} solvable, MuJoCo",
        },
        {
            "name": "... of those that need pushing",
            "ours": fraction(blocked, "arrived"),
            "unit": "%",
            "higher_is_better": True,
            "note": f"{len(blocked)} scenes",
        },
        {
            "name": "... of those called unsolvable",
            "ours": fraction(tried, "arrived"),
            "unit": "%",
            "higher_is_better": True,
            "note": f"{len(tried)} executed, of {len(entries) - len(solvable)}",
        },
        {"name": "300 scenes, CPU time", "ours": cpu_s * 300 / max(len(entries), 1) / 60, "unit": "min", "aim": 20.0},
    ]  # fmt: skip


def run(scenes: int = 12) -> list[dict[str, Any]]:
    """A slice; 300 is the campaign."""
    return rows_of(campaign(range(scenes))) if data_folder().is_dir() else []


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=12)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", type=int, nargs="*", help="numbers of scenes")
    parser.add_argument(
        "--not-hopeless", action="store_true", help="do not execute what no plan solves that knows the truth"
    )
    parser.add_argument("--report", type=Path, help="JSON that is written after every scene")
    arguments = parser.parse_args()
    use_one_thread()
    wanted = arguments.only or range(arguments.first, arguments.first + arguments.scenes)
    played = campaign(list(wanted), arguments.report, verbose=True, hopeless=not arguments.not_hopeless)
    for row in rows_of(played):
        print(f"{row['name']:<40}{row['ours']:8.2f} {row['unit']:<4}{row.get('note', '')}")
    sys.exit(0)
