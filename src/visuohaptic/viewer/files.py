"""Selection of the view for a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..core.errors import InputError
from ..core.files import load_json, read_text
from ..deformation import class_names, load_map, load_object
from ..grasping.grasp_task import GraspTask
from .map_view import MapView
from .object_view import ObjectView
from .stage import View
from .steps_view import StepsView
from .surface_view import SurfaceView

_MAP_PICTURES = {".png", ".pgm", ".bmp"}
_MESHES = {".stl", ".obj", ".glb", ".dae"}


def open_views(sources: Sequence[Path | str], task: GraspTask | None = None) -> list[View]:
    """Create views of files and shipped classes, in the given order.

    ``.npz`` a stiffness map; ``.ply`` a surface, completed or not; ``.stl .obj .glb .dae`` a container;
    ``.yaml`` a container or a map of map_server, ``.json`` a plan, which is drawn on the map before
    it, or the steps of a classification ``{"steps": [[question, answer], ...], "result": ...}``; a
    name, a shipped class.

    Parameters
    ----------
    sources
        Files, or names of shipped container classes.
    task
        Force, state and hand of the grasps of containers.
    """
    out: list[View] = []
    for source in sources:
        view = _view(Path(source), task)
        last = out[-1] if out else None
        if isinstance(view, MapView) and view.grid is None and isinstance(last, MapView):
            if last.plan is None:
                out[-1] = MapView(last.title, last.grid, view.plan)
                continue
            # Several plans on the same map.
            view = MapView(f"{last.title}: {view.title}", last.grid, view.plan)
        out.append(view)
    return out


def _view(path: Path, task: GraspTask | None) -> View:
    kind = path.suffix.lower()
    if kind == ".npz":
        return ObjectView(path.stem, load_map(path), task=task)
    if kind == ".ply":
        from ..io.meshes.ply import read_ply

        return SurfaceView(path.name, read_ply(path))
    if kind in _MESHES or (not kind and str(path) in class_names()):
        return ObjectView.of_object(load_object(path), task)
    if kind == ".json":
        return _json_view(path)
    if kind in {".yaml", ".yml"}:
        if _is_map(path):
            return _map_view(path)
        return ObjectView.of_object(load_object(path), task)
    if kind in _MAP_PICTURES:
        raise InputError(path, "is a picture", remedy="give the .yaml file of the map")
    raise InputError(
        path,
        f"found suffix {kind!r}, expected .npz, .ply, .json, .yaml, {', '.join(sorted(_MESHES))}",
        remedy=f"or a class: {', '.join(class_names())}",
    )


def _map_view(path: Path) -> MapView:
    from ..io.maps.occupancy_map import OccupancyMap

    return MapView(path.name, OccupancyMap.load(path))


def _is_map(path: Path) -> bool:
    """Whether it is a map_server YAML file, which names an image; a container has sections."""
    return any(line.startswith("image:") for line in read_text(path).splitlines())


def _json_view(path: Path) -> View:
    data = load_json(path, "a plan or steps", lambda data: data)
    if isinstance(data, Mapping) and "steps" in data:
        return _steps(path, data)
    if isinstance(data, Mapping) and "tasks" in data:
        from ..navigation.problem.path_plan import plan_from_json

        return MapView(path.name, plan=plan_from_json(data, where=str(path)))
    raise InputError(path, "found neither tasks of a plan nor steps of a classification")


def _steps(path: Path, data: Mapping[str, Any]) -> StepsView:
    steps = data["steps"]
    good = isinstance(steps, list) and all(
        isinstance(step, list) and len(step) == 2 and all(isinstance(part, str) for part in step)
        for step in steps
    )
    if not good:
        raise InputError(path, "expected a list of [question, answer], both texts", field="steps")
    return StepsView(path.stem, [(step[0], step[1]) for step in steps], str(data.get("result") or ""))
