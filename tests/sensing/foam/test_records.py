"""CSV files that are right, nearly right, and wrong."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import CalibrationError
from visuohaptic.sensing.foam.material import read_plate, read_strain_stress
from visuohaptic.sensing.foam.material.records import direction_from_order


def write(tmp_path, text):
    path = tmp_path / "press.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "text",
    [
        "strain,stress_Pa,direction\n0,0,loading\n0.1,2500,loading\n",
        "strain;stress_kPa\n0;0\n0.1;2.5\n",
        "\ufeffDirection, Stress_MPa, Strain_percent\nup,0,0\n# a remark\n\nloading,0.0025,10\n",
    ],
)
def test_variants_are_converted(tmp_path, text):
    data = read_strain_stress(write(tmp_path, text))
    np.testing.assert_allclose(data.strain, [0, 0.1])
    np.testing.assert_allclose(data.stress_Pa, [0, 2500])
    assert data.direction.tolist() == [1, 1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("strain,stress_Pa\n", "has a header but no rows"),
        ("0,0,loading\n0.1,5,loading\n", r"header: found numbers"),
        ("0,0\n0.1,5\n", r"header: found numbers, expected a header"),
        ("strain,force_N\n0,0\n", "expected one of stress, stress_pa, stress_kpa, stress_mpa for the stress"),
        ("strain,stress_Pa\n0,0\n0.1\n", "line 3: found 1 fields, expected 2"),
        ("strain,stress_Pa\n0,zero\n", "line 2, stress_pa: found 'zero', expected a number"),
        ("strain,stress_Pa\n0,nan\n", "line 2, stress_pa: found 'nan'"),
        ("strain,stress_Pa\n0,0\n0.3,5\n", "stress_pa: found at most 5 Pa.*name the column stress_kPa"),
        ("strain,stress_Pa\n0,0\n10,5\n", "line 3, strain: found strain 10.*name the column strain_percent"),
        ("strain,stress_Pa,direction\n0,0,left\n", "line 2, direction: found 'left'"),
        ("strain,stress_Pa,stress_kPa\n0,0,0\n", "expected one of stress, stress_pa"),
        ("strain,strain\n0,0\n", "column name twice"),
    ],
)
def test_wrong_files_are_refused_with_the_line(tmp_path, text, message):
    with pytest.raises(CalibrationError, match=message) as caught:
        read_strain_stress(write(tmp_path, text))
    assert "press.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_bare_stress_is_in_pascal_and_the_direction_may_be_spelled_out(tmp_path):
    text = "strain,stress,direction of loading\n0,0,loading\n0.1,500,loading\n0.05,100,unloading\n"
    data = read_strain_stress(write(tmp_path, text))
    assert data.stress_Pa.tolist() == [0.0, 500.0, 100.0]
    assert data.direction.tolist() == [1, 1, -1]


def test_missing_and_binary_files(tmp_path):
    with pytest.raises(CalibrationError, match="cannot be read"):
        read_strain_stress(tmp_path / "none.csv")
    path = tmp_path / "binary.csv"
    path.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(CalibrationError, match="is not UTF-8"):
        read_strain_stress(path)


def test_direction_follows_the_order_through_noise():
    rng = np.random.default_rng(0)
    up = np.linspace(0, 0.6, 200)
    strain = np.concatenate([up, up[::-1], up, up[::-1]]) + rng.normal(0, 0.003, 800)
    truth = np.repeat([1, -1, 1, -1], 200)
    # Only points within the noise of a turn may be taken for the other direction.
    wrong = np.flatnonzero(direction_from_order(strain) != truth)
    assert np.all(np.min(np.abs(wrong[:, None] - np.array([200, 400, 600])), axis=1) < 8)


def test_plate_records(tmp_path):
    rows = "".join(f"0.002,1.5,{0.001 * i},{0.0001 * i}\n" for i in range(12))
    (record,) = read_plate(write(tmp_path, "depth_m,force_N,s_m,delta_m\n" + rows))
    assert (record.depth_m, record.force_N, len(record.s_m)) == pytest.approx((0.002, 1.5, 12))
    with pytest.raises(CalibrationError, match="missing: delta_m"):
        read_plate(write(tmp_path, "depth_m,force_N,s_m\n1,1,1\n"))
    with pytest.raises(CalibrationError, match="found 1 points"):
        read_plate(write(tmp_path, "depth_m,force_N,s_m,delta_m\n0.002,1,0,0\n"))
    with pytest.raises(CalibrationError, match="one positive force_N"):
        read_plate(
            write(
                tmp_path, "depth_m,force_N,s_m,delta_m\n" + rows.replace("0.002,1.5,0.0,", "0.002,1.6,0.0,")
            )
        )
