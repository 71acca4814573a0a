"""Published compressions: files in the format of the data set are read in SI units, and learned."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from visuohaptic.cli.main import main
from visuohaptic.core.errors import InputError
from visuohaptic.recognition import UNKNOWN, HapticClassifier, read_compressions

HEAD = (
    "ID_Number,c4_base,c8_base,c4_top,c8_top,twist_linear,twist_amplitude,twist_period,perimeter_ratio,height,mass,thickness,"
    "material"
)


def written(folder: Path, count: int = 12, *, forces: bool = True) -> Path:
    """Prints of two materials, the second half as stiff as the first and compressed by two thirds as much."""
    rng = np.random.default_rng(5)
    designs, ways, curves = [HEAD], ["ID_Number,Displacement"], ["ID," + ",".join(map(str, range(100)))]
    for k in range(count):
        soft, height = k % 2, float(rng.uniform(15, 25))
        way = (0.9 - 0.3 * soft) * height * float(np.exp(0.03 * rng.standard_normal()))
        slope = (300.0 - 150.0 * soft) * float(np.exp(0.1 * rng.standard_normal()))  # [N/mm]
        designs.append(f"{k},0.5,0,0.5,0,0,0,0,1.5,{height},2.5,0.6,{('hard', 'soft')[soft]}")
        ways.append(f"{k},{way}")
        force = slope * np.linspace(0, way, 100) + 0.1 * rng.standard_normal(100)
        curves.append(f"{k}," + ",".join(f"{value:.4f}" for value in force))
    tables = {"parameters": designs, "displacements": ways} | ({"forces": curves} if forces else {})
    for name, lines in tables.items():
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def test_a_print_is_read_in_si_units_and_its_curve_becomes_a_stiffness(tmp_path: Path) -> None:
    first, *others = read_compressions(written(tmp_path))
    assert len(others) == 11
    assert (first.name, first.material) == ("0", "hard")
    assert (first.thickness_m, first.mass_kg) == pytest.approx((6e-4, 2.5e-3))
    assert first.design == pytest.approx([0.5, 0, 0.5, 0, 0, 0, 0, 1.5, first.height_m])
    assert 0.015 < first.height_m < 0.025
    thickness, way, weight, curve = first.readings()
    assert (thickness.width_m, way.width_m) == pytest.approx((6e-4, first.displacement_m))
    assert {one.object_height_m for one in first.readings()} == {first.height_m}
    assert weight.sides[0] is not None
    assert curve.sides[0] is not None
    assert first.force_N is not None
    assert weight.sides[0].i_N_per_m == pytest.approx(2.5e-3 * 9.80665 / first.height_m)
    assert curve.sides[0].i_N_per_m == pytest.approx(3e5, rel=0.35)
    # Slope of the forces as they were written, by another method.
    wanted = np.polyfit(np.linspace(0, first.displacement_m, 100), first.force_N, 1)[0]
    assert curve.sides[0].I_N_per_m == pytest.approx(wanted, rel=0.01)


def test_a_copy_without_forces_has_no_curves(tmp_path: Path) -> None:
    prints = read_compressions(written(tmp_path, forces=False))
    assert {one.force_N is None for one in prints} == {True}
    assert [len(one.readings()) for one in prints] == [3] * 12
    model = HapticClassifier().fit([one.squeezed() for one in prints]).model()
    assert model.answers == ("hard", "soft", UNKNOWN)


def test_materials_are_learned_from_a_folder_and_a_print_of_another_is_classified(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, count in (("learned", 12), ("asked", 14)):
        (tmp_path / name).mkdir()
        written(tmp_path / name, count)
    tree, asked = str(tmp_path / "tree.json"), str(tmp_path / "asked")
    assert main(["classify", "train", str(tmp_path / "learned"), "--out", tree, "--json"]) == 0
    trained = json.loads(capsys.readouterr().out)
    assert trained["classes"] == ["hard", "soft"]
    assert (trained["objects"], trained["touches"]) == (12, 48)
    for name, material in (("12", "hard"), ("13", "soft")):
        assert main(["classify", "run", tree, asked, "--object", name, "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["answer"] == material
    assert main(["classify", "run", tree, asked, "--object", "99"]) == 2
    assert "found '99', expected one of the 14 prints" in capsys.readouterr().err
    assert main(["classify", "run", tree, "--ask", "--object", "12"]) == 2
    assert "expected a folder of compressions" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("parameters", "\n3,", "\n33,", r"parameters.csv.*line 5, ID_Number.*'33', which is not in displacements"),
        ("parameters", "2.5,0.6,hard", "0,0.6,hard", r"line 2, mass.*found 0, expected more than 0"),
        ("parameters", "hard", "", r"line 2, material.*found no material"),
        ("parameters", "perimeter_ratio", "taper", r"missing: perimeter_ratio"),
        ("forces", "\n3,", "\n3,1.0,", r"forces.csv.*line 5.*expected a print and 100 finite forces"),
        ("forces", "\n3,", "\n3,nan", r"forces.csv.*line 5.*expected a print and 100 finite forces"),
        ("forces", "\n3,", "\n33,", r"'3', which is not in forces.csv"),
    ],
)  # fmt: skip
def test_damaged_files_are_refused_with_their_line(
    tmp_path: Path, name: str, old: str, new: str, message: str
) -> None:
    path = written(tmp_path) / f"{name}.csv"
    path.write_text(path.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_compressions(tmp_path)


def test_a_force_that_falls_is_no_compression(tmp_path: Path) -> None:
    path = written(tmp_path) / "forces.csv"
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[1] = "0," + ",".join(str(-k) for k in range(100))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"forces.csv.*print 0.*expected a force that rises"):
        read_compressions(tmp_path)[0].readings()
