"""The calibrate command from CSV to file and plot."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import pytest

from visuohaptic.cli._arguments import Add
from visuohaptic.cli.verbs.sensing import calibrate_foam as command
from visuohaptic.core import CalibrationError, InputError
from visuohaptic.sensing.foam.material import FoamMaterial, contour_force

#: Of the strip that the calibrations are for.
SIZE = ("--width", "0.02", "--height", "0.01")


def run(*arguments):
    parser = argparse.ArgumentParser()
    command.add_arguments(Add(parser))
    lines: list[str] = []
    args = parser.parse_args([*SIZE, *(str(a) for a in arguments)])
    args.report = lines.append
    return command.run(args), lines


@pytest.fixture
def press(tmp_path, reference_law):
    rng = np.random.default_rng(0)
    up = np.linspace(0, 0.6, 80)
    rows = []
    for _ in range(3):
        rows += [f"{x},{reference_law.stress(x) + rng.normal(0, 80)},loading" for x in up]
        rows += [f"{x},{reference_law.stress(x) * (0.5 + 0.5 * x / 0.6)},unloading" for x in up[::-1]]
    path = tmp_path / "press.csv"
    path.write_text("strain,stress_Pa,direction\n" + "\n".join(rows), encoding="utf-8")
    return path


def test_from_press_log_to_file_and_picture(tmp_path, press, material, reference_law):
    s = np.linspace(0, 0.25, 500)
    rows = []
    for depth in (0.003, 0.005, 0.007):
        delta = depth * np.exp(-(((s - 0.125) / 0.015) ** 2))
        enlarged, relief = contour_force(s, delta, material)
        rows += [f"{depth},{enlarged - 0.3 * relief},{a},{b}" for a, b in zip(s, delta, strict=True)]
    plate = tmp_path / "plate.csv"
    plate.write_text("depth_m,force_N,s_m,delta_m\n" + "\n".join(rows), encoding="utf-8")
    out, picture = tmp_path / "foam.yaml", tmp_path / "foam.png"
    result, lines = run(press, "--out", out, "--plate", plate, "--plot", picture)
    assert json.loads(json.dumps(result)) == result
    assert result["tension_calibrated"]
    # The noise of the press log (80 Pa over 240 points) moves a correction of 2 % of the force.
    assert result["tension_ratio"] == pytest.approx(0.3, abs=0.15)
    up = np.linspace(0, 0.6, 500)
    stress = reference_law.stress(up)
    loss = 1 - np.trapezoid(stress * (0.5 + 0.5 * up / 0.6), up) / np.trapezoid(stress, up)
    assert result["hysteresis_loss"] == pytest.approx(loss, abs=0.01)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert FoamMaterial.load(out).unloading is not None
    assert any("working range: strain 0." in line for line in lines)


def test_hysteresis_without_unloading_points_is_not_called_zero(tmp_path, press):
    loading = [line for line in Path(press).read_text().splitlines() if not line.endswith("unloading")]
    table = tmp_path / "loading.csv"
    table.write_text("\n".join(loading))
    result, lines = run(table, "--out", tmp_path / "foam.yaml")
    assert result["points_unloading"] == 0
    assert any(line.startswith("hysteresis: not measured") for line in lines)
    # Without their directions, appended presses seem to be unloaded by the step between them.
    table.write_text("\n".join(line.rpartition(",")[0] for line in loading))
    result, lines = run(table, "--out", tmp_path / "foam.yaml")
    assert (result["presses"], result["points_unloading"]) == (3, 2)
    assert any(line.startswith("hysteresis: not measured") for line in lines)
    _, lines = run(press, "--out", tmp_path / "foam.yaml")
    assert any("of the work of loading is lost" in line for line in lines)


@pytest.mark.parametrize("section", ["trapezoid", "triangle"])
def test_sections_and_cubic(tmp_path, press, section):
    out = tmp_path / "foam.yaml"
    result, _ = run(press, "--out", out, "--section", section, "--curve", "cubic", "--width", 0.03)
    assert result["curve"] == "cubic"
    material = FoamMaterial.load(out)
    assert material.section == section
    assert material.width_m == pytest.approx(0.03)


def test_refusals_leave_no_file(tmp_path, press):
    bad = tmp_path / "bad.csv"
    bad.write_text(
        "strain,stress_Pa\n" + "\n".join(f"{x},{1e3 * np.sin(5 * x)}" for x in np.linspace(0, 0.6, 50))
    )
    with pytest.raises(CalibrationError, match="unsuitable"):
        run(bad, "--out", tmp_path / "foam.yaml")
    with pytest.raises(InputError, match=r"found suffix '\.xyz', expected \.png, \.pdf or \.svg"):
        run(press, "--out", tmp_path / "foam.yaml", "--plot", tmp_path / "foam.xyz")
    assert not (tmp_path / "foam.yaml").exists()


@pytest.mark.parametrize("missing", ["--width", "--height"])
def test_the_size_of_the_strip_has_no_default(press, missing, capsys):
    parser = argparse.ArgumentParser()
    command.add_arguments(Add(parser))
    other = "--height" if missing == "--width" else "--width"
    with pytest.raises(SystemExit):
        parser.parse_args([str(press), other, "0.02"])
    assert missing in capsys.readouterr().err


def test_the_size_of_the_strip_is_printed_and_returned(tmp_path, press):
    result, lines = run(press, "--out", tmp_path / "foam.yaml", "--width", 0.04, "--height", 0.05)
    assert (result["width_m"], result["height_m"]) == pytest.approx((0.04, 0.05))
    assert any("width 40 mm" in line and "height 50 mm" in line for line in lines)
