"""Planning calls in a child process with a memory limit, which is killed when its CPU time is used up.

Only public names of ``visuohaptic.navigation`` are called. Requests and answers are lines of JSON.
"""

from __future__ import annotations

import base64
import json
import os
import resource
import select
import signal
import subprocess
import sys
import tempfile
import time
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from tests.worlds.maps import Robot, World, raster

__all__ = ["Planner", "described", "problem_of"]

ONE_THREAD = dict.fromkeys(
    ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)
#: Address space beyond the limit of a plan: the interpreter, compiled code and libraries [bytes].
OVERHEAD_BYTES = 3 << 30
#: A call is also killed after this many times its CPU budget of wall time: up to a hundred other processes may share the machine.
WALL_OF_CPU = 100.0


def _packed(cells: np.ndarray, resolution_m: float) -> dict[str, Any]:
    """A map as plain data: zlib and base64."""
    packed = base64.b64encode(zlib.compress(np.ascontiguousarray(cells).tobytes(), 1)).decode()
    return {"cells": packed, "shape": list(cells.shape), "resolution_m": resolution_m}


def described(world: World, resolution_m: float, cells: np.ndarray | None = None) -> dict[str, Any]:
    """A problem as plain data; ``cells`` where the map is not drawn from the world's walls."""
    robot = world.robot
    return {
        "map": _packed(raster(world, resolution_m) if cells is None else cells, resolution_m),
        "robot": {name: getattr(robot, name) for name in Robot.__dataclass_fields__},
        "start_m": list(world.start_m),
        "goal_m": list(world.goal_m),
        "objects": [
            {
                "id": body.id,
                "outline_m": body.outline_m.tolist(),
                "force_N": body.force_N,
                "fixed": body.fixed,
                "push": str(world.notes.get("push", "direct")),
            }
            for body in world.bodies
        ],
    }


class Planner:
    """The planner behind a hard limit of time and memory; a process that was ended is started anew."""

    def __init__(self, *, memory_bytes: int = 4 << 30, budget_s: float = 30.0) -> None:
        self.memory_bytes, self.budget_s = memory_bytes, budget_s
        self._process: subprocess.Popen[bytes] | None = None

    def ask(self, request: dict[str, Any], budget_s: float | None = None) -> dict[str, Any]:
        """Answer of the child: ``status`` is answered, time, memory, died or the name of an error."""
        if self._process is None:
            self._start()
        process = self._process
        assert process is not None
        budget_s = self.budget_s if budget_s is None else budget_s
        began_s = time.monotonic()
        reply = self._exchange({**request, "budget_s": budget_s}, WALL_OF_CPU * budget_s + 1.0)
        if reply is None:
            late = process.poll() in (None, -signal.SIGPROF)
            self.close()
            return {"status": "time" if late else "died", "wall_s": round(time.monotonic() - began_s, 3)}
        return reply

    def close(self) -> None:
        """End the child."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def _start(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks._plan_child", str(self.memory_bytes + OVERHEAD_BYTES)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **ONE_THREAD},
        )
        if self._exchange({"do": "warm", "budget_s": 600.0}, 1200.0) is None:
            raise RuntimeError("the planning process did not start")

    def _exchange(self, request: dict[str, Any], budget_s: float) -> dict[str, Any] | None:
        process = self._process
        assert process is not None
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write(json.dumps(request).encode() + b"\n")
            process.stdin.flush()
        except BrokenPipeError:
            return None
        deadline_s = time.monotonic() + budget_s
        data = b""
        while not data.endswith(b"\n"):
            left_s = deadline_s - time.monotonic()
            if left_s <= 0 or not select.select([process.stdout], [], [], left_s)[0]:
                return None
            part = os.read(process.stdout.fileno(), 1 << 20)
            if not part:
                process.wait()
                return None
            data += part
        answer: dict[str, Any] = json.loads(data)
        return answer


def _map(data: dict[str, Any]) -> Any:
    from visuohaptic.io.maps import OccupancyMap

    flat = np.frombuffer(zlib.decompress(base64.b64decode(data["cells"])), np.int8)
    return OccupancyMap(flat.reshape(data["shape"]).copy(), data["resolution_m"])


def problem_of(data: dict[str, Any]) -> Any:
    """The library's problem of plain data."""
    from visuohaptic.core import Estimate, HapticTag
    from visuohaptic.navigation.problem import MovableObject, PlanningProblem, PushMode, robot_from_data

    objects = tuple(
        MovableObject(
            entry["id"],
            np.array(entry["outline_m"]),
            HapticTag(
                static_friction_N=Estimate(entry["force_N"], 0.0),
                dynamic_friction_N=Estimate(entry["force_N"], 0.0),
                fixed=bool(entry["fixed"]),
                falls=False,
                explored=1,
            ),
            push=PushMode(entry["push"]),
            pose_sigma=(0.0, 0.0),  # outlines are exact
        )
        for entry in data["objects"]
    )
    ends = (np.array(data["start_m"]), np.array(data["goal_m"]))
    return PlanningProblem(_map(data["map"]), robot_from_data(data["robot"]), *ends, objects)


def _timed(call: Any) -> tuple[Any, dict[str, float]]:
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    result = call()
    return result, {
        "cpu_s": round(time.process_time() - cpu_s, 5),
        "wall_s": round(time.perf_counter() - wall_s, 5),
        "peak_MB": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1),
    }


