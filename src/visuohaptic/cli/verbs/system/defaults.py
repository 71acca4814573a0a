"""``visuohaptic defaults``: a configuration file with every setting, its default and what it means.

reads   with --config, a file of that kind: its values replace the defaults
writes  YAML that the verbs accept, to the terminal or to --out; optional settings are commented out with #

Without a kind, the kinds are listed with their file and the verb that reads it. The parameters of ROS 2 nodes are
listed by `ros node NAME --list`.

examples
  visuohaptic defaults
  visuohaptic defaults foam --out sensor.yaml
  visuohaptic defaults robot --config robot.yaml
"""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, cast, get_args, get_origin

from .... import core
from ....core import files
from ....core.errors import InputError

_REQUIRED: Any = object()
_POSE = {"translation_m": [0.0, 0.0, 0.3], "quaternion_xyzw": [0.7071, -0.7071, 0.0, 0.0]}
_REFERENCE = {"translation_m": [0.0, 0.0, 0.0], "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]}
_MATRIX = {"rows": 3, "cols": 3, "data": [1800.0, 0.0, 799.5, 0.0, 1800.0, 447.5, 0.0, 0.0, 1.0]}


class _Kind(NamedTuple):
    """A kind of configuration file."""

    file: str
    verb: str  #: that reads it
    module: str
    model: str  #: class of its fields
    required: dict[str, Any]  #: examples for the fields that have no default


_KINDS: Mapping[str, _Kind] = {
    "camera": _Kind(
        "camera.yaml",
        "sense",
        "core.camera._camera_info",
        "CameraInfoFile",
        {"image_width": 1600, "image_height": 896, "camera_matrix": _MATRIX},
    ),
    "foam": _Kind(
        "sensor.yaml",
        "sense foam",
        "sensing.foam.strip.config",
        "FoamSensorConfig",
        {"camera": "camera.yaml", "foam": "foam.yaml", "strip": {"length_m": 0.25}, "T_camera_foam": _POSE},
    ),
    "beam": _Kind(
        "sensor.yaml",
        "sense beam",
        "sensing.beam.config",
        "BeamSensorConfig",
        {
            "kind": "beam",
            "camera": "camera.yaml",
            "templates_folder": "templates",
            "templates": [{"name": "middle", "xi": 0.5}, {"name": "tip", "xi": 1.0}],
            "T_reference_sensor": _REFERENCE,
        },
    ),
    "scene": _Kind(
        "scene.yaml",
        "sense scene",
        "sensing.scene.scene_file",
        "SceneConfig",
        {"camera": "camera.yaml", "T_camera_foam": _POSE},
    ),
    "templates": _Kind(
        "tags.yaml",
        "track",
        "tracking.templates._template_file",
        "TemplateFolderFile",
        {"tags": {"tip": {"id": 7, "size_m": 0.03}}, "widths_m": {"poster.png": 0.4}},
    ),
    "sequence": _Kind(
        "sequence.yaml", "reconstruct", "io.depth.depth_sequence", "SequenceFile", {"depth_scale_m": 0.001}
    ),
    "map": _Kind(
        "map.yaml",
        "plan",
        "io.maps._map_server",
        "MapFile",
        {
            "image": "map.pgm",
            "resolution": 0.05,
            "origin": [0.0, 0.0, 0.0],
            "negate": 0,
            "occupied_thresh": 0.65,
            "free_thresh": 0.196,
        },
    ),
    "robot": _Kind("robot.yaml", "plan", "navigation.problem.robot_model", "RobotModel", {"radius_m": 0.2}),
    "container": _Kind(
        "container.yaml",
        "stiffness",
        "deformation.shapes.container",
        "ContainerDescription",
        {"base": {"radius": "30 mm"}, "sections": [{"height": "150 mm"}]},
    ),
    "plies": _Kind(
        "plies.yaml",
        "stiffness --material",
        "deformation.shapes.wall_properties",
        "_PlyFile",
        {"plies": [{"thickness": "0.4 mm", "material": "PET"}]},
    ),
    "build": _Kind(
        "plan.yaml",
        "objects build",
        "deformation.maps.build_plan",
        "BuildPlan",
        {"classes": [{"class": "bottle"}]},
    ),
    "bridge": _Kind(
        "bridge.yaml",
        "ros bridge",
        "ros.bridge_config",
        "BridgeConfig",
        {"sensors": [{"name": "foam", "config": "sensor.yaml", "image": "/camera/image_raw"}]},
    ),
}
#: Values in sections that are optional, and therefore behind #.
_SECTIONS: Mapping[str, Any] = {
    "stripe": {"model": "stripe.npz", "width_m": 0.004},
    "T_foam_tag": _POSE,
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0] * 5},
    "rim": {"height": "5 mm", "wall": "1 mm"},
    "rings": {"z": "50 mm", "depth": "2 mm", "width": "5 mm"},
    "dents": {"z": "80 mm", "depth": "3 mm", "width": "30 mm", "height": "40 mm"},
}


class _Entry(NamedTuple):
    """One setting of a file."""

    name: str
    default: Any  #: _REQUIRED: it must be given
    section: Any  #: class of its fields when it is a section, or a list or mapping of them; else None
    named: bool  #: a mapping of sections by name
    comment: str


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("kind", str, "what the file describes; without it the kinds are listed", choices=_KINDS, nargs="?")
    add("--config", Path, "file whose values are kept")
    add("--out", Path, "YAML file to write; by default it is printed")


