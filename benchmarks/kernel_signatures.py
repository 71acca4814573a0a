"""The signatures of all kernels that users need, determined by a small run of each part.

``python -m benchmarks.kernel_signatures`` runs the parts below and writes the list that ``visuohaptic warmup``
compiles, ``src/visuohaptic/core/kernel_signatures.txt``. Run it when a kernel was added, moved or takes other
arguments; a test fails until then. A new kernel needs a call below, unless an existing part reaches it.
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
from dataclasses import replace

import numpy as np

import visuohaptic
from visuohaptic.cli._compilation import SIGNATURES
from visuohaptic.core import KERNELS


def run_objects() -> None:
    """One search of two vectors, through the public entry point."""
    from visuohaptic.database import FeatureIndex

    FeatureIndex(["a", "b"], np.eye(2)).nearest(np.zeros(2))


def run_tracking() -> None:
    """Track a straight edge over a few frames: first search, warm start, and the sub-pixel fit."""
    from visuohaptic.tracking.contours import ConstraintLines, ContourTracker

    image = np.full((80, 160), 40, np.uint8)
    image[41:] = 160
    column = np.arange(20.0, 141.0, 8.0)
    count = len(column)
    lines = ConstraintLines(
        origin_px=np.column_stack([column, np.full(count, 60.0)]),
        direction_px=np.tile([0.0, -1.0], (count, 1)),
        start_px=np.full(count, 0.0),
        stop_px=np.full(count, 40.0),
        half_width_px=3.5,
    )
    tracker = ContourTracker()
    for _ in range(3):
        tracker.track(image, lines)


def run_planar() -> None:
    """Align a small template, which compiles the kernels of the planar tracker."""
    from visuohaptic.core.camera import Camera, Pose
    from visuohaptic.tracking.pose import estimate_plane_poses
    from visuohaptic.tracking.templates import EsmTemplate, align

    y, x = np.mgrid[:64, :64]
    image = (128 + 60 * np.sin(x / 5.0) * np.cos(y / 7.0)).astype(np.uint8)
    template = EsmTemplate.from_image(image[8:56, 8:56].copy())
    align(template, image, np.array([[1, 0, 8.5], [0, 1, 7.5], [0, 0, 1.0]]))
    camera = Camera.simple(64, 64, 100.0)
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    pose = Pose(np.eye(3), np.array([0.0, 0.0, 5.0]))
    estimate_plane_poses(camera, square, camera.project(pose.apply(square)), np.eye(8), starts=(pose,))


def run_sensing() -> None:
    """Fit all primitives to the impression of a cylinder."""
    from visuohaptic.sensing.push import fit_primitive

    radius_m, depth_m = 0.06, 0.006
    s_m = np.linspace(-0.06, 0.06, 41)
    delta_m = np.maximum(depth_m - radius_m + np.sqrt(np.maximum(radius_m**2 - s_m**2, 0.0)), 1e-5)
    points_m = np.column_stack([0.04 - delta_m, s_m])
    fit_primitive(points_m, np.full(len(s_m), 1e-5), delta_m=delta_m)


def run_object() -> None:
    """Fit the motion of a square that stands still before a camera."""
    from visuohaptic.core.camera import Camera
    from visuohaptic.sensing.scene._object_kernels import fit_motion
    from visuohaptic.tracking.pose import lens_numbers

    camera = Camera.simple(64, 64, 100.0)
    body = np.array([[-1.0, -1, 5], [1, -1, 5], [1, 1, 5], [-1, 1, 5]])
    fit_motion(
        body, camera.project(body), np.ones(4), np.zeros(3), np.eye(3), np.zeros(3), lens_numbers(camera), 4.0, 4,
        np.ones(6, dtype=bool), np.eye(3), np.zeros(3), np.zeros(4), np.zeros((6, 6)),
    )  # fmt: skip


def run_beam() -> None:
    """Bend a rod."""
    from visuohaptic.sensing.beam import Beam, rod_from_base

    rod_from_base(Beam(), np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.1]), np.array([0.5, 1.0]))


def run_graph() -> None:
    """Build a small map and query it."""
    from visuohaptic.io.maps import OccupancyMap
    from visuohaptic.navigation.files import route_pieces
    from visuohaptic.navigation.graph import assign_regions, build_graph
    from visuohaptic.navigation.grid import SpeedLimits, grid_layers

    cells = np.zeros((60, 60), np.int8)
    cells[20:30, 20:30] = 100
    layers = grid_layers(OccupancyMap(cells, 0.1), SpeedLimits(0.2))
    graph = build_graph(layers, spacing_m=1.0)
    assign_regions(layers, graph)
    route_pieces(graph, layers)


def run_mapper() -> None:
    """Map a small round room from three scans."""
    from visuohaptic.core import LaserScan
    from visuohaptic.navigation.mapping import OccupancyMapper

    mapper = OccupancyMapper()
    for number in range(4):
        scan = LaserScan(0.1 * number, np.full(120, 1.5), -np.pi, np.pi / 60)
        mapper.add(scan, (0.2 * number, 0.0, 0.0))


def run_pushing() -> None:
    """Push a box with a round platform."""
    from visuohaptic.navigation.pushing import PushModel, line_path, sampled_pushes, simulate_push

    model = PushModel.patch(np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]))
    push = model, (0.4, 0.0, 0.0), line_path(np.zeros(2), np.array([0.2, 0.0])), 0.17
    simulate_push(*push)
    sampled_pushes(*push, np.random.default_rng(0), samples=1)


def run_planning() -> None:
    """Plan past a box that stands obliquely in a door, with central and off-centre pushes, a joint graph and its export."""
    from visuohaptic.navigation.files import task_pieces
    from visuohaptic.navigation.graph import assign_regions, build_graph
    from visuohaptic.navigation.grid import SpeedLimits, grid_layers
    from visuohaptic.navigation.planning import extend_graph, make_plan, plan_off_centre_pushes
    from visuohaptic.navigation.problem import (
        MovableObject,
        PlanningProblem,
        PushMode,
        RobotModel,
        push_node,
    )
    from visuohaptic.rigs import ROBOT, STOOL, rooms, with_objects

    walls = rooms(4.0, 3.0, [(1.9, 0.0, 2.0, 1.0), (1.9, 1.9, 2.0, 3.0)])
    corners_m = np.array([[1.88, 1.12], [2.25, 1.59], [2.02, 1.78], [1.65, 1.31]])
    item = MovableObject("box", corners_m, STOOL)
    map = with_objects(walls, [item])
    problem = PlanningProblem(map, ROBOT, np.array([0.7, 1.4]), np.array([3.4, 1.4]), (item,))
    make_plan(problem)
    plan_off_centre_pushes(problem, make_plan)
    edge_m = 1.1 * ROBOT.radius_m * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    make_plan(replace(problem, robot=RobotModel.of_footprint(edge_m), start_yaw_rad=0.0))
    make_plan(replace(problem, objects=(replace(item, push=PushMode.SIDEWARD),)))
    layers = grid_layers(map, SpeedLimits(ROBOT.radius_m))
    graph = build_graph(layers)
    joint = extend_graph(graph, assign_regions(layers, graph), ROBOT, [push_node(item, ROBOT)])
    task_pieces(joint, joint.visual.nodes + len(joint.added))


def run_reconstruction() -> None:
    """A few small views of a plane through both detectors and the fusion, and a small spline."""
    from visuohaptic.core.camera import Camera
    from visuohaptic.io.depth import DepthFrame
    from visuohaptic.reconstruction import reconstruct
    from visuohaptic.reconstruction._hull_kernels import hull_distance, mask_through, seen_fraction
    from visuohaptic.reconstruction.fusion import SENSOR_NOISE, SpaceGrid
    from visuohaptic.reconstruction.surfaces import RbfSurface, isosurface
    from visuohaptic.reconstruction.transparency.outline_fit import OutlineView, fit_bodies
    from visuohaptic.reproduce.worlds import PublishedDetector

    camera = Camera.simple(80, 60, 70.0)
    frames = []
    for index in range(30):
        pose = camera.pose_of_view((0.02 * index - 0.3, -0.8, 0.6), (0.02 * index - 0.3, 0.0, 0.0))
        rays = camera.rays(np.stack(np.meshgrid(np.arange(80.0), np.arange(60.0)), axis=-1))
        down = rays @ pose.rotation[2]
        depth_m = np.where(down < -0.05, -pose.translation_m[2] / np.minimum(down, -0.05), np.nan)
        frames.append(DepthFrame(index / 30, depth_m.astype(np.float32), None, pose, camera, index))
    grid = SpaceGrid(np.array([-0.4, -0.4, -0.1]), (16, 16, 8), 0.05)
    reconstruct(frames, grid=grid)
    detector = PublishedDetector(grid)
    for frame in frames:
        detector.add(frame)
    depth_m = frames[0].depth_m
    told = np.zeros(depth_m.shape, np.uint8), [np.zeros_like(depth_m)], depth_m
    outline = OutlineView.of_view(frames[0], *told, next(iter(SENSOR_NOISE.values())), 1.0)
    fit_bodies([outline], np.array([[-0.1, -0.1, 0.0], [0.1, 0.1, 0.2]]), np.ones(2))
    corners_m = np.array([[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)])
    surface = RbfSurface(corners_m, np.zeros(8))
    surface(corners_m)
    surface.on_grid(corners_m)
    isosurface(surface, SpaceGrid(np.zeros(3), (8, 8, 8), 0.01))
    rows = np.array([0, 59])
    planes = np.array([[0.0, 0.0, -1.0, 0.5], [0.0, 0.0, 1.0, -0.6]])
    numbers = (camera.matrix[0, 0], camera.matrix[1, 1], camera.matrix[0, 2], camera.matrix[1, 2])
    mask_through(frames[0].depth_m.copy(), planes, rows, rows, *numbers, 0.01)
    ways = np.eye(3)
    seen_fraction(np.zeros((2, 2, 2), dtype=bool), np.ones((1, 3)), np.eye(3)[:1].copy(), ways, np.empty(1))
    hull_distance(corners_m, np.ascontiguousarray(planes.T), np.empty(8))


def run_deformation() -> None:
    """A map, a nonlinear pinch with and without contents, a solid of revolution."""
    from visuohaptic.deformation.nonlinear import follow_displacement, pinch_curve
    from visuohaptic.deformation.shapes import tube_mesh
    from visuohaptic.deformation.shells import (
        CorotationalShell,
        IsotropicMaterial,
        RevolutionShell,
        ShellModel,
        dual_tip_map,
        opposing_points,
        pinch_stiffness,
    )

    from ._shell_problems import mitc4_tube_stiffness

    plastic = IsotropicMaterial(2.5e9, 0.38)
    mesh = tube_mesh(0.03, 0.08, 0.0005, around=12, along=8)
    model = ShellModel(mesh, plastic, range(12))
    dual_tip_map(model)
    tips = opposing_points(mesh, np.array([60]))
    model.factor().coupling(np.eye(6 * model.nodes, 2))
    model.solve(np.zeros((model.nodes, 6)))
    shell = CorotationalShell(model)
    shell.energy(shell.rest)
    pinch_curve(shell, tips, 0, [1e-4])
    gas = CorotationalShell(model, pressure=lambda volume: (0.0, -1e5 / volume))
    load = np.zeros((model.nodes, 6))
    load[60, 0] = -1.0
    follow_displacement(gas, load, [1e-4])
    height = np.linspace(0, 0.08, 5)
    pinch_stiffness(RevolutionShell(np.full(5, 0.03), height, 0.0005), plastic, harmonics=8)
    mitc4_tube_stiffness(0.03, 0.08, 0.0005, plastic, around=8, along=4)


def run_simulation() -> None:
    """Press a box into a short strip and render a small image of it beside a round leg, grey and in colour."""
    from visuohaptic.core.camera import Camera
    from visuohaptic.simulation.foam import FoamStrip, FoamStripGeometry, Outline
    from visuohaptic.simulation.rendering import CameraEffects, FoamScene, Look, SceneObject, SceneRenderer

    strip = FoamStrip(FoamStripGeometry(length_m=0.1, spacing_m=0.002))
    box = Outline.box((0.05, 0.0), (0.1, 0.04), 0.0, 0.0005)
    for depth_m in (0.0, 0.001):
        state = strip.press([box.moved(0.02 - depth_m, 0.0)], 0.01)
    back_m = np.column_stack([np.zeros(len(state.s_m)), state.s_m])
    corners_m = np.array([[0.02, -0.02], [0.1, -0.02], [0.1, 0.02], [0.02, 0.02]])
    angle = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)
    leg_m = 0.01 * np.column_stack([np.cos(angle), np.sin(angle)]) + [0.04, 0.04]
    objects = (SceneObject(corners_m, texture=4.0), SceneObject(leg_m))
    scene = FoamScene(0.0, back_m, state.front_m, objects)
    camera = Camera.simple(160, 90, 180.0)
    pose = camera.pose_of_view((-0.1, 0.0, 0.28), (0.02, 0.0, 0.0)).inverse()
    for colour in (False, True):
        renderer = SceneRenderer(camera, pose, Look(colour=colour), CameraEffects(noise_sigma=2.0))
        renderer.render(scene, rng=np.random.default_rng(0))


def run_containers() -> None:
    """Find the wall of a tube, simplify it, and check it for self-contact."""
    from visuohaptic.deformation.nonlinear import SelfContactGuard
    from visuohaptic.deformation.shapes import ContainerDescription, mesh_container
    from visuohaptic.deformation.shapes.resample import find_wall
    from visuohaptic.io.meshes import collapse_edges

    wall = {"base": {"radius": "35 mm"}, "sections": [{"height": "150 mm"}], "wall": "0.5 mm"}
    tube = mesh_container(ContainerDescription.model_validate(wall), around=24)
    find_wall(tube.mesh.vertices_m, tube.mesh.faces, "tube")
    collapse_edges(tube.mesh.vertices_m, tube.mesh.faces, 0.02, 1e-4)
    guard = SelfContactGuard(tube)
    points_m = tube.mesh.vertices_m.copy()
    points_m[:, 0] *= 1e-3
    guard.vertex(tube.mesh.vertices_m)
    guard._facing(points_m, *guard._meetings(points_m))


def run_recognition() -> None:
    """Grow and prune a small tree."""
    from visuohaptic.recognition.trees import grown, pruned, pruning_alphas

    rng = np.random.default_rng(0)
    x, number = rng.normal(size=(12, 64)), np.arange(12) % 3
    tree = grown(x, number, np.ones(12), ("a", "b", "c"), "norm", 0.0)
    pruned(tree, float(pruning_alphas(tree)[-1]))


def run_worlds() -> None:
    """A laser scan of a small room, and a small depth image of a glass."""
    from visuohaptic.io.maps import OccupancyMap
    from visuohaptic.simulation.mobile import SimulatedLaser
    from visuohaptic.simulation.tabletop import DepthCamera, glass_scene

    cells = np.zeros((40, 40), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    SimulatedLaser(OccupancyMap(cells, 0.1), None, np.random.default_rng(0)).scan((2.0, 2.0, 0.0), 0.0)
    scene = glass_scene(0)
    DepthCamera.kinect(64).render(scene.scene, scene.poses[0])


def run_foam() -> None:
    """Edges of a few lines, and the force of a contact in the middle of a strip; as the sensor calls them."""
    from visuohaptic.sensing.foam._chain_kernels import edge_crossing, filter_runs, join, place_odds
    from visuohaptic.sensing.foam._light_kernels import floor_beyond
    from visuohaptic.sensing.foam._posterior_kernels import shadow_odds
    from visuohaptic.sensing.foam._profile_kernels import integrate_regions, shared_variance
    from visuohaptic.sensing.foam._texture_kernels import foam_bands, level_odds, texture_odds
    from visuohaptic.sensing.foam.deflection import bridge, drop_bridged
    from visuohaptic.sensing.foam.edges import local_statistics, mean_between
    from visuohaptic.sensing.foam.material import StressCurve
    from visuohaptic.sensing.foam.shadowed import merged_fronts
    from visuohaptic.sensing.foam.strip._rectify_kernels import rectify
    from visuohaptic.sensing.foam.strip._reference import fit_motion

    grey, points_px, one_px, seen = np.zeros((8, 8), np.uint8), np.zeros((6, 2)), np.ones(6), np.ones(6, bool)
    now, rest = np.zeros((6, 5, 40), np.float32), np.zeros((6, 5, 40), np.uint8)
    rectify(grey, points_px, points_px, one_px, one_px, np.zeros(6, np.int64), now)
    front, states, against = np.full(6, 20.0), np.zeros((6, 4)), np.zeros((6, 6))
    bands, found, s_m = np.zeros((6, 9)), np.zeros((6, 8)), one_px.cumsum()
    foam_bands(now, rest, front, front, one_px, 1.0, seen, 0.0 * front, bands)
    texture_odds(bands, states, against, one_px.copy())
    for image in (now, rest):
        mean_between(image, points_px)
    local_statistics(front)
    floor_beyond(now, rest, one_px, front, front + 4.0, np.zeros((3, 6)))
    edges = front, front + 9.0, one_px
    shadow_odds(now, rest, np.ones((6, 6)), *edges, 1.0, one_px, 1.0, 1.0, seen, found)
    merged_fronts(now, np.ones((6, 6)), front, one_px, *edges, one_px, 9.0 * one_px, ~seen, np.zeros((6, 4)))
    level_odds(np.full((6, 8), np.nan), one_px, one_px, one_px, 1.0, against)
    place_odds(
        1.0, 0.03, one_px, one_px, one_px, 0.0 * one_px, one_px, 1.0, one_px, 1.0, 1.0, 0.0, against, states, one_px
    )  # fmt: skip
    crossing = edge_crossing(one_px, 0.01 * one_px, s_m, 1.0)
    rules, pairs = (1.0, 0.0, 0.0), np.zeros((6, 6))
    places = one_px, one_px, one_px, s_m
    join(states, states, crossing, *places, np.zeros(4), *rules, states.copy(), pairs, against[:, 3])
    again = seen, seen, one_px, 0.9, np.zeros((6, 6)), np.zeros((6, 6))
    filter_runs(pairs, one_px, one_px, s_m, one_px, *again)
    bridge(s_m, one_px, one_px, seen, np.int64(2), np.int64(3), front, one_px.copy())
    drop_bridged(s_m, one_px, one_px, seen, np.argsort(one_px), front, one_px.copy(), seen.copy())
    shared_variance(one_px, one_px, 0, 5)
    fit_motion(np.ones((6, 4)), one_px, one_px, seen)
    StressCurve("cubic", np.array([0.0, 0.6]), np.array([4e4, -1e5, 1e5]), np.eye(3)).stress(one_px)
    # Only compiled: its arguments are the tables of a calibrated foam.
    one, two, three = "f8[::1]", "f8[:, ::1]", "f8[:, :, ::1]"
    numbers = "f8, f8, f8, f8, i8, f8, f8, i8, b1"
    integrate_regions.compile(
        f"({one}, {one}, {two}, i8[::1], {two}, {two}, {numbers}, {one}, {two}, {three}, {one}, f8)"
    )


#: The parts and their kernels.
PARTS = (
    run_objects,
    run_tracking,
    run_planar,
    run_sensing,
    run_object,
    run_beam,
    run_graph,
    run_mapper,
    run_pushing,
    run_planning,
    run_reconstruction,
    run_deformation,
    run_simulation,
    run_containers,
    run_recognition,
    run_worlds,
    run_foam,
)


def main() -> int:
    """Run the parts and write the called signatures; the kernels must be in the cache already."""
    for module in pkgutil.walk_packages(visuohaptic.__path__, "visuohaptic."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    for part in PARTS:
        part()
    compiled = sum(len(one.stats.cache_misses) for one in KERNELS)
    if compiled:
        # A kernel that is compiled on behalf of another cannot be told from one that Python calls.
        print(f"{compiled} signatures were compiled: run it again to write the list", file=sys.stderr)
        return 1
    lines = sorted(
        f"{one.py_func.__module__}:{one.py_func.__qualname__} {arguments!r}"
        for one in KERNELS
        for arguments in one.overloads
    )
    SIGNATURES.write_text("\n".join(lines) + "\n")
    print(f"{len(lines)} signatures written to {SIGNATURES}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
