"""foam.yaml: a round trip, and invalid files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml

from visuohaptic.core import InputError
from visuohaptic.sensing.foam.material import FoamMaterial, HysteresisLaw, StressCurve, Tension

STRAIN = np.linspace(-0.1, 0.7, 50)


def test_round_trip(tmp_path, material):
    full = replace(
        material,
        unloading=material.loading,
        unloading_peak_strain=0.6,
        hysteresis=HysteresisLaw(np.array([0.01, 0.1]), np.array([0.1, 0.0]), np.array([0.0, 80.0]), 0.3),
        tension=Tension(0.3, 0.05, True, 0.2, 0.1),
        section="trapezoid",
    )
    full.save(tmp_path / "foam.yaml")
    back = FoamMaterial.load(tmp_path / "foam.yaml")
    for name in ("stress", "slope", "stress_sigma"):
        np.testing.assert_array_equal(getattr(back, name)(STRAIN), getattr(full, name)(STRAIN))
    for name in (
        "width_m",
        "height_m",
        "working_strain",
        "densification_strain",
        "residual_Pa",
        "tension",
        "section",
    ):
        assert getattr(back, name) == getattr(full, name)
    np.testing.assert_array_equal(back.unloading.stress(STRAIN), full.unloading.stress(STRAIN))
    assert back.hysteresis.relative_sigma == pytest.approx(0.3)
    for name in ("yield_strain", "fraction", "stress_Pa"):
        np.testing.assert_array_equal(getattr(back.hysteresis, name), getattr(full.hysteresis, name))
    np.testing.assert_array_equal(back.narrow.covariance, full.narrow.covariance)


def test_stress_stays_physical(material):
    assert np.all(material.stress(np.array([-0.5, 0.0])) == 0.0)
    stress = material.stress(np.linspace(0, 0.99, 500))
    assert np.all(np.diff(stress) > 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width_m": -1}, "width_m"),
        ({"surprise": 1}, "surprise: unknown field"),
        ({"format": "other"}, "format"),
        ({"working_strain": [0.5, 0.1]}, "expected 0 <= low < high"),
        ({"residual_Pa": float("nan")}, "residual_Pa"),
        ({"hysteresis": {"yield_strain": [0.1], "fraction": [0.1]}}, "hysteresis"),
        (
            {
                "hysteresis": {
                    "yield_strain": [0.1],
                    "fraction": [-1],
                    "stress_Pa": [0],
                    "relative_sigma": 0.1,
                }
            },
            "fraction and stress_Pa must be >= 0",
        ),
        ({"tension": {"ratio": 9, "sigma": 0}}, "tension.ratio"),
        (
            {
                "loading": {
                    "kind": "cubic",
                    "knots": [0, 0.5],
                    "parameters_Pa": [1] * 80,
                    "covariance_Pa2": [[1]],
                }
            },
            "loading",
        ),
        (
            {
                "loading": {
                    "kind": "cubic",
                    "knots": [0, 0.6],
                    "parameters_Pa": [-1e4, 0, 0],
                    "covariance_Pa2": [[0] * 3] * 3,
                }
            },
            "not rising everywhere",
        ),
        (
            {
                "loading": {
                    "kind": "cubic",
                    "knots": [0, 0.6],
                    "parameters_Pa": [1e4, 0, 0],
                    "covariance_Pa2": [[1, 5, 0], [5, 1, 0], [0, 0, 1]],
                }
            },
            "is not symmetric and positive",
        ),
        (
            {
                "loading": {
                    "kind": "cubic",
                    "knots": [0.1, 0.6],
                    "parameters_Pa": [1e4, 0, 0],
                    "covariance_Pa2": [[0] * 3] * 3,
                }
            },
            "knots must rise",
        ),
    ],
)
def test_damaged_files_are_refused(tmp_path, material, change, message):
    path = tmp_path / "foam.yaml"
    material.save(path)
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    path.write_text(yaml.safe_dump({**data, **change}), encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        FoamMaterial.load(path)
    assert "foam.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_curve_of_wrong_size_is_refused():
    with pytest.raises(InputError, match="expected 3 for a cubic"):
        StressCurve("cubic", np.array([0.0, 0.5]), np.ones(4), np.eye(4))