def run(args: Any) -> dict[str, Any]:
    """Run the verb; returns the mapping that ``--json`` prints."""
    if args.kind is None:
        args.refuse("--out --config", f"found without a kind, expected one of {', '.join(_KINDS)} before it")
        for name, kind in _KINDS.items():
            args.report(f"{name:<11}{kind.file:<16}read by {kind.verb}")
        return {"kinds": {name: {"file": kind.file, "verb": kind.verb} for name, kind in _KINDS.items()}}
    # Only the file whose values are kept may be replaced.
    if args.out and args.out.exists() and not (args.config and args.config.samefile(args.out)):
        raise InputError(args.out, "already exists", remedy=f"keep its values with --config {args.out}")
    kind = _KINDS[args.kind]
    model, values = getattr(importlib.import_module(f"visuohaptic.{kind.module}"), kind.model), kind.required
    if args.config is not None:
        values = _values(args.config, model)
    text = "\n".join(_lines(model, values)) + "\n"
    if args.out:
        files.write_text(args.out, text)
        args.report(f"{args.out}: every setting of a {args.kind} file, with its default")
    else:
        args.report(text.rstrip())
    return {
        "kind": args.kind,
        "settings": files.parse_yaml(text, args.kind),
        "out": args.out and str(args.out),
    }


def _values(path: Path, model: Any) -> dict[str, Any]:
    """Values of a file that its own reader accepts."""
    if is_dataclass(model):
        core.from_dict(cast(type, model), files.load_yaml(path), where=path)
    else:
        files.load_yaml_model(path, model)
    found: dict[str, Any] = files.load_yaml(path)
    return found


def _lines(model: Any, values: Mapping[str, Any]) -> Iterator[str]:
    """A section as YAML; ``values`` are those that differ from the defaults."""
    for entry in _entries(model):
        value = values.get(entry.name, entry.default)
        if value is _REQUIRED:
            value = _SECTIONS.get(entry.name, "?")
        said = f"  # {entry.comment}" if entry.comment else ""
        if entry.section is None:
            yield f"{'# ' if value is None else ''}{entry.name}: {_flow(value)}{said}"
        elif isinstance(value, list):
            yield f"{entry.name}:{'' if value else ' []'}{said}"
            mark = "" if value else "# "
            for item in value or [_SECTIONS.get(entry.name, {})]:
                first, *rest = _lines(entry.section, item if isinstance(item, Mapping) else item.model_dump())
                yield from (f"{mark}  - {first}", *(f"{mark}    {line}" for line in rest))
        elif entry.named:
            yield f"{entry.name}:{'' if value else ' {}'}{said}"
            for name, item in value.items():
                yield from (f"  {name}:", *(f"    {line}" for line in _lines(entry.section, item)))
        else:
            mark = "# " if value is None else ""
            inside = _SECTIONS.get(entry.name, {}) if value is None else value
            given = inside if isinstance(inside, Mapping) else {}  # a section of defaults
            yield f"{mark}{entry.name}:{said}"
            yield from (f"{mark}  {line}" for line in _lines(entry.section, given))


def _flow(value: Any) -> str:
    """A value on one line of YAML."""
    import yaml

    if isinstance(value, tuple):  # a range of numbers, often of one
        value = value[0] if len(set(value)) == 1 else list(value)
    text: str = yaml.safe_dump(value, default_flow_style=True, width=10**6)
    return text.removesuffix("\n").removesuffix("\n...")


def _entries(model: Any) -> Iterator[_Entry]:
    """The settings of a section, with their comments in the source."""
    comments = _comments(model)
    if is_dataclass(model):
        for item in fields(model):
            default = _REQUIRED if item.default is MISSING else item.default
            bounds = [rule.text for rule in item.metadata.values()]
            yield _Entry(item.name, default, None, False, _joined(comments.get(item.name), bounds, default))
        return
    for name, item in model.model_fields.items():
        default = _REQUIRED if item.is_required() else item.get_default(call_default_factory=True)
        parts = list(_parts(item.annotation)) + item.metadata
        section = next((part for part in parts if hasattr(part, "model_fields")), None)
        named = section is not None and get_origin(item.annotation) is dict
        comment = _joined(comments.get(name), list(_bounds(parts)), default)
        yield _Entry(item.alias or name, default, section, named, comment)


def _parts(annotation: Any) -> Iterator[Any]:
    """A type and all its components."""
    yield annotation
    yield from getattr(annotation, "metadata", ())
    if get_origin(annotation) is not Literal:
        for part in get_args(annotation):
            yield from _parts(part)


def _bounds(parts: list[Any]) -> Iterator[str]:
    """What values are allowed, in words."""
    words = {"gt": "more than", "ge": "at least", "lt": "less than", "le": "at most"}
    for part in parts:
        if get_origin(part) is Literal and len(get_args(part)) > 1:
            yield " | ".join(get_args(part))
        for name, word in words.items():
            if (bound := getattr(part, name, None)) is not None:
                yield f"{word} {bound:g}"


def _joined(comment: str | None, bounds: list[str], default: Any) -> str:
    must = "required" if default is _REQUIRED else "optional" if default is None else ""
    return "; ".join(text for text in (must, comment, *dict.fromkeys(bounds)) if text).replace("``", "")


def _comments(model: Any) -> dict[str, str]:
    """The ``#:`` comments of the fields of a class, as the reference shows them."""
    found: dict[str, str] = {}
    above: list[str] = []
    for line in inspect.getsource(model).splitlines():
        code, mark, comment = line.partition("#:")
        name = re.match(r"    (\w+):", code)
        if mark and not code.strip():
            above.append(comment.strip())
        elif name:
            last, above = name[1], [*above, comment.strip()] if mark else above
            found[last], above = " ".join(above), []
        elif mark and found:
            found[last] = comment.strip()  # behind the last line of a field of several lines
    return found
