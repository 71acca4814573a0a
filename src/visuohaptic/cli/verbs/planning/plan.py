"""``visuohaptic plan``: plan driving and pushing on a map with tagged objects.

reads
  MAP.yaml     a map_server map (YAML with PGM or PNG); the objects are occupied cells in it
  --objects    objects: [{id, footprint_m: [[x, y], ...], haptic_tag: {static_friction_N: 8.1, ...}}];
               a missing or null field was not observed; an object without haptic_tag is unknown
  --robot      {radius_m (or footprint: [[x, y], ...]), v_max_m_s, v_min_m_s, v_push_m_s, push_force_max_N, setup_time_s}
               (see `visuohaptic defaults robot`)
  --glass      regions.json of `visuohaptic reconstruct`, with poses in the map frame: each transparent part and pane is avoided
writes
  --plot       the map with objects, path and pushes

The result is one of: optimal; within N % of the optimum; no plan (proved); no plan found (not proved). Without a
plan the exit code is 3. cost_s is the sum of the times of all actions, by which plans are compared; expected_duration_s
adds turns on the spot, braking before corners and the way to each push, as the robot drives them. An object tagged as
fixed, or as likely to topple, is never pushed. contact_m is the contact point on the outline, goal_m where the object's
centre ends.

With --explore S, the result is a tour instead: which unknown objects to touch, and in which order, so that the expected
benefit (passages opened first, then time saved) within S seconds is greatest; it ends at --goal if one is given. Each
object that is left out has a reason; the exit code is 3 if nothing is worth exploring. --budget and --memory limit the
search of a plan, not of a tour.

example: visuohaptic plan office.yaml --objects objects.yaml --robot robot.yaml --start 0.8 0.8 --goal 3 1 --json
example: visuohaptic plan office.yaml --objects objects.yaml --robot robot.yaml --start 0.8 0.8 --explore 600
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .... import io
from ....core.errors import InputError
from ....navigation import planning, plots
from ....navigation.planning import search
from ..._console import NO_RESULT

if TYPE_CHECKING:
    from ....navigation.problem import Plan, PlanningProblem

_log = logging.getLogger(__name__)
#: Modules with kernels of the verb, the last needed first.
KERNELS = (
    "navigation.pushing._push_kernels",
    "navigation.planning.search._travel_kernels",
    "navigation.planning.search._push_search_kernels",
)
#: Budget of a proof of infeasibility, in budgets of a plan.
PROOF_BUDGETS = 10.0


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("map", Path, "occupancy map", metavar="MAP.yaml")
    add("--objects", Path, "objects.yaml; without it nothing is pushed")
    add("--glass", Path, "regions.json: transparent parts and panes to avoid, in the map frame")
    add("--robot", Path, "robot.yaml", required=True)
    add("--start", float, "start in the map frame [m]", required=True, metavar="X Y")
    add("--yaw", float, "heading at the start of a robot with a footprint [rad]; default: any", metavar="RAD")
    add("--goal", float, "goal in the map frame [m]; optional with --explore", metavar="X Y")
    add("--explore", float, "plan a tour that explores unknown objects within this time [s]", metavar="S")
    add(
        "--keep-routes",
        0.0,
        "cost of an object that ends on a route of the graph, as in a doorway [s]",
        metavar="S",
        low=0.0,
    )
    add("--plot", Path, "plot to write (PNG)")
    add("--compare", bool, "also plan with other objectives: most reliable, no pushing, most information")
    add("--budget", 2.0, "CPU time of the search [s] (default %(default)s)", metavar="S")
    add("--memory", 500.0, "memory of the search [MB]", metavar="MB")
    add(
        "--prove",
        bool,
        "search for the cheapest plan, or a proof that there is none, for ten times the budget",
    )


def _announce(plan: Plan) -> None:
    _log.info("first plan: %.1f s; better ones are searched", plan.cost_s)


def run(args: Any) -> dict[str, Any]:
    """Plan; returns the mapping that ``--json`` prints."""
    import numpy as np

    from ....navigation.problem import PlanningProblem, PushCosts
    from ....navigation.problem.objects_file import (
        glass_objects,
        load_areas,
        load_objects,
        load_passages,
        load_robot,
    )

    if args.goal is None and args.explore is None:
        raise InputError("--goal", "is missing", remedy="give a goal, or --explore with a time")
    if args.explore is not None:
        args.refuse("--compare --prove", "does not apply to --explore", "leave it out")
    robot = load_robot(args.robot)
    objects = load_objects(args.objects) if args.objects else ()
    if args.glass:
        from ....reconstruction.completion import load_glass_hulls

        objects += glass_objects(load_glass_hulls(args.glass))
    passages, areas = (load_passages(args.objects), load_areas(args.objects)) if args.objects else ((), ())
    start_m, goal_m = np.array(args.start), np.array(args.goal or args.start)
    if not robot.footprint_m:
        args.refuse("--yaw", "does not apply to a disc", "leave it out, or give the robot a footprint")
    map = io.OccupancyMap.load(args.map)
    problem = PlanningProblem(map, robot, start_m, goal_m, objects, passages, args.yaw, areas)
    if args.explore is not None:
        return _explore(args, problem)
    budget_s = args.budget * (PROOF_BUDGETS if args.prove else 1.0)
    gap = 0.0 if args.prove else search.SearchLimits().gap
    limits = search.SearchLimits(budget_s, gap, int(args.memory * 1e6), found=_announce)
    costs = PushCosts(on_route_s=args.keep_routes)
    plans = (
        planning.alternatives(problem, costs, limits)
        if args.compare
        else {"cheapest": planning.make_plan(problem, costs, limits)}
    )
    found = plans["cheapest"]
    args.exit_code = 0 if found.reachable else NO_RESULT
    result = _report(args, found, problem)
    if found.gap > limits.gap and not found.proved:
        args.report(f"  note: the search ended with its budget; --budget {2 * args.budget:g} searches longer")
    if args.compare:
        result["compare"] = {name: plan.to_json() for name, plan in plans.items() if name != "cheapest"}
        args.report()
        for name, plan in plans.items():
            args.report(f"{name:<18}{plan.summary}")
    if args.plot:
        plots.plot_path_plan(problem, found, args.plot)
        args.report(f"written to {args.plot}")
    return result


def _explore(args: Any, problem: PlanningProblem) -> dict[str, Any]:
    tour = planning.exploration_tour(problem, args.explore, to_goal=args.goal is not None)
    args.exit_code = 0 if tour.steps else NO_RESULT
    args.report(tour.summary)
    for step in tour.steps:
        gain = f"opens a passage with probability {step.opens:.2f}, saves {step.benefit_s:.1f} s (expected)"
        args.report(f"  explore {step.object}: {step.time_s:.1f} s, {gain}")
    for id, reason in tour.left_out.items():
        args.report(f"  not {id}: {reason}")
    for note in tour.notes:
        args.report(
            f"  note: {note}; at most {tour.bound[0]:.2f} passages or {tour.bound[1]:.1f} s are possible"
        )
    if args.plot:
        plots.plot_path_plan(problem, tour.plan, args.plot, title=tour.summary)
        args.report(f"written to {args.plot}")
    return tour.to_json()


def _report(args: Any, plan: Plan, problem: PlanningProblem) -> dict[str, Any]:
    """Print a plan; returns it with the expected duration of the drive."""
    from ....tasks.mobile.travel import expected_duration_s

    result = plan.to_json()
    args.report(plan.summary)
    if plan.reachable:
        result["expected_duration_s"] = round(expected_duration_s(plan, problem, problem.start_yaw_rad), 1)
        args.report(f"  driven by `travel`, it is expected to take {result['expected_duration_s']:.0f} s")
    for task in plan.tasks:
        what = f" {task.object}" if task.object else ""
        risk = f", failure probability {task.failure_probability:.2f}" if task.kind != "navigate" else ""
        where = f" to ({task.goal_m[0]:.2f}, {task.goal_m[1]:.2f})" if task.goal_m else ""
        args.report(f"  {task.kind}{what}{where}: {task.cost_s:.1f} s, {task.length_m:.2f} m{risk}")
    for note in plan.notes:
        args.report(f"  note: {note}")
    return result
