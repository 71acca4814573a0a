"""The zero: averaging, refusal, file, drift."""

from __future__ import annotations

import numpy as np
import pytest
from tests.sensing.beam.pose_noise import noisy_pose

from visuohaptic.core import CalibrationError, InputError
from visuohaptic.sensing.beam import BeamDriftSettings, BeamZero, BeamZeroWatch, TemplateMeasurement
from visuohaptic.sensing.beam.zero import _refuse_motion


def shaken(templates, rng):
    return [
        TemplateMeasurement(t.name, noisy_pose(t.T_camera_template, t.covariance, rng), t.covariance)
        for t in templates
    ]


def test_the_mean_is_as_good_as_it_says(bench):
    rng = np.random.default_rng(1)
    zero = bench.sensor(rng).zero_reference
    assert zero.frames == 100
    rest = bench.sensor().zero_reference.rest
    errors = [
        np.abs(a.translation_m - b.translation_m) for a, b in zip(zero.rest.poses, rest.poses, strict=True)
    ]
    sigma = np.sqrt(np.diag(zero.rest.covariance)).reshape(-1, 6)[:, :3]
    assert (np.array(errors) < 4 * sigma).all()
    assert sigma.max() < 1e-5


def test_a_steady_reference_does_not_average_out_twice(make_bench):
    # 100 frames of everything: the relative poses are as good as with a moving reference.
    moving = make_bench().sensor(np.random.default_rng(1)).zero_reference
    steady = make_bench(view="steady").sensor(np.random.default_rng(1)).zero_reference
    ratio = np.diag(steady.rest.covariance) / np.diag(moving.rest.covariance)
    assert ratio == pytest.approx(np.ones(12), rel=0.35)


def test_a_rod_that_moves_while_zeroing_is_refused(bench):
    rng = np.random.default_rng(2)
    frames = [(k / 30, shaken(bench.templates([0, 2e-3 * k, 0, 0, 0, 0]), rng)) for k in range(40)]
    with pytest.raises(
        CalibrationError, match=r"moved while zeroing: .* (um|mdeg), expected below .* (um|mdeg); zero while"
    ):
        bench.sensor().zero(frames)


def test_noise_that_is_not_declared_is_no_motion_but_a_creep_in_it_is():
    """Compressed video scatters by twice the declared deviation and more: so do the means of the halves."""
    rng = np.random.default_rng(4)
    sigma = np.tile([2e-5, 2e-5, 2e-5, 4e-4, 4e-4, 4e-4], 2)
    for _ in range(200):
        _refuse_motion(["a", "b"], 2.2 * sigma * rng.standard_normal((30, 12)), np.diag(sigma**2))
    # Two deviations between the means of the halves are nothing, six are a creep.
    ramp = sigma * np.linspace(-1.0, 1.0, 30)[:, None]
    _refuse_motion(["a", "b"], 2 * ramp + 0.2 * sigma * rng.standard_normal((30, 12)), np.diag(sigma**2))
    with pytest.raises(CalibrationError, match="moved while zeroing"):
        _refuse_motion(["a", "b"], 6 * ramp + 0.2 * sigma * rng.standard_normal((30, 12)), np.diag(sigma**2))


@pytest.mark.parametrize(
    ("sigma", "shape", "inside", "outside"),
    [
        # From frame to frame: four declared deviations of 0.1 mm; or 20 um and 30 mdeg, whatever is declared.
        (1e-4, np.tile([1.0, -1.0], 32), 3.8e-4, 4.2e-4),
        (1e-9, np.tile([1.0, -1.0], 32), 1.9e-5, 2.1e-5),
        # From one half to the other: two and a half deviations of a frame.
        (1e-4, np.repeat([0.5, -0.5], 32), 2.4e-4, 2.6e-4),
    ],
)
def test_a_zero_is_refused_beyond_its_limit(sigma, shape, inside, outside):
    # Angles have the same deviations, times 25 rad/m.
    units = np.tile([1.0, 1.0, 1.0, 25.0, 25.0, 25.0], 2)
    for axis in (1, 9):
        for size, moved in ((inside, False), (outside, True)):
            scatter = np.outer(size * shape, units * (np.arange(12) == axis))
            try:
                _refuse_motion(["a", "b"], scatter, np.diag((sigma * units) ** 2))
                said = ""
            except CalibrationError as error:
                said = str(error)
            assert ("moved while zeroing" in said) is moved, (axis, size)


def test_a_hidden_template_is_left_out_and_no_template_is_refused(bench):
    still = bench.templates(np.zeros(6))
    partly = [(k / 30, [*still[:2], TemplateMeasurement.missing("tip")]) for k in range(10)]
    assert bench.sensor().zero(partly).rest.names == ("middle",)
    with pytest.raises(CalibrationError, match="no frame shows the reference template"):
        bench.sensor().zero([(0.0, [TemplateMeasurement.missing("reference"), *still[1:]])])


def test_the_file_holds_it_all(bench, tmp_path):
    zero = bench.sensor(np.random.default_rng(3)).zero_reference
    zero.save(tmp_path / "zero.yaml")
    again = BeamZero.load(tmp_path / "zero.yaml", ["middle", "tip"])
    assert again.frames == zero.frames
    for a, b in zip(again.rest.poses, zero.rest.poses, strict=True):
        assert a.matrix == pytest.approx(b.matrix, abs=1e-10)
    sigma = np.sqrt(np.diag(zero.rest.covariance))
    assert np.abs((again.rest.covariance - zero.rest.covariance) / np.outer(sigma, sigma)).max() < 1e-5
    with pytest.raises(InputError, match="the sensor has top; zero again"):
        BeamZero.load(tmp_path / "zero.yaml", ["top"])
    text = (tmp_path / "zero.yaml").read_text().replace("frames: 100", "frames: 0")
    (tmp_path / "zero.yaml").write_text(text)
    with pytest.raises(InputError, match="frames"):
        BeamZero.load(tmp_path / "zero.yaml", ["middle", "tip"])


def test_slow_drift_is_followed_and_a_large_one_is_told():
    scale = np.full(6, 3.0)
    watch = BeamZeroWatch(scale, BeamDriftSettings(time_constant_s=2.0))
    sigma = np.full(6, 1e-3)
    for k in range(1200):  # 40 s, 1 mN per second
        watch.update(k / 30, np.full(6, k / 30 * 1e-3), sigma)
    assert watch.offset == pytest.approx(np.full(6, 0.040 - 2e-3), abs=1e-3)  # lags by rate x time constant
    assert not watch.drifted
    for k in range(1200, 2400):
        watch.update(k / 30, np.full(6, k / 30 * 1e-3), sigma)
    assert watch.drifted  # 2 % of 3 N are 60 mN


def test_a_load_is_no_drift():
    watch = BeamZeroWatch(np.full(6, 3.0), BeamDriftSettings(time_constant_s=1.0))
    for k in range(600):
        watch.update(k / 30, np.array([0, 0.1, 0, 0, 0, 0]), np.full(6, 1e-3))
    assert not watch.offset.any()
