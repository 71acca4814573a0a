"""``visuohaptic grasp``: plan grasps on deformable containers.

reads   a YAML description, the name of a built-in class (bottle, cup, cup-rim, elliptic, smoothie,
        cien, isana, cleaner, palmo), a mesh (STL, PLY, OBJ, GLB, DAE; mid-surface of the wall or both of its sides, z is
        its height axis unless --up is given), or a map that `stiffness` wrote (.npz); with --scene, what is around it
writes  a plot of the scores and the grasps: PNG, PDF or SVG

A grasp is two fingers that press towards each other. Without --force, each grasp gets the force that lifting the
container needs there. Lengths are metres, forces newtons of one finger.

example: visuohaptic grasp cup-rim --force 20 --plot grasps.png
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from .... import core, deformation, grasping
from ....core.files.plain_json import picked
from ._container import add_container_arguments, read_container

#: Options of wall, shape and contents, which change nothing about a map.
_OF_OBJECTS = (
    "--material --thickness --thickness-spread --youngs-modulus --poisson --open-top --base-stiffness --variant --seed "
    "--around --unit --up --remesh --state --fill"
)


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add_container_arguments(add, also=", or map.npz")
    add("--force", float, "force of each finger (default: as required by the weight)", metavar="N")
    add("--state", "open", "state of the container (open)", choices=("open", "closed"))
    add("--fill", 0.0, "fill level of liquid, 0..1")
    add("--plot", Path, "plot to write: .png, .pdf or .svg")
    add("--count", 5, "maximum number of grasps (5)")
    add(
        "--confirm",
        str,
        "check grasps by nonlinear simulation, which takes seconds each (default: those that deform the wall by more than its thickness)",
        action=argparse.BooleanOptionalAction,
    )
    add("--scene", Path, "mesh, or points of a PLY file, of its surroundings [m]: obstacles of the gripper")
    add(
        "--place",
        float,
        "place of the middle of its foot in the scene [m], and rotation about z [degrees] (0 0 0 0)",
        metavar="X Y Z YAW",
    )
    add("--several", int, "also distribute the force over the M best grasps, acting at once", metavar="M")
    hand = add.group("hand")
    for flag, default, text in (
        ("friction", 0.6, "coefficient of the fingers"),
        ("opening", 0.11, "maximum opening [m]"),
        ("finger-radius", 0.01, "of the patch that touches [m]"),
        ("finger-length", 0.06, "from the palm to the patch [m]"),
        ("finger-thickness", 0.012, "along the closing direction [m]"),
        ("max-force", 60.0, "of one finger [N]"),
        ("position-sigma", 0.0, "standard deviation of its centre along the closing direction [m]"),
    ):
        hand(f"--{flag}", float, f"{text} ({default:g})", default=default)
    limits = add.group("limits")
    limits("--max-deformation", 0.005, "allowed, of one side [m] (0.005)")
    limits("--min-score", 0.5, "of a grasp (0.5)")
    limits("--mass", float, "instead of that of wall and liquid", metavar="KG")
    limits("--mass-sigma", 0.0, "standard deviation of --mass (0)", metavar="KG")


def run(args: Any) -> dict[str, Any]:
    """Plan and report; returns the mapping that ``--json`` prints."""
    if args.several is not None and not 2 <= args.several <= args.count:
        raise core.InputError("--several", f"found {args.several}, expected 2 to {args.count}, the --count")
    if args.mass is None:
        args.refuse("--mass-sigma", "found without --mass", "give the --mass it belongs to")
    if args.mass is not None and not 0 <= args.mass_sigma <= max(args.mass, 0):
        found = f"found {args.mass_sigma:g} kg, expected 0 to the --mass of {args.mass:g} kg"
        raise core.InputError("--mass-sigma", found)
    if args.scene is None:
        args.refuse("--place", "found without --scene", "give the --scene it refers to")
    begin = time.perf_counter()
    container = None
    if Path(args.object).suffix.lower() == ".npz":
        if args.confirm:
            raise core.InputError(args.object, "is a map: --confirm needs the object itself")
        args.refuse("--several", f"{args.object} is a map, expected the object itself")
        said = f"changes nothing: {args.object} is a map of one wall in one state"
        args.refuse(_OF_OBJECTS, said, "give the object itself, or compute its map with this option")
        surface = deformation.load_map(args.object)
        name = Path(args.object).stem
        task = _task(args, surface.vertices_m.mean(axis=0))
        scene_m = _scene(args, surface.vertices_m)
        plan = grasping.plan_map(surface, task, count=args.count, scene_m=scene_m)
    else:
        container = read_container(args)
        name = container.name
        _check_mass_known(args, container)
        task = _task(args, None)
        if args.mass is not None:
            task = _with_mass(args, task, container)
        scene_m = _scene(args, container.mesh.vertices_m)
        plan = grasping.plan_grasps(container, task, count=args.count, confirm=args.confirm, scene_m=scene_m)
    if args.plot:
        force = "the force needed" if args.force is None else f"{args.force:g} N"
        grasping.plot_plan(args.plot, [(f"{name}, {force}", plan)])
    result: dict[str, Any] = {
        "object": str(args.object),
        "name": name,
        "state": args.state,
        "fill": args.fill,
        "force_N": args.force,
        "mass_kg": None if plan.load is None else plan.load.mass_kg,
        "centre_m": None if plan.load is None else list(plan.load.centre_m),
        "feasible_share": float(plan.feasibility.feasible.mean()),
        "grasps": [grasp_json(grasp) for grasp in plan.grasps],
        "rejected": [grasp_json(grasp) for grasp in plan.rejected],
        "reason": plan.reason,
        "notes": [*(container.notes if container is not None else ()), *plan.notes],
        "plot": str(args.plot) if args.plot else None,
    }
    if args.several:
        result["several"] = _several(args, container, plan)
    result["seconds"] = time.perf_counter() - begin
    _report(args, result)
    return result


def _scene(args: Any, vertices_m: Any) -> Any:
    """Points of the surroundings in the frame of the object; None without a scene."""
    import numpy as np

    from ....io.meshes.mesh import load_mesh
    from ....io.meshes.ply import read_ply

    if args.scene is None:
        return None
    if args.scene.suffix.lower() == ".ply":
        found = read_ply(args.scene)
        points, faces = found.vertices_m, found.faces
    else:
        mesh = load_mesh(args.scene)
        points, faces = mesh.vertices * (mesh.unit_m or 1.0), mesh.faces
    *place, yaw = core.finite_array("--place", args.place or (0.0, 0.0, 0.0, 0.0), 4)
    cos, sin = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
    pose = np.eye(4)
    pose[:2, :2], pose[:3, 3] = ((cos, -sin), (sin, cos)), place
    extent = np.stack([vertices_m.min(axis=0), vertices_m.max(axis=0)])
    return grasping.scene_points(points, faces, pose, extent, str(args.scene))


def _task(args: Any, centre_m: Any) -> grasping.GraspTask:
    load = None
    if args.mass is not None and centre_m is not None:
        load = _load(args, (float(centre_m[0]), float(centre_m[1]), float(centre_m[2])))
    return grasping.GraspTask(
        force_N=args.force,
        closed=args.state == "closed",
        fill=args.fill,
        gripper=grasping.GripperModel(
            args.opening,
            args.finger_radius,
            args.max_force,
            args.friction,
            finger_length_m=args.finger_length,
            finger_thickness_m=args.finger_thickness,
            position_sigma_m=args.position_sigma,
        ),
        parameters=grasping.ScoreParameters(max_deformation_m=args.max_deformation),
        min_score=args.min_score,
        load=load,
    )


def _check_mass_known(args: Any, container: Any) -> None:
    """Reject a wall of unknown density before computing: a modulus alone does not determine it."""
    if args.mass is None and container.material.density_kg_per_m3 is None:
        raise core.InputError(
            args.object,
            f"its wall is of material {container.material.name!r}, whose density is unknown, and so is its mass",
            remedy="give --mass in kg, or name its --material",
        )


def _with_mass(args: Any, task: grasping.GraspTask, container: Any) -> grasping.GraspTask:
    from dataclasses import replace

    # The value of the density is arbitrary: only the position of the centre is used.
    centre = grasping.object_load(container, task.fill, wall_kg_per_m3=1000.0).centre_m
    return replace(task, load=_load(args, centre))


def _load(args: Any, centre_m: tuple[float, float, float]) -> grasping.Load:
    return grasping.Load(args.mass, centre_m, mass_spread=args.mass_sigma / args.mass if args.mass else 0.0)


def grasp_json(grasp: grasping.Grasp) -> dict[str, Any]:
    """A grasp as plain numbers.

    Parameters
    ----------
    grasp
        One grasp of a plan.
    """
    said, way = grasp.confirmation, grasp.approach
    return {
        **picked(grasp, "score rim parts steadiness success work_J"),
        "pose": None if way is None else way.T_object_gripper.tolist(),
        "open_width_m": None if way is None else way.open_width_m,
        "approach_elevation_rad": None if way is None else way.elevation_rad,
        **picked(
            grasp, "first_m second_m direction width_m force_N needed_N deformation_limit_N spill_limit_N"
        ),
        **picked(grasp, "deformation_m deformation_sigma_m"),
        "confirmed": said and picked(said, "holds reason deformation_m slant_rad pressed_out_m3"),
    }


def _several(args: Any, container: Any, plan: grasping.GraspPlan) -> dict[str, Any]:
    """Simultaneous best grasps with the force distributed over them, superposed by the coupling matrix."""
    import numpy as np

    # A rim grasp pinches the wall and does not squeeze the container.
    sides = [grasp for grasp in plan.grasps if not grasp.rim]
    if args.several > len(sides):
        raise core.InputError(
            "--several",
            f"found {args.several}, expected at most {len(sides)}, the number of grasps from the sides",
        )
    chosen = sides[: args.several]
    coupling = grasping.multi_contact(
        container, [grasp.vertex for grasp in chosen], closed=args.state == "closed", fill=args.fill
    )
    force = np.array([grasp.force_N for grasp in chosen]) / len(chosen)
    return {
        "force_N": force.tolist(),
        "deformation_m": coupling.deformation_m(force).tolist(),
        "compliance_m_per_N": coupling.compliance.tolist(),
    }


def _report(args: Any, result: dict[str, Any]) -> None:
    import numpy as np

    mass = "" if result["mass_kg"] is None else f", {1e3 * result['mass_kg']:.0f} g"
    args.report(
        f"{result['name']}, {result['state']}{mass}: {100 * result['feasible_share']:.0f} % of the surface can be grasped"
    )
    for rank, grasp in enumerate(result["grasps"], 1):
        x, y, z = (round(1e3 * value) for value in grasp["first_m"])
        line = (
            f"{rank}. score {grasp['score']:.2f} at ({x}, {y}, {z}) mm, "
            + (
                "by the rim, one finger inside: "
                if grasp["rim"]
                else f"{1e3 * grasp['width_m']:.0f} mm wide: "
            )
            + f"{grasp['force_N']:.1f} N, required {grasp['needed_N']:.1f} N, deformation {1e3 * grasp['deformation_m']:.2g} "
            + f"± {1e3 * grasp['deformation_sigma_m']:.1g} mm"
        )
        if grasp["pose"]:
            line += f", approach {np.degrees(grasp['approach_elevation_rad']):.0f} degrees above horizontal"
        if grasp["success"] is not None:
            line += f", success {100 * grasp['success']:.0f} %"
        if grasp["confirmed"]:
            line += f", {1e3 * grasp['confirmed']['deformation_m']:.2g} mm in the nonlinear simulation"
        args.report(line)
    for grasp in result["rejected"]:
        z = 1e3 * grasp["first_m"][2]
        args.report(
            f"rejected at {z:.0f} mm height (score {grasp['score']:.2f}): {grasp['confirmed']['reason']}"
        )
    if "several" in result:
        max_mm = 1e3 * max(result["several"]["deformation_m"])
        args.report(
            f"{len(result['several']['force_N'])} at once, force distributed: {max_mm:.1f} mm at most"
        )
    if result["reason"]:
        args.report(f"no grasp: {result['reason']}")
    for note in result["notes"]:
        args.report(f"note: {note}")
    if result["plot"]:
        args.report(f"written to {result['plot']}")
