"""Plans executed in a simulation that is independent of the planner, and the campaigns that use it."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
from tests.worlds.floor_scenes import CENTRE_M, off_centre, six_boxes, small_room
from tests.worlds.maps import World
from tests.worlds.push_oracle import solve
from tests.worlds.push_physics import CONTACT_FRICTION, FloorPhysics, feet_of
from tests.worlds.real_floors import real_scene, room_scene

from ._plan_child import Planner, described
from ._plan_judge import Row, Rows, answer_of, asked, bounds_row, faults_row, quantile
from ._push_loop import NOISE_M
from .nav_doors import data_folder

__all__ = ["oracle", "oracle_table", "push_ends", "push_ends_table", "room", "room_keys", "rooms_table"]

#: After a push that ended farther off than this the plan is made anew [m], [rad].
OFF_M, OFF_RAD = 0.01, np.deg2rad(3.0)
MAX_PLANS = 10
#: CPU time of the search that decides whether a scene has a plan at all, where the planner found none [s].
SOLVER_S = 60.0
PERIOD_S = 0.02  #: of a controller
ARRIVED_M = 0.05
#: Quantiles of the squared length of a vector of three normal variables, by tenths.
CHI2_TENTHS = (0.584, 1.005, 1.424, 1.869, 2.366, 2.946, 3.665, 4.642, 6.251)


def execute(planner: Planner, world: World, cell_m: float) -> Row:
    """Plan, drive and push until the goal is reached or there is no plan; plan again after each surprise."""
    physics = FloorPhysics(world.walls, world.bodies, world.robot, world.start_m)
    plans: list[Row] = []
    while len(plans) < MAX_PLANS:
        here = physics.robot_m
        now = replace(world, bodies=physics.bodies, start_m=(float(here[0]), float(here[1])))
        reply = planner.ask({"do": "plan", "problem": described(now, cell_m)})
        tasks = reply.get("plan", {}).get("tasks", ())
        pushes = sum(task["kind"] == "push" for task in tasks)
        plans.append(
            {
                "answer": answer_of(reply),
                "cpu_s": reply.get("cpu_s"),
                "first_s": reply.get("first_s"),
                "pushes": pushes,
            }
        )
        if "message" in reply:
            plans[-1]["message"] = reply["message"]
        if plans[-1]["answer"] != "plan":
            break
        for task in tasks:
            if not _done(physics, world, task):
                break
        if np.hypot(*(physics.robot_m - world.goal_m)) < ARRIVED_M:
            break
    off_m = float(np.hypot(*(physics.robot_m - world.goal_m)))
    return {"reached": off_m < ARRIVED_M, "off_m": round(off_m, 3), "plans": plans}


def _done(physics: FloorPhysics, world: World, task: Row) -> bool:
    """Execute one task; whether the state afterwards is as planned."""
    path = np.array(task.get("path_m", ())).reshape(-1, 2)
    if len(path) < 2:
        return True
    if task["kind"] == "navigate":
        # The mean speed assumed by the plan.
        arrived = physics.drive(path, max(task["length_m"] / task["cost_s"], 0.05))
    elif task["kind"] == "push":
        arrived = physics.drive(path[:2], world.robot.v_push_m_s) and physics.drive(path[1:], 0.1)
    elif task["kind"] == "turn":
        physics.drive(path[:3], world.robot.v_push_m_s)
        physics.drive(np.stack([physics.robot_m, path[3]]), 0.1)
        return False  # where it ends is only known approximately: plan again
    else:
        return True
    if not arrived:
        # Back off from the obstacle, as far as space is free.
        here = physics.robot_m
        back = here - path[min(len(path) - 1, 1)]
        physics.drive(np.array([here, here + 0.05 * back / max(float(np.hypot(*back)), 1e-9)]), 0.05)
        return False
    if task["kind"] == "push":
        index = [body.id for body in physics.moving].index(task["object"])
        centre, turn = physics.pose(index)
        return bool(np.hypot(*(centre - np.array(task["goal_m"]))) < OFF_M and abs(turn) < OFF_RAD)
    return True


# -- rooms ---------------------------------------------------------------------------------------------------------


def room_keys(seeds: list[int]) -> list[str]:
    """Half of the scenes on generated floors, half on real ones; and six boxes on 8 x 5 m."""
    real = data_folder().exists()
    return ["boxes 0", *(f"{'real' if real and seed // 2 % 2 else 'rooms'} {seed}" for seed in seeds)]


def room(planner: Planner, key: str) -> Row:
    """One scene in physics."""
    kind, seed = key.split()
    if kind == "boxes":
        world = six_boxes(int(seed))
    else:
        world = real_scene(data_folder(), int(seed)) if kind == "real" else room_scene(int(seed))
    cell_m = float(world.notes.get("cell_m", 0.05))
    row = {"bodies": len(world.bodies), **execute(planner, world, cell_m)}
    if not row["reached"]:
        # Whether the scene is solvable: an independent search that accepts any plan; None: neither plan nor end in its time.
        found = solve(world, cell_m, step_m=0.1, max_expansions=300, weight=3.0, limit_s=SOLVER_S)
        row["solvable"] = True if np.isfinite(found.cost_s) else False if found.finished else None
    return row


def rooms_table(rows: Rows) -> list[Row]:
    """Fraction reached of the scenes that are solvable; time of the first plans."""
    solvable = [row for row in rows.values() if row["reached"] or row["solvable"]]
    first = [row["plans"][0] for row in solvable]
    planned = [plan for plan in first if plan["answer"] == "plan"]
    times = [1e3 * plan.get("first_s", plan["cpu_s"]) for plan in planned] + [np.inf] * (
        len(first) - len(planned)
    )
    answers = [1e3 * plan["cpu_s"] for plan in planned]
    soon = [t for t in times if t <= 2000]
    reached = sum(row["reached"] for row in solvable)
    others = [row["plans"][0] for row in rows.values() if not (row["reached"] or row["solvable"])]
    said = sum(plan["answer"] == "proved" and plan["cpu_s"] <= 2.0 for plan in others)
    unknown = sum(not row["reached"] and row["solvable"] is None for row in rows.values())
    kinds = sorted({row["plans"][-1]["answer"] for row in solvable if not row["reached"]})
    return [
        {
            "name": "rooms: reached in physics, of the solvable",
            "ours": 100.0 * reached / max(len(solvable), 1),
            "unit": "%",
            "floor": 95,
            "aim": 99,
            "note": f"{reached} of {len(solvable)}, {len(rows)} scenes; not: {', '.join(kinds)}",
        },
        {
            "name": "rooms: first plan within 2 s",
            "ours": 100.0 * len(soon) / max(len(solvable), 1),
            "unit": "%",
            "floor": 95,
            "aim": 100,
            "note": f"of the solvable; {said} of {len(others)} others proved in 2 s; of {unknown} the solver "
            f"had no answer in {SOLVER_S:g} s",
        },
        {"name": "rooms: first plan, median", "ours": quantile(times, 0.5), "unit": "ms", "aim": 100},
        {
            "name": "rooms: first plan, p99",
            "ours": quantile(times, 0.99),
            "unit": "ms",
            "aim": 1000,
            "note": f"better ones until {quantile(answers, 0.99):.0f} ms",
        },
    ]


# -- ends of pushes ------------------------------------------------------------------------------------------------


def push_ends(planner: Planner, key: str) -> Row:
    """The first push of a plan, executed from its approach pose."""
    world = off_centre(int(key))
    reply = planner.ask({"do": "plan", "problem": described(world, 0.05)})
    answer = answer_of(reply)
    tasks = reply.get("plan", {}).get("tasks", [])
    push = next((task for task in tasks if task["kind"] == "push"), None)
    if answer != "plan" or push is None:
        return {"answer": answer if push else "no push"}
    path = np.array(push["path_m"])
    physics = FloorPhysics(world.walls, world.bodies, world.robot, path[0])
    arrived = physics.drive(path[:2], world.robot.v_push_m_s)
    centre, turn = physics.pose(0)
    off = centre - np.array(push["goal_m"])
    row: Row = {
        "answer": answer,
        "arrived": arrived,
        "length_m": float(np.hypot(*push["displacement_m"])),
        "off_m": float(np.hypot(*off)),
        "turn_deg": abs(float(np.degrees(turn))),
        "turn_off_deg": abs(float(np.degrees(turn - push.get("turn_rad", 0.0)))),
        "unknown_deg": _unknown_turn_deg(world, path),
    }
    for name, seen in (("felt", False), ("steered", True)):
        executed, executed_rad = _steered(world, push, seen=seen)
        executed_off = executed - np.array(push["goal_m"])
        row[f"{name}_off_m"] = float(np.hypot(*executed_off))
        row[f"{name}_deg"] = abs(float(np.degrees(executed_rad)))
        row[f"{name}_off_deg"] = abs(float(np.degrees(executed_rad - push.get("turn_rad", 0.0))))
    physics.drive(path[1:], 0.1)
    here = physics.robot_m
    now = replace(world, bodies=physics.bodies, start_m=(float(here[0]), float(here[1])))
    onward = planner.ask({"do": "plan", "problem": described(now, 0.05)})
    planned, needed = (
        sum(task["kind"] == "push" for task in some)
        for some in (tasks, onward.get("plan", {}).get("tasks", ()))
    )
    row["again"] = needed > planned - 1 or answer_of(onward) != "plan"
    if (covariance := push.get("end_covariance")) is not None:
        matrix = np.array(covariance, dtype=float)
        for name, *error in (("squared", *off, turn), ("steered_squared", *executed_off, executed_rad)):
            from_declared = np.array(error) - [0.0, 0.0, push.get("turn_rad", 0.0)]
            row[name] = float(from_declared @ np.linalg.solve(matrix, from_declared))
    return row


def _steered(world: World, push: Row, *, seen: bool) -> tuple[np.ndarray, float]:
    """Centre [m] and turn [rad] of an object after a push as it is executed: with feedback of sight, or of touch alone."""
    from visuohaptic.navigation.pushing import PushModel, PushMonitor
    from visuohaptic.tasks.mobile import PushSettings, SteeredPush, contact_curvature
    from visuohaptic.tasks.mobile.travel.travel_pushes import ASIDE_SIGMAS

    at, robot = np.array(push["path_m"][0]), world.robot
    physics = FloorPhysics(world.walls, world.bodies, robot, at)
    heading = direction = float(np.arctan2(*push["displacement_m"][::-1]))
    body = world.bodies[0]
    across = np.array([-np.sin(direction), np.cos(direction), 0.0])
    aside_m = ASIDE_SIGMAS * float(np.sqrt(across @ np.array(push["end_covariance"]) @ across))
    curvature = contact_curvature(body.outline_m, push["contact_m"], robot.radius_m)
    model, place_m = PushModel.of_footprint(body.outline_m - body.centre_m), np.array([*body.centre_m, 0.0])
    run = SteeredPush(
        at.copy(), direction, float(np.hypot(*push["displacement_m"])), turn_rad=push.get("turn_rad", 0.0),
        object_m=place_m, lever_m=model.lever_m,
        settings=PushSettings(
            robot.radius_m, robot.v_push_m_s, max_force_N=robot.push_force_max_N, aside_m=aside_m,
            curvature_per_m=curvature,
        ),
    )  # fmt: skip
    monitor, rng = PushMonitor(model, place_m, robot.radius_m), np.random.default_rng(0)
    felt_at = np.array([*at, 0.0])
    for period in itertools.count():
        force_N, place = physics.touch
        centre, turn = physics.pose(0)
        pose = np.array([*physics.robot_m, heading])
        if place is not None and not seen:
            place = place + NOISE_M * rng.standard_normal(2)
        contact = None if place is None else (float(place[0]), float(place[1]))
        if seen:
            place_m, felt_at = np.array([*centre, turn]), pose
        elif monitor.update(pose, contact) and run.touched:
            place_m, felt_at = monitor.estimate().object_m, pose
        place_m, felt_at = place_m + np.array([*(pose - felt_at)[:2], 0.0]) * run.touched, pose
        speed, rate = run.command(period * PERIOD_S, pose, force_N, contact, place_m)
        if run.end is not None:
            return centre, turn
        heading += rate * PERIOD_S
        velocity = speed * np.array([np.cos(heading), np.sin(heading)])
        physics.follow(at, velocity, PERIOD_S, rate)
        at = at + PERIOD_S * velocity
    raise AssertionError


def _unknown_turn_deg(world: World, path_m: np.ndarray, samples: int = 40) -> float:
    """Median turn [deg] of a blind push, by the quasi-static model that knows all but where the mass is."""
    from visuohaptic.navigation.pushing import PushModel, line_path, load_of_feet, simulate_push

    body, feet = world.bodies[0], feet_of(world.bodies[0])
    outline = np.zeros((1, 2)) if body.round_m else body.outline_m - body.centre_m
    path, turns = line_path(path_m[0], path_m[1]), []
    for x, y in CENTRE_M * np.random.default_rng(0).standard_normal((samples, 2)):
        load = load_of_feet(feet, (float(x), float(y)))
        model = PushModel(outline, feet, load, CONTACT_FRICTION, body.round_m)
        trace = simulate_push(model, (*body.centre_m, 0.0), path, world.robot.radius_m)
        turns.append(abs(trace.object_m[-1, 2]))
    return float(np.degrees(np.median(turns)))


def push_ends_table(rows: Rows) -> list[Row]:
    """Errors of the final positions, and coverage of the declared ellipse."""
    done = [row for row in rows.values() if "off_m" in row]
    long = [row for row in done if row["length_m"] >= 0.4]
    straight = [row for row in done if row["turn_deg"] == row["turn_off_deg"] and "unknown_deg" in row]
    squares = np.array([row["squared"] for row in done if "squared" in row])
    tenths = np.bincount(np.searchsorted(CHI2_TENTHS, squares), minlength=10)
    note = f"{len(done)} of {len(rows)} scenes with a push, median length {quantile((r['length_m'] for r in done), 0.5) or 0:.2f} m"
    inside = sum(row["steered_squared"] < CHI2_TENTHS[-1] for row in done if "steered_squared" in row)

    def median(name: str, of: str, rows: list[Row], **more: Any) -> Row:
        scale, unit = (100.0, "cm") if of.endswith("_m") else (1.0, "deg")
        found = quantile((row[of] for row in rows), 0.5)
        return {"name": name, "ours": None if found is None else scale * found, "unit": unit, **more}

    def p90_cm(of: str) -> str:
        return f"p90 {100 * (quantile((row[of] for row in done), 0.9) or np.nan):.1f}"

    blind = f"{p90_cm('off_m')}; of {len(long)} of 0.4 m or more " + (
        f"{100 * (quantile((row['off_m'] for row in long), 0.5) or np.nan):.1f}"
    )
    return [
        median("executed push, steered by sight as travel does: end, median", "steered_off_m", done, floor=2, aim=1,
               note=f"{p90_cm('steered_off_m')}; {note}"),
        median("executed push: turn, median", "steered_deg", done, floor=3, aim=1.5,
               note=_turns(done, "steered_deg", "steered_off_deg")),
        {"name": "executed push inside the ellipse declared for a blind one", "unit": "%",
         "ours": 100.0 * inside / max(len(squares), 1)},
        median("push without camera, steered by touch: end, median", "felt_off_m", done, floor=2, aim=1,
               note=p90_cm("felt_off_m")),
        median("push without camera, steered by touch: turn, median", "felt_deg", done, floor=3, aim=1.5,
               note=_turns(done, "felt_deg", "felt_off_deg")),
        median("blind push, which is what a plan declares: end, median", "off_m", done, floor=2, aim=1, note=blind),
        median("blind push: turn, median", "turn_deg", done, floor=3, aim=1.5,
               note=_turns(done, "turn_deg", "turn_off_deg")),
        median("the same off the declared rotation", "turn_off_deg", done),
        median("blind push, not oblique: turn, median", "turn_deg", straight, note=f"{len(straight)} pushes"),
        median("the same if all but the place of the mass were known", "unknown_deg", straight),
        {"name": "blind push inside the declared 90 % ellipse", "unit": "%",
         "ours": 100.0 * float(np.mean(squares < CHI2_TENTHS[-1])) if len(squares) else None,
         "note": f"85 to 95 %; in each tenth {' '.join(map(str, tenths))}"},
        {"name": "blind push after which more pushes are needed than planned", "unit": "%",
         "ours": 100.0 * sum(row["again"] for row in done) / max(len(done), 1)},
        {"name": "blind push: the robot was stopped", "unit": "", "floor": 0,
         "ours": sum(not row["arrived"] for row in done) if done else None},
    ]  # fmt: skip


def _turns(rows: list[Row], turn: str, off: str) -> str:
    """Quantile of the turns, and median and quantile of their differences from the rotations that the plans declare."""
    values = [
        quantile((row[name] for row in rows), part) for name, part in ((turn, 0.9), (off, 0.5), (off, 0.9))
    ]
    return "p90 {:.1f}; off the declared rotation: {:.1f}, p90 {:.1f}".format(*(v or np.nan for v in values))


# -- oracle --------------------------------------------------------------------------------------------------------


def oracle(planner: Planner, key: str) -> Row:
    """A plan and the optimum, both costed on exact distances."""
    world, cell_m = small_room(int(key)), 0.05
    best = solve(world, cell_m, max_expansions=400)
    known = {
        "oracle_s": best.cost_s if np.isfinite(best.cost_s) else None,
        "finished": best.finished,
        "oracle_pushes": len(best.pushes),
    }
    return {**known, **asked(planner, world, cell_m)}


def oracle_table(rows: Rows) -> list[Row]:
    """Ratio of the costs where the oracle terminated."""
    ended = [row for row in rows.values() if row["finished"]]
    both = [row for row in ended if row["oracle_s"] and row["answer"] == "plan"]
    ratios = [row["true_cost_s"] / row["oracle_s"] for row in both]
    missed = [row for row in ended if row["oracle_s"] and row["answer"] != "plan"]
    pushed = [row["true_cost_s"] / row["oracle_s"] for row in both if row["oracle_pushes"]]
    declared = [
        abs(row["cost_s"] / row["true_cost_s"] - 1) for row in rows.values() if row["answer"] == "plan"
    ]
    return [
        {
            "name": "cost / oracle, median",
            "ours": quantile(ratios, 0.5),
            "unit": "",
            "floor": 1.02,
            "aim": 1.005,
            "note": f"{len(both)} scenes, oracle ended in {len(ended)} of {len(rows)}",
        },
        {
            "name": "cost / oracle, median of those with pushes",
            "ours": quantile(pushed, 0.5),
            "unit": "",
            "note": f"{len(pushed)} scenes",
        },
        {
            "name": "cost / oracle, worst",
            "ours": max(ratios, default=None),
            "unit": "",
            "floor": 1.10,
            "aim": 1.05,
            "note": f"best {min(ratios, default=np.nan):.3f}",
        },
        {
            "name": "oracle has a plan, planner has none",
            "ours": len(missed),
            "unit": "",
            "floor": 0,
            "note": ", ".join(sorted({row["answer"] for row in missed})),
        },
        {
            "name": "planner has a plan, oracle has none",
            "ours": sum(row["answer"] == "plan" and not row["oracle_s"] for row in ended),
            "unit": "",
            "note": "the oracle's pushes are straight and meet a face at a right angle",
        },
        {
            "name": "declared cost against the exact one, worst deviation",
            "ours": 100 * max(declared, default=0.0),
            "unit": "%",
            "floor": 1.0,
        },
        bounds_row("oracle", [(row, min(row["oracle_s"], row["true_cost_s"])) for row in both]),
        faults_row("oracle", list(rows.values())),
    ]
