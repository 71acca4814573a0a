"""``defaults`` writes files that the verbs accept, with every setting; optional settings are commented out."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import yaml
from pydantic import BaseModel

from visuohaptic.cli.main import main
from visuohaptic.core.camera._camera_info import CameraInfoFile
from visuohaptic.core.files import load_yaml_model
from visuohaptic.deformation.maps.build_plan import BuildPlan
from visuohaptic.deformation.shapes.container import ContainerDescription
from visuohaptic.deformation.shapes.wall_properties import _PlyFile
from visuohaptic.io.depth.depth_sequence import SequenceFile
from visuohaptic.io.maps._map_server import MapFile
from visuohaptic.navigation.problem import RobotModel, load_robot
from visuohaptic.ros.bridge_config import BridgeConfig
from visuohaptic.sensing.beam.config import BeamSensorConfig
from visuohaptic.sensing.foam.strip import FoamSensorConfig
from visuohaptic.sensing.scene.scene_file import SceneConfig
from visuohaptic.tracking.templates._template_file import TemplateFolderFile

MODELS: dict[str, type[BaseModel]] = {
    "foam": FoamSensorConfig,
    "beam": BeamSensorConfig,
    "scene": SceneConfig,
    "bridge": BridgeConfig,
    "build": BuildPlan,
    "camera": CameraInfoFile,
    "container": ContainerDescription,
    "map": MapFile,
    "plies": _PlyFile,
    "sequence": SequenceFile,
    "templates": TemplateFolderFile,
}


def names(model) -> set[str]:
    """Names of all fields, by pydantic's own schema."""
    schema = model.model_json_schema()
    parts = [schema, *schema.get("$defs", {}).values()]
    return {name for part in parts for name in part.get("properties", {})}


def written(tmp_path: Path, *words: str) -> Path:
    out = tmp_path / "new.yaml"
    assert main(["defaults", *words, "--out", str(out)]) == 0
    return out


@pytest.mark.parametrize("kind", MODELS)
def test_every_setting_is_there_with_its_default(tmp_path, kind):
    model, path = MODELS[kind], written(tmp_path, kind)
    text = path.read_text()
    assert names(model) <= set(re.findall(r"(\w+):", text))
    found = load_yaml_model(path, model)
    given = {
        name: value for name, value in yaml.safe_load(text).items() if model.model_fields[name].is_required()
    }
    for name, field in model.model_fields.items():
        if not field.is_required() and not (kind == "beam" and name in ("camera", "templates_folder")):
            expected = field.get_default(call_default_factory=True)
            example = {"scene": ("camera", "T_camera_foam"), "templates": ("tags", "widths_m")}
            if name not in example.get(kind, ()):
                assert getattr(found, name) == expected, name
    assert all(value not in (None, "?") for value in given.values())
    without = [line for line in text.splitlines() if not re.search(r"#|: .*kind|name", line)]
    assert len(without) < 0.3 * len(text.splitlines()), without  # what a setting means is said


def test_optional_sections_are_accepted_when_their_marks_are_taken_away(tmp_path):
    path = written(tmp_path, "foam")
    lines = path.read_text().splitlines()
    start, end = lines.index(next(line for line in lines if line.startswith("# stripe:"))), len(lines)
    end = next(i for i in range(start, end) if not lines[i].startswith("#"))
    shown = [re.sub(r"^# ", "", line) for line in lines[start:end]]
    shown = [re.sub(r"^  # ", "  ", line) for line in shown]  # T_foam_tag, an option of an option
    path.write_text("\n".join([*lines[:start], *shown, *lines[end:]]))
    found = load_yaml_model(path, FoamSensorConfig)
    assert found.stripe is not None
    assert found.finger is not None
    assert found.finger.T_foam_tag is not None
    assert found.finger.tag_every == 30


def test_values_of_a_file_are_kept_and_a_wrong_file_is_named(tmp_path, capsys):
    path = written(tmp_path, "foam")
    data = yaml.safe_load(path.read_text())
    data["max_gap_s"], data["finger"] = 0.25, {"tag_id": 5}
    del data["tracking"], data["zero"]
    own = tmp_path / "own.yaml"
    own.write_text(yaml.safe_dump(data))
    (tmp_path / "kept").mkdir()
    path = written(tmp_path / "kept", "foam", "--config", str(own))
    found = load_yaml_model(path, FoamSensorConfig)
    assert found == load_yaml_model(own, FoamSensorConfig)
    assert found.max_gap_s == pytest.approx(0.25)
    assert found.finger.tag_id == 5
    assert "base_is: either" in path.read_text()  # the defaults stand beside them
    capsys.readouterr()
    own.write_text(yaml.safe_dump(data | {"max_gap": 1}))
    assert main(["defaults", "foam", "--config", str(own)]) == 2
    assert "did you mean max_gap_s?" in capsys.readouterr().err


def test_the_kinds_are_listed_and_are_all_tested(capsys):
    assert main(["defaults", "--json"]) == 0
    kinds = json.loads(capsys.readouterr().out)["kinds"]
    assert set(kinds) == {*MODELS, "robot"}
    assert kinds["beam"] == {"file": "sensor.yaml", "verb": "sense beam"}
    assert main(["defaults", "--out", "sensor.yaml"]) == 2
    assert "--out: found without a kind" in capsys.readouterr().err


def test_commented_entries_of_a_list_are_accepted(tmp_path):
    path = written(tmp_path, "container")
    path.write_text(re.sub(r"^# {0,1}", "", path.read_text().replace(": []", ":"), flags=re.MULTILINE))
    found = load_yaml_model(path, ContainerDescription)
    assert found.rim is not None
    assert len(found.rings) == len(found.dents) == 1


def test_a_robot_and_a_file_that_is_there(tmp_path, capsys):
    path = written(tmp_path, "robot")
    assert load_robot(path) == RobotModel(load_robot(path).radius_m)
    assert main(["defaults", "robot", "--out", str(path)]) == 2
    assert "already exists" in capsys.readouterr().err
    other = tmp_path / "other.yaml"
    other.write_text(path.read_text())
    before = path.read_bytes()
    assert main(["defaults", "robot", "--config", str(other), "--out", str(path)]) == 2
    assert "already exists" in capsys.readouterr().err
    assert path.read_bytes() == before
    assert main(["defaults", "robot", "--config", str(path), "--out", str(path)]) == 0
    capsys.readouterr()
    path.write_text("radius_m: 0.31\nv_push_m_s: 0.02\n")
    assert main(["defaults", "robot", "--config", str(path), "--json"]) == 0
    settings = json.loads(capsys.readouterr().out)["settings"]
    found = [settings[name] for name in ("radius_m", "v_push_m_s", "v_max_m_s")]
    assert found == pytest.approx([0.31, 0.02, 0.3])