def _plan(request: dict[str, Any]) -> dict[str, Any]:
    from visuohaptic.navigation.planning import make_plan
    from visuohaptic.navigation.planning.search import SearchLimits
    from visuohaptic.navigation.problem import PushCosts

    # The problem is rebuilt for every call, so that nothing cached from the last one speeds up the plan.
    problem = problem_of(request["problem"])
    if "limit_s" in request:
        limits = SearchLimits(request["limit_s"])
        plan, spent = _timed(lambda: make_plan(problem, limits=limits))
        return {**spent, "plan": plan.to_json()}
    costs, told_s = PushCosts(on_route_s=request.get("on_route_s", 0.0)), []
    limits, begin_s = SearchLimits(found=lambda _: told_s.append(time.process_time())), time.process_time()
    plan, spent = _timed(lambda: make_plan(problem, costs, limits))
    spent["first_s"] = round(told_s[0] - begin_s, 5) if told_s else spent["cpu_s"]
    times = [spent["cpu_s"]]
    for _ in range(request.get("repeats", 1) - 1 if spent["cpu_s"] < 1.0 else 0):
        problem = problem_of(request["problem"])
        times.append(_timed(lambda problem=problem: make_plan(problem))[1]["cpu_s"])
    return {**spent, "cpu_s": float(np.median(times)), "plan": plan.to_json()}


def _compare(request: dict[str, Any]) -> dict[str, Any]:
    from visuohaptic.navigation.planning import alternatives, make_plan

    problem = problem_of(request["problem"])
    cheapest = make_plan(problem)
    others, spent = _timed(lambda: alternatives(problem))
    return {
        **spent,
        "make_plan_s": cheapest.cost_s if cheapest.reachable else None,
        "alternatives_s": {
            name: plan.cost_s if plan.reachable else None for name, plan in sorted(others.items())
        },
    }


def _scene(request: dict[str, Any]) -> dict[str, Any]:
    """One robot and goal of an imported scene."""
    from benchmarks.peers.scenes import load_namosim, load_svg_mppi
    from visuohaptic.navigation.planning import make_plan

    load = load_svg_mppi if request["kind"] == "svg_mppi" else load_namosim
    scene = load(request["path"])
    if request.get("index") is None:
        return {"problems": len(scene.problems)}
    problem = scene.problems[request["index"]]
    plan, spent = _timed(lambda: make_plan(problem))
    return {
        **spent,
        "plan": plan.to_json(),
        "objects": len(problem.objects),
        "shape": list(problem.map.shape),
    }


def _route(request: dict[str, Any]) -> dict[str, Any]:
    """Chords of the exported route graph [m]: x, y, x, y; and those that the objects add to it."""
    from visuohaptic.navigation.files import save_joint_route_graph, save_route_graph
    from visuohaptic.navigation.graph import assign_regions, build_graph
    from visuohaptic.navigation.grid import SpeedLimits, grid_layers
    from visuohaptic.navigation.planning import extend_graph
    from visuohaptic.navigation.problem import push_node

    problem = problem_of(request["problem"])
    layers = grid_layers(problem.map, SpeedLimits(problem.robot.radius_m))
    graph = build_graph(layers)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "route.geojson"
        _, spent = _timed(lambda: save_route_graph(path, graph, layers))
        chords = _chords(path)
        joined: list[list[float]] = []
        if problem.objects:
            nodes = [push_node(obj, problem.robot) for obj in problem.objects]
            joint = extend_graph(graph, assign_regions(layers, graph), problem.robot, nodes)
            save_joint_route_graph(path, joint)
            without = {tuple(chord) for chord in chords}
            joined = [chord for chord in _chords(path) if tuple(chord) not in without]
    return {**spent, "chords": chords, "joined": joined}


def _chords(path: Path) -> list[list[float]]:
    """Straight lines between the places of a route graph [m]."""
    features = json.loads(path.read_text())["features"]
    places = [feature for feature in features if feature["geometry"]["type"] == "Point"]
    at = {place["properties"]["id"]: place["geometry"]["coordinates"] for place in places}
    edges = [f["properties"] for f in features if f["geometry"]["type"] == "MultiLineString"]
    return [[*at[edge["startid"]], *at[edge["endid"]]] for edge in edges]


def _drives(request: dict[str, Any]) -> dict[str, Any]:
    from ._plan_drives import measured

    return measured(request)


def _warm(request: dict[str, Any]) -> dict[str, Any]:
    """Compile, or load what was compiled, before anything is timed."""
    from tests.worlds.floor_scenes import doors_in_series

    return _plan({"problem": described(doors_in_series(0, 1), 0.1)})


def main() -> None:
    """Answer requests until there are no more."""
    from visuohaptic.navigation.planning.search import push_states

    # The planner's budget includes wall time, which is meaningless on a busy machine.
    push_states.WALL_PER_CPU = WALL_OF_CPU
    limit = int(sys.argv[1])
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    calls = {
        "warm": _warm,
        "plan": _plan,
        "compare": _compare,
        "scene": _scene,
        "route": _route,
        "drives": _drives,
    }
    for line in sys.stdin:
        request = json.loads(line)
        # The default action of the signal ends the process, whatever code it is in.
        signal.setitimer(signal.ITIMER_PROF, request["budget_s"])
        try:
            answer = {"status": "answered", **calls[request["do"]](request)}
        except MemoryError:
            answer = {"status": "memory"}
        except ValueError as error:  # an error of the library
            answer = {"status": type(error).__name__, "message": str(error)[:300]}
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
