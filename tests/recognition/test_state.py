from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.deformation.nonlinear import Contents
from visuohaptic.deformation.shapes import load_container
from visuohaptic.recognition.data import TouchReading, fit_curve
from visuohaptic.recognition.touch import (
    HapticStateModel,
    StateCurve,
    fit_state_model,
    load_state_model,
    save_state_model,
    simulate_state_curves,
    state_features,
    state_probability,
)
from visuohaptic.recognition.touch.state import _gaussians


def _curves(bend: float, place: str) -> list[StateCurve]:
    d = np.linspace(0.001, 0.008, 8)
    out = []
    for variant, factor in enumerate(np.linspace(0.8, 1.2, 6)):
        for state, b in (("open", 0.0), ("closed", bend)):
            out.append(StateCurve(state, variant, place, d, factor * (3000 * d + b * d**2)))
    return out


def test_the_place_where_curves_bend_is_the_best(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    model = fit_state_model(_curves(2e5, "y+8") + _curves(1e3, "x+4"), rng)
    assert model.places[0] == "y+8"
    assert model.accuracy[0] > 0.97
    # Wall and modulus hide what bends by a hundredth of the noise.
    assert model.accuracy[1] < 0.7
    save_state_model(tmp_path / "state.json", model)
    again = load_state_model(tmp_path / "state.json")
    d = np.linspace(0.0005, 0.008, 30)
    for b, expected in ((0.0, "open"), (2e5, "closed")):
        fit = fit_curve(d, 3100 * d + b * d**2)
        found = state_probability(again, (TouchReading(8, "y", (None, fit)),))
        assert found["state"] == expected
        assert found["probabilities"][expected] > 0.9
    assert state_probability(again, ())["best_place"] == "y+8"


def test_the_covariance_of_few_variants_is_without_bias() -> None:
    """Twelve readings of two states: the mean of 2,000 estimates is known to 1 %, with another divisor it is 8 % off or more."""
    rng, truth = np.random.default_rng(4), np.array([[1.0, 0.3, 0.0], [0.3, 0.5, 0.1], [0.0, 0.1, 0.2]])
    states = np.repeat([0, 1], 6)
    draws = rng.multivariate_normal(np.zeros(3), truth, (2000, 12)) + 5.0 * states[:, None]
    found = np.mean([_gaussians(one, states, 2)[1] for one in draws], axis=0)
    np.testing.assert_allclose(found, truth, atol=0.03)


def test_the_third_feature_has_no_scale() -> None:
    a, b = state_features(1000, 1200, 0.3), state_features(2000, 2400, 0.6)
    np.testing.assert_allclose(b - a, [np.log(2), np.log(2), 0], atol=1e-12)


def test_simulated_curves_of_a_bottle_are_stiffer_closed() -> None:
    shell = load_container("isana").middle()
    curves = simulate_state_curves(
        shell, {"open": None, "closed": Contents()}, ["y+8"], variants=1, around=16
    )
    opened, closed = curves
    at = np.linspace(0.001, 0.004, 4)
    force = [np.interp(at, one.deformation_m, one.force_N) for one in (opened, closed)]
    assert (force[1] > 1.05 * force[0]).all()


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("accuracy", lambda rows: rows[:-1]),
        ("covariance", lambda rows: rows[:-1]),
        ("mean", lambda rows: rows[:-1]),
        ("mean", lambda rows: [row[:-1] for row in rows]),
        ("places", lambda rows: rows[:-1]),
        ("states", lambda rows: rows[:-1]),
        ("covariance", lambda rows: [[[-x for x in row] for row in one] for one in rows]),
    ],
)
def test_parts_of_a_state_model_that_do_not_belong_together(
    tmp_path: Path, field: str, change: Callable[[list[Any]], list[Any]]
) -> None:
    model = HapticStateModel(
        ("open", "closed"), ("y+8", "x+4"), np.zeros((2, 2, 3)), np.tile(np.eye(3), (2, 1, 1)), np.ones(2)
    )
    save_state_model(tmp_path / "state.json", model)
    assert load_state_model(tmp_path / "state.json").places == model.places
    content = json.loads((tmp_path / "state.json").read_text())
    content[field] = change(content[field])
    (tmp_path / "state.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"state\.json.*is not a state model: "):
        load_state_model(tmp_path / "state.json")


def test_bad_files_and_places(tmp_path: Path) -> None:
    (tmp_path / "state.json").write_text("{}")
    with pytest.raises(InputError, match="is not a state model"):
        load_state_model(tmp_path / "state.json")
    with pytest.raises(InputError, match="expected at least 2"):
        fit_state_model(_curves(1.0, "y+8")[::2], np.random.default_rng(0))
    with pytest.raises(InputError, match="found 'z9'"):
        simulate_state_curves(load_container("cup").middle(), {"open": None}, ["z9"], variants=1, around=16)
