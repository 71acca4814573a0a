"""Files and commands of the beam sensor."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from tests.sensing.beam.pose_noise import noisy_pose

from visuohaptic.cli.main import main
from visuohaptic.core import CalibrationError, InputError, Reason
from visuohaptic.core.files import save_yaml
from visuohaptic.io.sinks import read_wrench_table
from visuohaptic.sensing.beam import (
    POSE_COLUMNS,
    Beam,
    BeamSensorConfig,
    BeamSetup,
    TemplateMeasurement,
    load_beam,
    prior_correction,
    read_loads,
    read_template_poses,
    save_beam,
)

AXES = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")


def test_a_file_without_settings_has_those_of_the_sensor(tmp_path):
    save_beam(tmp_path / "beam.yaml", Beam())
    pose = {"translation_m": [0.0, 0.0, 0.0], "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]}
    templates = [{"name": "tip", "xi": 1.0}]
    save_yaml(tmp_path / "sensor.yaml", {"kind": "beam", "templates": templates, "T_reference_sensor": pose})
    found = BeamSensorConfig.load(tmp_path / "sensor.yaml")
    plain = BeamSetup({"tip": 1.0}, found.T_reference_sensor)
    for name in (
        "drift",
        "reference",
        "view",
        "model",
        "stress_limit",
        "max_age_s",
        "linear_limit",
        "correction",
    ):
        assert getattr(found, name) == getattr(plain, name)


def write_template_poses(path, frames):
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(POSE_COLUMNS)
        for t_s, templates in frames:
            for template in templates:
                pose = template.T_camera_template
                numbers = (
                    np.full(7, np.nan)
                    if pose is None
                    else np.hstack([pose.translation_m, pose.quaternion_xyzw])
                )
                upper = template.covariance[np.triu_indices(6)]
                head = [repr(float(t_s)), template.name, str(template.valid).lower(), template.reason.value]
                writer.writerow([*head, *(repr(float(value)) for value in (*numbers, *upper))])


@pytest.fixture
def folder(bench, tmp_path):
    """A sensor on the disk: beam, configuration, poses at rest and of a push."""
    save_beam(tmp_path / "beam.yaml", Beam())
    save_yaml(
        tmp_path / "sensor.yaml",
        {
            "kind": "beam",
            "templates": [{"name": "middle", "xi": 0.5}, {"name": "tip", "xi": 1.0}],
            "T_reference_sensor": bench.setup.T_reference_sensor.fields,
        },
    )
    rng = np.random.default_rng(1)

    def frames(forces, start):
        for k, force in enumerate(forces):
            templates = bench.templates([0, force, 0, 0, 0, 0])
            yield (
                start + k / 30,
                [
                    TemplateMeasurement(
                        t.name, noisy_pose(t.T_camera_template, t.covariance, rng), t.covariance
                    )
                    for t in templates
                ],
            )

    write_template_poses(tmp_path / "rest.csv", frames(np.zeros(20), 0.0))
    write_template_poses(tmp_path / "push.csv", frames([0, 0.5, 1.0, 1.5, 4.0], 1.0))
    return tmp_path


def test_from_poses_to_a_table_and_a_recording(folder, capsys):
    config, poses = str(folder / "sensor.yaml"), str(folder / "push.csv")
    assert main(["sense", "beam", "--config", config, "--poses", poses]) == 2
    assert "there is no zero reference; take one first" in capsys.readouterr().err
    assert main(["sense", "beam", "--config", config, "--poses", str(folder / "rest.csv"), "--zero"]) == 0
    capsys.readouterr()
    out = ["--out", str(folder / "run.mcap"), "--csv", str(folder / "run.csv")]
    assert main(["sense", "beam", "--config", config, "--poses", poses, *out, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["frames"] == 5
    assert result["reasons"] == {"ok": 4, "saturated": 1}
    assert result["max"]["fy_N"] == pytest.approx(1.5, abs=0.01)
    header = (folder / "run.csv").read_text().splitlines()[0]
    assert header.startswith(",".join(("t_s", "valid", "reason", *AXES)))
    wrenches = read_wrench_table(folder / "run.csv")
    assert [w.reason for w in wrenches] == [Reason.OK] * 4 + [Reason.SATURATED]
    assert [float(w.force_N[1]) for w in wrenches[:4]] == pytest.approx([0, 0.5, 1.0, 1.5], abs=0.01)
    from mcap_ros2.reader import read_ros2_messages

    sent = [m.ros_msg for m in read_ros2_messages(folder / "run.mcap", topics=["/beam/wrench"])]
    assert len(sent) == 5
    assert sent[2].wrench.force.y == pytest.approx(1.0, abs=0.01)
    assert np.isnan(sent[4].wrench.force.y)


def test_a_template_that_the_zero_lacks_is_named(folder, capsys):
    rest = folder / "rest.csv"
    lines = rest.read_text(encoding="utf-8").splitlines(keepends=True)
    rest.write_text("".join(line for line in lines if ",tip," not in line), encoding="utf-8")
    words = ["sense", "beam", "--config", str(folder / "sensor.yaml"), "--poses", str(rest), "--zero"]
    assert main(words) == 0
    told = "".join(capsys.readouterr())
    assert "tip was not visible in half of the frames" in told
    assert "middle was not" not in told


def test_loads_become_a_calibration(folder, capsys):
    loads = np.vstack([np.diag([2, 1, 1, 0.05, 0.1, 0.1]) * fraction for fraction in (-1, -0.5, 0, 0.5, 1)])
    read = loads * 1.03 + np.random.default_rng(2).normal(0, 1e-4, loads.shape)
    names = [*AXES, *(f"read_{name}" for name in AXES)]
    rows = [",".join(names)] + [",".join(f"{v:.9g}" for v in row) for row in np.hstack([loads, read])]
    (folder / "loads.csv").write_text("\n".join(rows) + "\n")
    words = ["calibrate", "beam", str(folder / "loads.csv"), "--beam", str(folder / "beam.yaml")]
    assert main([*words, "--out", str(folder / "new.yaml"), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["rows"] == 30
    beam, correction = load_beam(folder / "new.yaml")
    assert beam == Beam()
    assert np.diag(correction.matrix) == pytest.approx(np.full(6, 0.03), abs=2e-3)
    assert main([*words, "--xi", "3"]) == 2
    assert "--xi: found 3, expected 0.05 to 1" in capsys.readouterr().err
    (folder / "loads.csv").write_text("\n".join(rows[:5]) + "\n")
    assert main(words) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_poses_survive_the_file(folder):
    frames = list(read_template_poses(folder / "push.csv"))
    assert [t_s for t_s, _ in frames] == pytest.approx(1 + np.arange(5) / 30)
    lost = TemplateMeasurement.missing("tip", Reason.OCCLUDED)
    write_template_poses(folder / "again.csv", [(0.0, [*frames[0][1][:2], lost])])
    ((_, templates),) = read_template_poses(folder / "again.csv")
    assert templates[0].T_camera_template.matrix == pytest.approx(
        frames[0][1][0].T_camera_template.matrix, abs=1e-14
    )
    assert templates[0].covariance == pytest.approx(frames[0][1][0].covariance)
    assert templates[2].reason is Reason.OCCLUDED


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("tip,true", "tip,maybe", "valid: found 'maybe', expected true or false"),
        ("tip,true,ok", "tip,true,fine", "reason: found 'fine', expected one of ok"),
        ("t_s,name", "time,name", "header: found columns time"),
        ("tip,true,ok,", "tip,true,ok,far", "x_m: found 'far"),
    ],
)
def test_bad_poses_are_told_by_line(folder, old, new, text):
    path = folder / "push.csv"
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(InputError, match=text):
        list(read_template_poses(path))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("fx,fy\n1,2\n", "missing: fz_n.*; give fx_N"),
        ("", "is empty"),
        ("fx,fy,fz,tx,ty,tz,x,y,z,roll,pitch,yaw\n" + ",".join("0" * 12) + "\n", "unit of roll, pitch, yaw"),
        ("fx,fy,fz,tx,ty,tz,x,y,z,rx_rad,ry_rad,rz_rad\n0,0,0,0,0,0,0,0,0,0,0,90\n", "angle of 90 rad"),
        (
            "fx,fy,fz,tx,ty,tz,x,y,z,rx_rad,ry_rad,rz_rad\n0,0,0,0,0,0,0,0,0,0,0,x\n",
            "line 2, rz_rad: found 'x'",
        ),
        ("fx,fx\n1,2\n", "found a column name twice"),
    ],
)
def test_bad_loads_are_told(tmp_path, text, message):
    (tmp_path / "loads.csv").write_text(text)
    with pytest.raises(CalibrationError, match=message):
        read_loads(tmp_path / "loads.csv")


def test_a_beam_survives_its_file(tmp_path):
    beam = Beam(length_m=0.15, diameter_m=0.002)
    places = np.array([1.0, 0.02, 0.03, 1.0, 0.1, 0.2])
    save_beam(tmp_path / "beam.yaml", beam, replace(prior_correction(beam), place_left=places))
    again, correction = load_beam(tmp_path / "beam.yaml")
    assert again == beam
    assert correction.row_covariance == pytest.approx(prior_correction(beam).row_covariance)
    assert correction.place_left == pytest.approx(places)
    for text, message in (
        ("beam: {length: 1}", r"beam\.length: unknown field"),
        ("beam: {length_m: -1}", r"beam\.length_m: found -1, expected a positive number"),
        ("calibration: {matrix: [[1]], row_covariance: []}", "calibration.matrix"),
    ):
        (tmp_path / "beam.yaml").write_text(text)
        with pytest.raises(InputError, match=message):
            load_beam(tmp_path / "beam.yaml")


def test_a_bad_configuration_names_its_field(folder):
    path = folder / "sensor.yaml"
    text = path.read_text()
    for old, new, message in (
        ("xi: 0.5", "xi: 1.5", r"templates\.0\.xi"),
        ("name: tip", "name: middle", "templates: found a name twice"),
        ("kind: beam", "kind: foam", "kind"),
        ("name: tip", "name: reference", "both the reference and on the rod"),
    ):
        path.write_text(text.replace(old, new))
        with pytest.raises(InputError, match=message):
            BeamSensorConfig.load(path)


def test_turns_are_read_as_they_are_named(tmp_path):
    """A quarter turn about X, then one about Z, is a third of a turn about (1, 1, 1)."""
    rows = {
        "roll_deg,pitch_deg,yaw_deg": "90,0,90",
        "roll_rad,pitch_rad,yaw_rad": f"{np.pi / 2},0,{np.pi / 2}",
        "rx_rad,ry_rad,rz_rad": ",".join(3 * [f"{2 * np.pi / 3 / np.sqrt(3)}"]),
    }
    for header, cells in rows.items():
        path = tmp_path / "loads.csv"
        path.write_text(f"{','.join(AXES)},x_m,y_m,z_m,{header}\n1,0,0,0,0,0,0.001,0.002,0.003,{cells}\n")
        found = read_loads(path)
        assert found.observed[0, :3] == pytest.approx([1e-3, 2e-3, 3e-3])
        assert found.observed[0, 3:] == pytest.approx(np.full(3, 2 * np.pi / 3 / np.sqrt(3)), rel=1e-6)
