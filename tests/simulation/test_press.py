"""The simulated press against the law and against the continuum's figures."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.simulation.foam import (
    REFERENCE_FOAM,
    SOFT_FOAM,
    FoamStripGeometry,
    PressShape,
    calibration_press,
    press,
    press_outline,
    press_path,
)

COARSE = FoamStripGeometry(spacing_m=0.001)


@pytest.mark.parametrize("shape", list(PressShape))
def test_every_shape_loads_and_unloads(shape: PressShape) -> None:
    samples = list(press(shape, press_path(0.006, 3), geometry=COARSE))
    force = np.array([x.force_N for x in samples])
    assert [x.direction for x in samples] == ["loading"] * 4 + ["unloading"] * 3
    assert force[0] == pytest.approx(0.0, abs=1e-6)
    assert (np.diff(force[:4]) > 0).all()
    assert (np.diff(force[3:]) < 0).all()
    assert (force[4:6] < force[1:3][::-1]).all(), "hysteresis: less force on the way back"
    deepest = samples[3]
    assert deepest.strip.delta_m.max() == pytest.approx(0.006, abs=2e-5)
    assert deepest.scene.front_m.shape == deepest.scene.back_m.shape
    assert deepest.scene.objects[0].outline_foam_m[:, 0].min() == pytest.approx(0.014, abs=1e-4)


def test_continuum_figures() -> None:
    """Force at 6 mm as the continuum has it: 4.090 N (plate), 3.519 N (12 cm cylinder); 2.5 % and 1.2 %."""
    for shape, force, tolerance in (
        (PressShape.PLATE_4CM, 4.090, 0.025),
        (PressShape.CYLINDER_12CM, 3.519, 0.012),
    ):
        *_, last = press(shape, [0.006], geometry=FoamStripGeometry(), law=REFERENCE_FOAM)
        assert last.force_N == pytest.approx(force, rel=tolerance)


def test_calibration_is_the_law() -> None:
    rows = calibration_press(geometry=COARSE, steps=12, runs=1)
    up = np.array([(e, s) for e, s, d in rows if d == "loading"])
    down = np.array([(e, s) for e, s, d in rows if d == "unloading"])
    assert up[:, 1] == pytest.approx(SOFT_FOAM.uniaxial(up[:, 0]), rel=1e-4, abs=0.1)
    assert down[:, 1] == pytest.approx(SOFT_FOAM.uniaxial(down[:, 0], "unloading"), rel=1e-4, abs=0.5)


def test_reference_sensor_is_noisy_and_repeatable() -> None:
    def read(sigma_N: float, seed: int) -> np.ndarray:
        rng = np.random.default_rng(seed)
        rows = calibration_press(geometry=COARSE, steps=12, runs=1, reference_sigma_N=sigma_N, rng=rng)
        return np.array([stress_Pa for _, stress_Pa, _ in rows]) * COARSE.length_m * COARSE.height_m

    noise = np.concatenate([read(0.15, seed) - read(0.0, seed) for seed in range(8)])
    assert (read(0.15, 1) == read(0.15, 1)).all()
    # Standard error of a sigma from 200 samples is 5 %; four of them.
    assert len(noise) == 200
    assert np.std(noise) == pytest.approx(0.15, rel=0.2)


def test_outline_and_path() -> None:
    outline = press_outline(PressShape.PLATE_4CM, 0.003, centre_m=0.02)
    assert outline.polygon_m()[:, 0].min() == pytest.approx(0.017)
    assert press_path(0.01, 2, runs=2).tolist() == [0, 0.005, 0.01, 0.005, 0] * 2
    with pytest.raises(InputError, match="expected a depth > 0"):
        press_path(-1.0, 3)
    with pytest.raises(InputError, match=r"at most 0\.0180 m"):
        list(press(PressShape.LARGE_PLATE, [0.05]))
