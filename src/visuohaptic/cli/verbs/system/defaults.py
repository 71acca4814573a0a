"""``visuohaptic defaults``: a configuration file with every setting, its default and what it means.

reads   with --config a file of that kind: its values take the place of the defaults
writes  YAML that the verbs accept, to the terminal or to --out; what is optional stands behind #
kinds
  foam    sensor.yaml of `sense foam`         beam    sensor.yaml of `sense beam`
  scene   scene.yaml of `sense scene`         robot   robot.yaml of `plan`
  bridge  bridge.yaml of `ros bridge`

examples
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

from ....core.errors import InputError

__all__ = ["add_arguments", "run"]

_REQUIRED: Any = object()
_POSE = {"translation_m": [0.0, 0.0, 0.3], "quaternion_xyzw": [0.7071, -0.7071, 0.0, 0.0]}
#: Kind -> module and class of its fields, and values of those that have no default.
_KINDS: Mapping[str, tuple[str, str, dict[str, Any]]] = {
    "foam": (
        "sensing.foam.strip.config",
        "FoamSensorConfig",
        {"camera": "camera.yaml", "foam": "foam.yaml", "strip": {"length_m": 0.25}, "T_camera_foam": _POSE},
    ),
    "beam": (
        "sensing.beam.config",
        "BeamSensorConfig",
        {
            "kind": "beam",
            "camera": "camera.yaml",
            "templates_folder": "templates",
            "templates": [{"name": "middle", "xi": 0.5}, {"name": "tip", "xi": 1.0}],
            "T_reference_sensor": {"translation_m": [0.0, 0.0, 0.0], "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]},
        },
    ),
    "scene": ("sensing.scene.scene_file", "SceneConfig", {"camera": "camera.yaml", "T_camera_foam": _POSE}),
    "robot": ("navigation.problem.robot_model", "RobotModel", {"radius_m": 0.2}),
    "bridge": (
        "ros.bridge_config",
        "BridgeConfig",
        {"sensors": [{"name": "foam", "config": "sensor.yaml", "image": "/camera/image_raw"}]},
    ),
}
#: Values in sections that are optional, and therefore behind #.
_SECTIONS = {"stripe": {"model": "stripe.npz", "width_m": 0.004}, "T_foam_tag": _POSE}


class _Entry(NamedTuple):
    """One setting of a file."""

    name: str
    default: Any  #: _REQUIRED: it must be given
    section: Any  #: class of its fields when it is a section, or a list of them; else None
    comment: str


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("kind", str, "what the file describes", choices=tuple(_KINDS))
    add("--config", Path, "file whose values are kept")
    add("--out", Path, "file to write (YAML); shown without")


def run(args: Any) -> dict[str, Any]:
    """Do it; the mapping is what ``--json`` prints."""
    from ....core.files import parse_yaml, write_text

    if args.out and args.out.exists() and args.config is None:
        raise InputError(args.out, "exists already", remedy=f"keep its values with --config {args.out}")
    module, name, values = _KINDS[args.kind]
    model = getattr(importlib.import_module(f"visuohaptic.{module}"), name)
    if args.config is not None:
        values = _values(args.config, model)
    text = "\n".join(_lines(model, values)) + "\n"
    if args.out:
        write_text(args.out, text)
        args.report(f"every setting of {args.kind} written to {args.out}")
    else:
        args.report(text.rstrip())
    return {"kind": args.kind, "settings": parse_yaml(text, args.kind), "out": args.out and str(args.out)}


def _values(path: Path, model: Any) -> dict[str, Any]:
    """Values of a file that its own reader accepts."""
    from ....core.codec import from_dict
    from ....core.files import load_yaml, load_yaml_model

    if is_dataclass(model):
        from_dict(cast(type, model), load_yaml(path), where=path)
    else:
        load_yaml_model(path, model)
    found: dict[str, Any] = load_yaml(path)
    return found


def _lines(model: Any, values: Mapping[str, Any]) -> Iterator[str]:
    """A section as YAML; ``values`` are those that differ from the defaults."""
    for entry in _entries(model):
        value = values.get(entry.name, entry.default)
        if value is _REQUIRED:
            value = values.get(entry.name, _SECTIONS.get(entry.name, "?"))
        said = f"  # {entry.comment}" if entry.comment else ""
        if entry.section is None:
            yield f"{'# ' if value is None else ''}{entry.name}: {_flow(value)}{said}"
        elif isinstance(value, list):
            yield f"{entry.name}:{said}"
            for item in value:
                first, *rest = _lines(entry.section, item)
                yield from (f"  - {first}", *(f"    {line}" for line in rest))
        else:
            mark = "# " if value is None else ""
            inside = _SECTIONS.get(entry.name, {}) if value is None else value
            given = inside if isinstance(inside, Mapping) else {}  # a section of defaults
            yield f"{mark}{entry.name}:{said}"
            yield from (f"{mark}  {line}" for line in _lines(entry.section, given))


def _flow(value: Any) -> str:
    """A value on one line of YAML."""
    import yaml

    text: str = yaml.safe_dump(value, default_flow_style=True, width=10**6)
    return text.removesuffix("\n").removesuffix("\n...")


def _entries(model: Any) -> Iterator[_Entry]:
    """The settings of a section, with what the source says of each."""
    comments = _comments(model)
    if is_dataclass(model):
        for item in fields(model):
            default = _REQUIRED if item.default is MISSING else item.default
            bounds = [rule.text for rule in item.metadata.values()]
            yield _Entry(item.name, default, None, _joined(comments.get(item.name), bounds, default))
        return
    for name, item in model.model_fields.items():
        default = _REQUIRED if item.is_required() else item.get_default(call_default_factory=True)
        parts = list(_parts(item.annotation)) + item.metadata
        section = next((part for part in parts if hasattr(part, "model_fields")), None)
        yield _Entry(name, default, section, _joined(comments.get(name), list(_bounds(parts)), default))


def _parts(annotation: Any) -> Iterator[Any]:
    """A type and all that it is made of."""
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
