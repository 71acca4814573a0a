"""Readers of third-party scenes: namosim (SVG) and SVG-MPPI (YAML).

namosim, https://github.com/Chroma-CITI/namosim: one unit of the view box is a
centimetre, y points down; walls, movables, robots and goals are paths. Scenes
with a ROS map name it in a ``namo.yaml`` beside them; there a unit is a pixel.
SVG-MPPI, https://github.com/tud-amr/SVG-MPPI: boxes in metres and degrees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.peers.svg_path import outline_from_svg_path
from jaxtyping import Float

from visuohaptic.core import Estimate, HapticTag, InputError, brief
from visuohaptic.core.files import load_yaml, read_bytes
from visuohaptic.io.maps import FREE, OCCUPIED, OccupancyMap
from visuohaptic.navigation.problem import MovableObject, PlanningProblem, RobotModel

__all__ = ["Scene", "load_namosim", "load_svg_mppi"]

#: Minimum radius of a robot in cells of a scene's grid.
CELLS_PER_RADIUS = 4
#: SVG files larger than this are refused before they are parsed (bytes).
MAX_SVG_BYTES = 16 * 1024 * 1024
#: Movables of these scenes: light, and known to move.
_LIGHT = HapticTag(
    static_friction_N=Estimate(5.0, 0.0),
    dynamic_friction_N=Estimate(4.5, 0.0),
    fixed=False,
    falls=False,
    explored=1,
)
#: Gravity times a friction coefficient of 0.3: force from a scene's mass [m/s^2].
_FRICTION_M_S2 = 0.3 * 9.81


@dataclass(frozen=True, slots=True)
class Scene:
    """One problem per robot and goal; a second goal starts where the first is."""

    name: str
    problems: tuple[PlanningProblem, ...]


def load_namosim(path: Path | str) -> Scene:
    """Read a namosim scene: an SVG file, or the ``namo.yaml`` that names one and a ROS map.

    Raises
    ------
    InputError
        Names the file, the element, what was found and what was expected.
    """
    path = Path(path)
    if path.suffix.lower() in {".yaml", ".yml"}:
        return _namosim_yaml(path)
    root = _svg_root(path)
    width, height = _view_box(root, path)
    outlines, kinds = _outlines(root, path, scale_m=0.01, height=height)
    config = next((e for e in root.iter() if _local(e.tag) == "namo_config"), None)
    if config is None:
        raise InputError(path, "is missing", field="namo_config", remedy="name its namo.yaml instead")
    try:
        cell_m = float(config.get("cell_size_cm", "")) / 100.0
    except ValueError as error:
        raise InputError(path, "expected a number of centimetres", field="cell_size_cm") from error
    if not (math.isfinite(cell_m) and cell_m > 0):
        raise InputError(path, f"found {cell_m}, expected > 0", field="cell_size_cm")
    agents: list[tuple[str, list[str]]] = []
    for agent in (e for e in config.iter() if _local(e.tag) == "agent"):
        goals = [e.get("goal_id", "") for e in agent.iter() if _local(e.tag) == "goal"]
        agents.append((agent.get("agent_id", ""), goals))
    radius_m = min((_radius(outlines[name]) for name, _ in agents if name in outlines), default=float("nan"))
    if not math.isfinite(radius_m):
        raise InputError(path, "has no robot with a path of its own", field="agent_id")
    resolution_m = min(cell_m, radius_m / CELLS_PER_RADIUS)
    walls = [outlines[name] for name, kind in kinds.items() if kind == "wall"]
    movables = {name: outlines[name] for name, kind in kinds.items() if kind == "movable"}
    grid = _raster(walls, (width * 0.01, height * 0.01), resolution_m, path)
    return Scene(path.stem, _problems(path, grid, movables, agents, outlines))


def _problems(
    path: Path,
    grid: OccupancyMap,
    movables: dict[str, Float[np.ndarray, "p 2"]],
    agents: list[tuple[str, list[str]]],
    outlines: dict[str, Float[np.ndarray, "p 2"]],
) -> tuple[PlanningProblem, ...]:
    problems: list[PlanningProblem] = []
    for name, goals in agents:
        if name not in outlines:
            raise InputError(path, "has no path with that id", field=name)
        robot = RobotModel(_radius(outlines[name]))
        at = _centroid(outlines[name])
        # Other robots are static obstacles that cannot be pushed.
        others = [
            MovableObject(other, outlines[other], HapticTag(fixed=True))
            for other, _ in agents
            if other != name and other in outlines
        ]
        objects = tuple([MovableObject(key, value, _LIGHT) for key, value in movables.items()] + others)
        for goal in goals:
            if goal not in outlines:
                raise InputError(path, "has no path with that id", field=goal)
            end = _centroid(outlines[goal])
            problems.append(PlanningProblem(grid, robot, at, end, objects))
            at = end
    return tuple(problems)


def _namosim_yaml(path: Path) -> Scene:
    data = load_yaml(path)
    if not isinstance(data, dict) or not isinstance(data.get("agents"), list):
        raise InputError(path, "expected map_yaml, svg_file and agents")
    names = {key: data.get(key) for key in ("map_yaml", "svg_file")}
    for key, name in names.items():
        if not isinstance(name, str) or Path(name).name != name:
            raise InputError(path, f"found {brief(name)}, expected a file name beside this file", field=key)
    grid = OccupancyMap.load(path.parent / str(names["map_yaml"]))
    svg = path.parent / str(names["svg_file"])
    root = _svg_root(svg)
    _, height = _view_box(root, svg)
    outlines, kinds = _outlines(root, svg, scale_m=grid.resolution_m, height=height)
    movables = {k: outlines[k] for k, kind in kinds.items() if kind == "movable" or k.startswith("box")}
    problems: list[PlanningProblem] = []
    for entry in data["agents"]:
        try:
            at = np.array([float(value) for value in entry["initial_pose"][:2]])
            robot = RobotModel(float(entry["radius"]))
            name = str(entry["id"])
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                path, f"expected id, initial_pose and radius ({error})", field="agents"
            ) from error
        goals = [key for key, kind in kinds.items() if kind == f"goal of {name}"]
        for goal in goals:
            end = _centroid(outlines[goal])
            objects = tuple(MovableObject(key, value, _LIGHT) for key, value in movables.items())
            problems.append(PlanningProblem(grid, robot, at, end, objects))
            at = end
    return Scene(path.parent.name, tuple(problems))


def load_svg_mppi(path: Path | str, *, radius_m: float = 0.3, resolution_m: float = 0.05) -> Scene:
    """Read an SVG-MPPI world.

    The files name kinds of furniture without a size; the sizes assumed are
    those of a chair, a chaise, a table and a bookcase of common make.

    Parameters
    ----------
    path
        YAML file.
    radius_m
        Of the robot, which the file does not give.
    resolution_m
        Of the grid made from the walls.
    """
    path = Path(path)
    data = load_yaml(path)
    try:
        environment = data["environment"]
        at = np.array([float(value) for value in environment["robot"]["init_state"][:2]])
        end = np.array([float(value) for value in data["goal"][:2]])
        walls = [_box(kind, entry, path)[0] for kind, entry in _entries(environment.get("demarcation"))]
        things = [(kind, entry) for kind, entry in _entries(environment.get("obstacles"))]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(path, f"is not an SVG-MPPI world ({type(error).__name__}: {error})") from error
    objects: list[MovableObject] = []
    for kind, entry in things:
        outline, mass_kg = _box(kind, entry, path)
        tag = HapticTag(
            static_friction_N=Estimate(mass_kg * _FRICTION_M_S2, 0.0), fixed=kind == "stationary", explored=1
        )
        objects.append(MovableObject(str(entry.get("name", kind)), outline, tag))
    corners = np.concatenate([*walls, *(item.footprint_m for item in objects), at[None], end[None]])
    low, high = corners.min(axis=0) - 2 * radius_m, corners.max(axis=0) + 2 * radius_m
    grid = _raster(
        [wall - low for wall in walls], (float(high[0] - low[0]), float(high[1] - low[1])), resolution_m, path
    )
    grid = OccupancyMap(grid.cells, resolution_m, (float(low[0]), float(low[1]), 0.0))
    robot = RobotModel(radius_m, push_force_max_N=100.0)
    return Scene(path.stem, (PlanningProblem(grid, robot, at, end, tuple(objects)),))


#: Width, depth [m] and mass [kg] of kinds that the files only name.
_FURNITURE = {
    "chair": (0.5, 0.5, 5.0),
    "chaise": (0.6, 0.9, 12.0),
    "table": (1.0, 0.8, 15.0),
    "bookcase": (0.9, 0.35, 30.0),
    "stationary": (1.0, 1.0, 1e3),
}


def _entries(items: Any) -> list[tuple[str, dict[str, Any]]]:
    return [next(iter(item.items())) for item in items or []]


def _box(kind: str, entry: dict[str, Any], path: Path) -> tuple[Float[np.ndarray, "4 2"], float]:
    known = _FURNITURE.get(kind, (0.5, 0.5, 10.0))
    size = entry.get("size") or known
    try:
        half = np.array([float(size[0]), float(size[1])]) / 2
        centre = np.array([float(value) for value in entry["init_pos"][:2]])
        angle = math.radians(float((entry.get("init_ori") or [0, 0, 0])[2]))
        mass_kg = float(entry.get("mass") or known[2])
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(path, f"expected init_pos, init_ori and size ({error})", field=kind) from error
    c, s = math.cos(angle), math.sin(angle)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    return corners @ np.array([[c, s], [-s, c]]) + centre, mass_kg


def _local(tag: Any) -> str:
    return str(tag).rpartition("}")[2]


def _svg_root(path: Path) -> Any:
    """Root of an SVG file; entities are rejected, because they can expand without bound."""
    import xml.etree.ElementTree as ElementTree

    text = read_bytes(path, MAX_SVG_BYTES)
    if b"<!ENTITY" in text or b"<!DOCTYPE" in text:
        raise InputError(path, "has a document type, expected plain SVG")
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(path, f"is not XML: {error}") from error


def _view_box(root: Any, path: Path) -> tuple[float, float]:
    try:
        left, top, width, height = (
            float(value) for value in root.get("viewBox", "").replace(",", " ").split()
        )
    except ValueError as error:
        raise InputError(path, "expected four numbers", field="viewBox") from error
    if left or top or not (0 < width < 1e6 and 0 < height < 1e6):
        raise InputError(
            path, f"found {left} {top} {width} {height}, expected 0 0 width height", field="viewBox"
        )
    return width, height


def _outlines(
    root: Any, path: Path, *, scale_m: float, height: float
) -> tuple[dict[str, Float[np.ndarray, "p 2"]], dict[str, str]]:
    """Outlines [m] of all paths by id, y up, and what each is."""
    outlines: dict[str, Float[np.ndarray, "p 2"]] = {}
    kinds: dict[str, str] = {}
    for element in root.iter():
        if _local(element.tag) != "path":
            continue
        attributes = {_local(key): value for key, value in element.attrib.items()}
        name = attributes.get("id", "")
        points = outline_from_svg_path(attributes.get("d", ""), where=f"{path}: path {name}")
        outlines[name] = np.column_stack([points[:, 0], height - points[:, 1]]) * scale_m
        kinds[name] = _kind(name, element.attrib)
    return outlines, kinds


def _kind(name: str, attributes: dict[str, str]) -> str:
    # Inkscape has a "type" of its own; namosim's carries no name space, or its own.
    for key, value in attributes.items():
        if _local(key) == "type" and "sodipodi" not in key and value in {"wall", "movable"}:
            return value
    return f"goal of {attributes['agent_id']}" if "agent_id" in attributes else "shape"


def _raster(
    walls: list[Float[np.ndarray, "p 2"]], size_m: tuple[float, float], resolution_m: float, path: Path
) -> OccupancyMap:
    """Cells whose centre is in a wall; the border of the scene is closed."""
    import cv2

    columns, rows = (max(1, math.ceil(value / resolution_m - 1e-9)) for value in size_m)
    if rows * columns > 64_000_000:
        raise InputError(path, f"gives {rows} x {columns} cells, expected at most 64 million")
    cells = np.full((rows, columns), FREE, np.int8)
    sub = 8  # cv2 fills whole pixels unless a fixed-point shift is given
    image = np.zeros((rows, columns), np.uint8)
    for wall in walls:
        fixed = np.rint((wall / resolution_m - 0.5) * (1 << sub)).astype(np.int32)
        cv2.fillPoly(image, [fixed], 1, shift=sub)
    cells[image > 0] = OCCUPIED
    cells[[0, -1], :] = OCCUPIED
    cells[:, [0, -1]] = OCCUPIED
    return OccupancyMap(cells, resolution_m)


def _centroid(outline: Float[np.ndarray, "p 2"]) -> Float[np.ndarray, "2"]:
    return MovableObject("shape", outline).centre_m


def _radius(outline: Float[np.ndarray, "p 2"]) -> float:
    return float(np.hypot(*(outline - _centroid(outline)).T).max())
