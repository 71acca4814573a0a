"""Wrong input files end in one line and exit code 2, for every verb that reads a file."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from visuohaptic.cli.main import VERBS, main
from visuohaptic.core.camera import Camera
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.io.sinks import FORCE_COLUMNS
from visuohaptic.sensing.beam import Beam, save_beam

#: BAD is the file in question; the files beside it are right, as far as the verb gets to see them.
COMMANDS = (
    "demo --map BAD.yaml",
    "start --source BAD.mp4 --length 250 --width 20 --height 10",
    "start --source movie.mp4 --foam BAD.yaml --length 250 --width 20 --height 10",
    "defaults foam --config BAD.yaml",
    "defaults robot --config BAD.yaml",
    "sense foam --config BAD.yaml --source movie.mp4",
    "sense scene --config BAD.yaml --source movie.mp4",
    "sense beam --config BAD.yaml --poses poses.csv",
    "track --templates BAD --source photos --camera camera.yaml",
    "track --templates templates --source BAD.mp4 --camera camera.yaml",
    "track --templates templates --source BAD.mcap --camera camera.yaml",
    "track --templates templates --source photos --camera BAD.yaml",
    "template check BAD.png --width-m 0.1",
    "compare BAD.csv scale.csv",
    "compare run.csv BAD.csv",
    "calibrate foam BAD.csv --width 0.02 --height 0.01",
    "calibrate beam BAD.csv --beam beam.yaml",
    "calibrate beam loads.csv --beam BAD.yaml",
    "calibrate camera BAD.mp4 --squares 9x6 --square-mm 25 --out c.yaml",
    "calibrate stripe photos/0.png --config BAD.yaml --out stripe.npz",
    "map inspect BAD.yaml",
    "map build BAD.mcap --out m.yaml",
    "map build BAD.csv --out m.yaml",
    "map graph BAD.yaml --radius 0.2 --out graph",
    "plan BAD.yaml --objects objects.yaml --robot robot.yaml --start 0 0 --goal 1 1",
    "plan map.yaml --objects BAD.yaml --robot robot.yaml --start 1 1 --goal 2 2",
    "plan map.yaml --objects objects.yaml --robot BAD.yaml --start 1 1 --goal 2 2",
    "stiffness BAD.yaml --out map.npz",
    "stiffness BAD.stl --out map.npz",
    "stiffness BAD.ply --out map.npz",
    "squeeze BAD.yaml",
    "squeeze BAD.stl",
    "grasp BAD.yaml",
    "grasp BAD.npz",
    "grasp BAD.obj",
    "reconstruct BAD --out model",
    "complete BAD.ply --region regions.json --out c.ply",
    "objects list --db BAD",
    "objects show a --db BAD",
    "objects add a --db BAD_FILE",
    "objects import BAD --db db",
    "objects export a --db BAD --licence CC0-1.0 --out out",
    "objects sync shared --db BAD_FILE",
    "objects search --like a --db BAD",
    "objects build BAD.yaml --out built",
    "objects recognise --prior BAD.npz --cloud seen.ply",
    "ros bridge BAD.yaml",
    "ros launch BAD.launch.xml",
    "ros node foam --transport zenoh --connect none --param config:=BAD.yaml",
    "classify train --objects BAD --out tree.json",
    "classify train --objects BAD.npz --out tree.json",
    "classify train BAD.csv --out tree.json",
    "classify plan BAD.json",
    "classify run BAD.json curves.csv",
    "recording info BAD.mp4",
    "recording info BAD.mcap",
    "recording info BAD.yaml",
    "recording import BAD --out scan",
    "recording recover BAD.csv.part",
    "recording recover BAD.mcap.part",
    "view BAD.npz --seconds 0",
    "view BAD.yaml --seconds 0",
    "view BAD.ply --seconds 0",
    "view BAD.json --seconds 0",
    "view BAD.glb --seconds 0",
)

#: Verbs that read no file.
NO_FILE = {
    "ros echo",
    "template sheet",
    "cameras",
    "recording capture",
    "example foam",
    "example beam",
    "example glass",
    "example gripper",
    "example office",
    "example task",
    "reproduce",
    "warmup",
    "completion",
    "doctor",
}

KINDS = ("missing", "empty", "folder", "words", "noise", "numbers")


def _spoil(path: Path, kind: str) -> None:
    if kind == "empty":
        path.write_bytes(b"")
    elif kind == "folder":
        path.mkdir()
    elif kind == "words":
        path.write_text("This is a letter: it has [nothing to do\nwith robots.\n")
    elif kind == "noise":
        path.write_bytes(np.random.default_rng(0).integers(0, 256, 4096, dtype=np.uint8).tobytes())
    elif kind == "numbers":
        path.write_text("1.0\n")


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """A folder with what is right."""
    monkeypatch.chdir(tmp_path)
    cells = np.zeros((60, 60), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    OccupancyMap(cells, 0.05).save(tmp_path / "map.yaml")
    Camera.simple(64, 48, 60.0).save(tmp_path / "camera.yaml")
    for name in ("photos", "templates"):
        (tmp_path / name).mkdir()
    cv2.imwrite("photos/0.png", np.full((48, 64), 90, np.uint8))
    (tmp_path / "templates" / "tags.yaml").write_text("tags: {tool: {id: 9, size_m: 0.04}}\n")
    save_beam(tmp_path / "beam.yaml", Beam())
    (tmp_path / "objects.yaml").write_text("objects: []\n")
    (tmp_path / "scale.csv").write_text("t_s,mass_g\n0,0\n1,100\n")
    (tmp_path / "run.csv").write_text(f"{','.join(FORCE_COLUMNS)}\n0,false,lost,nan,nan,0,nan,nan,nan,nan\n")
    (tmp_path / "robot.yaml").write_text(
        "{radius_m: 0.17, v_max_m_s: 0.3, v_min_m_s: 0.05, v_push_m_s: 0.05, push_force_max_N: 20.0,"
        " setup_time_s: 4.0}\n"
    )
    return tmp_path


def test_every_verb_that_reads_a_file_is_here():
    assert {verb for verb in VERBS if any(c.startswith(verb + " ") for c in COMMANDS)} | NO_FILE >= set(VERBS)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("command", COMMANDS)
def test_one_line_and_code_2(desk, capsys, command, kind):
    words = command.split()
    name = next(word[word.index("BAD") :] for word in words if "BAD" in word)
    if name == "BAD_FILE" and kind in {"missing", "folder"}:
        pytest.skip("becomes a database")
    _spoil(desk / name, kind)
    before = set(desk.rglob("*"))
    code = main(words)
    captured = capsys.readouterr()
    assert code == 2, captured.err
    assert captured.err.startswith("visuohaptic: error: ")
    assert captured.err.count("\n") == 1, captured.err
    assert name in captured.err, "which file?"
    assert {path for path in desk.rglob("*") if path.is_file()} <= before, "nothing half-made is left"


@pytest.mark.parametrize(
    "command",
    [
        "demo --seed -1",
        "stiffness cup --around 0",
        "stiffness cup --around 24.5",
        "objects add a --seen nan 0 0",
        "objects add a --context kitchen",
    ],
)
def test_numbers_out_of_range_are_one_line_too(desk, capsys, command):
    assert main(command.split()) == 2
    assert capsys.readouterr().err.count("\n") == 1
