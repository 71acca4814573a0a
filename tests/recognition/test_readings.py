from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm, truncnorm

from visuohaptic.core import InputError
from visuohaptic.deformation.maps import curve_coefficients
from visuohaptic.recognition.data import (
    CurveCoefficients,
    TouchNoise,
    TouchReading,
    check_curve,
    fit_curve,
    read_curves,
    stiffness_grid,
)
from visuohaptic.recognition.data.readings import _positive
from visuohaptic.recognition.data.spikes import without_spikes


def test_without_noise_the_coefficients_are_those_of_the_simulation() -> None:
    d = np.linspace(0.0005, 0.008, 16)
    f = 900 * d + 4e4 * d**2
    expected = curve_coefficients(d, f)
    found = fit_curve(d, f, TouchNoise(1e-9, 0.0))
    np.testing.assert_allclose((found.i_N_per_m, found.I_N_per_m, found.II), expected, rtol=1e-9)


@pytest.mark.parametrize(("linear", "bend"), [(900.0, 4e4), (3000.0, -6e4)])
def test_curvature_is_the_quadratic_coefficient_relative_to_that_of_a_line(
    linear: float, bend: float
) -> None:
    d = np.linspace(0.0005, 0.008, 16)
    found = fit_curve(d, linear * d + bend * d**2, TouchNoise(1e-9, 0.0))
    assert found.curvature[0] == pytest.approx(
        bend * 0.01 / ((linear * d + bend * d**2) @ d / (d @ d)), rel=1e-6
    )
    half = CurveCoefficients(linear, linear, 0.3, 0.01, 0.06).curvature
    assert half[1] == pytest.approx(0.2 * half[0])


@pytest.mark.parametrize("away", [-6.0, -1.0, 0.0, 0.5, 3.0, 9.0])
def test_a_compliance_is_the_mean_of_its_distribution_without_what_is_negative(away: float) -> None:
    sigma = 2e-4
    whole = truncnorm(-away, np.inf, loc=away * sigma, scale=sigma)
    stiffness, relative = _positive(away * sigma, sigma)
    assert stiffness == pytest.approx(1 / whole.mean(), rel=1e-6)
    assert relative == pytest.approx(whole.std() / whole.mean(), rel=1e-4)


@pytest.mark.parametrize("stiffness", [200.0, 3000.0, 20e3])
def test_noise_of_both_sensors_leaves_no_bias_and_sigma_is_true(stiffness: float) -> None:
    rng = np.random.default_rng(1)
    last = min(0.003, 20 / stiffness)
    d = np.linspace(last / 12, last, 12)
    fits = [
        fit_curve(d + rng.normal(0, 1e-4, 12), stiffness * d + rng.normal(0, 0.1, 12)) for _ in range(1500)
    ]
    relative = np.array([fit.i_N_per_m for fit in fits]) / stiffness - 1
    sigma = float(np.median([fit.i_relative_sigma for fit in fits]))
    # Three standard errors of the mean, and 1 % of second order.
    assert abs(relative.mean()) < 3 * relative.std() / np.sqrt(1500) + 0.012
    assert sigma == pytest.approx(relative.std(), rel=0.15)


def test_sigma_is_true_where_both_sensors_are_as_noisy_as_the_squeeze_is_small() -> None:
    rng, noise = np.random.default_rng(1), TouchNoise(0.5, 3e-4)
    d = np.linspace(0.0001, 0.0018, 24)
    fits = [
        fit_curve(
            d + rng.normal(0, noise.deformation_m, 24),
            1000 * d + rng.normal(0, noise.force_N, 24),
            noise,
            from_contact=True,
        )
        for _ in range(800)
    ]
    compliance = np.array([1 / fit.i_N_per_m for fit in fits])
    declared = np.array([fit.i_relative_sigma for fit in fits]) * compliance
    # A standard deviation over 800 draws has an error of 2.5 %; the rest is of second order in noise / signal.
    assert np.sqrt(np.mean(declared**2)) == pytest.approx(compliance.std(), rel=0.1)
    assert compliance.mean() == pytest.approx(1e-3, abs=0.2 * float(compliance.std()))


@pytest.mark.parametrize("noise", [TouchNoise(1e-3, 5e-5), TouchNoise(0.05, 1e-5)])
def test_the_quadratic_coefficient_has_no_bias_and_its_sigma_is_true(noise: TouchNoise) -> None:
    """Noise of the deformation counts by the slope of the curve, noise of the force by itself."""
    rng = np.random.default_rng(2)
    d = np.linspace(0.0005, 0.008, 40)
    f = 900 * d + 4e4 * d**2
    fits = [
        fit_curve(d + rng.normal(0, noise.deformation_m, 40), f + rng.normal(0, noise.force_N, 40), noise)
        for _ in range(800)
    ]
    found = np.array([fit.II for fit in fits])
    # Times (1 cm)^2 / 50 N; three standard errors of the mean, and 1 % of second order. A standard deviation over 800
    # draws has an error of 2.5 %; sigma takes one slope for the whole curve.
    assert found.mean() == pytest.approx(4e4 * 0.01**2 / 50, abs=3 * found.std() / np.sqrt(800) + 1e-3)
    assert np.median([fit.II_sigma for fit in fits]) == pytest.approx(found.std(), rel=0.15)


@pytest.mark.parametrize("stiffness", [2e5, 1e6, 1e9])
def test_what_hardly_moves_is_as_compliant_as_its_noise_lets_one_think(stiffness: float) -> None:
    """A compliance of Gaussian error that is known to be positive: its posterior mean, by another library's distribution."""
    rng = np.random.default_rng(2)
    f = np.linspace(20 / 6, 20, 6)
    d = f / stiffness
    fits = [
        fit_curve(d + rng.normal(0, 1e-4, 6), f + rng.normal(0, 0.1, 6), from_contact=True)
        for _ in range(1500)
    ]
    sigma = 1e-4 / np.sqrt(f @ f)
    # Expectation over the readings by quadrature: the trapezoidal rule converges geometrically on a Gaussian integrand.
    z = np.linspace(-7, 7, 141)
    weight = norm.pdf(z) / norm.pdf(z).sum()
    read = 1 / stiffness + sigma * z
    mean, var = (weight @ moment for moment in truncnorm.stats(-read / sigma, np.inf, read, sigma))
    found = np.array([1 / fit.i_N_per_m for fit in fits])
    # Three standard errors, and 2 % for the noise of the force, 0.1 of 12 N.
    assert found.mean() == pytest.approx(mean, rel=0.02, abs=3 * float(found.std()) / np.sqrt(1500))
    variance = np.array([(fit.i_relative_sigma / fit.i_N_per_m) ** 2 for fit in fits])
    assert variance.mean() == pytest.approx(var, rel=0.08)


def test_curves_are_read_and_a_missing_side_is_taken_from_the_other(tmp_path: Path) -> None:
    path = tmp_path / "curves.csv"
    lines = ["height,side,force_N,deformation_m,width_m,object_height_m"]
    lines += [f"8,x+,{2000 * d},{d},0.061,0.12" for d in (0.001, 0.002, 0.003)]
    lines += [f"12,y-,{500 * d},{d},," for d in (0.001, 0.002, 0.003)]
    path.write_text("\n".join(lines))
    first, second = read_curves(path)
    assert (first.height, first.axis) == (8, "x")
    assert first.width_m == pytest.approx(0.061)
    assert first.object_height_m == pytest.approx(0.12)
    assert np.isnan(second.object_height_m)
    assert second.sides[0] is None
    grid = stiffness_grid((first, second))
    # Noise of 0.1 mm that is not there is taken off: 3 x 1e-8 of 14e-6.
    np.testing.assert_allclose(grid[7, :2], 2000, rtol=3e-3)
    np.testing.assert_allclose(grid[11, 2:], 500, rtol=3e-3)
    assert np.isnan(grid[0]).all()


@pytest.mark.parametrize(
    ("columns", "place", "height"), [("at", "0.6", 10), ("height", "3", 3), ("at,height", "0.6,3", 3)]
)
def test_a_numbered_height_counts_before_a_fraction(
    tmp_path: Path, columns: str, place: str, height: int
) -> None:
    path = tmp_path / "curves.csv"
    rows = "".join(f"{place},x+,{2000 * d},{d}\n" for d in (0.001, 0.002, 0.003))
    path.write_text(f"{columns},side,force_N,deformation_m\n{rows}")
    (reading,) = read_curves(path)
    assert reading.height == height


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("height,side,force_N\n", "missing: deformation_m"),
        ("height,side,force_N,deformation_m\n", "has a header but no rows"),
        ("height,side,force_N,deformation_m\n17,x+,1,0.001\n", "found height 17, expected 1 to 16"),
        ("height,side,force_N,deformation_m\n1,z,1,0.001\n", r"line 2, side: found 'z', expected one of x\+"),
        ("height,side,force_N,deformation_m\n1,x+,nan,0.001\n", "expected a finite number"),
        ("height,side,force_N,deformation_m\n1,x+,-9,0.003\n", r"curve of x\+1: found .* rises"),
        ("height,side,force_N,deformation_m\n1,x+,9,0.03\n", "no sample up to 0.003 m"),
    ],
)
def test_one_line_for_a_bad_file(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "curves.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        read_curves(path)


def refused(deformation_m: np.ndarray, force_N: np.ndarray, said: str, draws: int = 60) -> float:
    """Fraction of noisy curves that are refused for this reason."""
    rng, found = np.random.default_rng(3), []
    for _ in range(draws):
        d, f = (x + rng.normal(0, s, x.shape) for x, s in ((deformation_m, 1e-4), (force_N, 0.1)))
        try:
            check_curve(d, f)
        except InputError as error:
            found.append(error.problem)
    assert all(said in one for one in found)
    return len(found) / draws


def test_a_curve_that_starts_before_contact_is_refused() -> None:
    d = np.linspace(0, 0.006, 25)
    for free, stiffness in ((0.002, 3000.0), (0.001, 20e3), (0.0035, 3000.0)):
        assert refused(d, stiffness * np.maximum(d - free, 0), "the force is zero up to") > 0.9
    # Walls that resist less at first, up to a membrane, and one that snaps through.
    for force in (900 * d, 1e5 * d**1.5, 5e5 * d**2, 2e8 * d**3, np.where(d <= 0.003, 900.0, -900.0) * d):
        assert not refused(d, force, "")
    late = 3000.0 * np.maximum(d - 0.002, 0)
    with pytest.raises(InputError, match="the force is zero up to"):
        fit_curve(d, late)
    assert fit_curve(d, late, from_contact=True).i_N_per_m < 1000
    # Two spikes hide each other, and a soft wall before them looks like none.
    spikes = 300.0 * d + 15.0 * np.isin(np.arange(25), (4, 6))
    with pytest.raises(
        InputError, match=r"zero up to .* within its noise, .* from contact on, without spikes"
    ):
        fit_curve(d, spikes)


@pytest.mark.parametrize("stiffness", [20e3, 1e5])
def test_the_noise_of_a_stiff_wall_does_not_look_like_opening(stiffness: float) -> None:
    """Up to 20 N it moves by twice to ten times the noise of the deformation, so that samples seem to go back."""
    d = np.linspace(0, 20 / stiffness, 41)[1:]
    assert not refused(d, stiffness * d, "")
    loop = np.r_[np.linspace(0, 0.001, 30), np.linspace(0.001, 0, 30)]
    assert not refused(loop, stiffness * loop, "", draws=40)


def test_a_curve_that_opens_again_is_refused_unless_the_wall_is_elastic(tmp_path: Path) -> None:
    d = np.r_[np.linspace(0, 0.004, 30), np.linspace(0.004, 0, 12)]
    opens = np.arange(len(d)) >= 30
    assert refused(d, np.where(opens, 1800.0, 3000.0) * d, "lower while opening") > 0.9
    for force in (3000 * d, 3e5 * d**2, 2e8 * d**3):
        assert not refused(d, force, "")
    path = tmp_path / "curves.csv"
    rows = "".join(f"8,x+,{k * x},{x}\n" for x, k in zip(d, np.where(opens, 1800.0, 3000.0), strict=True))
    path.write_text(f"height,side,force_N,deformation_m\n{rows}")
    with pytest.raises(InputError, match=r"curve of x\+8: found forces that are .* give the samples up to"):
        read_curves(path)


@pytest.mark.parametrize("linear", [0.0, -300.0])
def test_a_wall_that_snaps_through_has_no_curvature(linear: float) -> None:
    """Up to 3 mm it resists; over the whole curve its linear coefficient is not above zero."""
    assert np.isnan(CurveCoefficients(900.0, linear, -2.0, 0.1, 0.3).curvature).all()
    d = np.linspace(0.0005, 0.01, 20)
    found = fit_curve(d, np.where(d <= 0.003, 900.0, -900.0) * d)
    assert found.i_N_per_m > 0 > found.I_N_per_m
    assert np.isnan(found.curvature).all()


@pytest.mark.parametrize(("d", "f"), [([], []), ([0.001, 0.002], [1.0]), ([0.001, np.nan], [1.0, 2.0])])
def test_what_is_no_curve_is_refused_in_one_line(d: list[float], f: list[float]) -> None:
    with pytest.raises(InputError, match="curve"):
        check_curve(np.array(d), np.array(f))


@pytest.mark.parametrize(
    ("d", "f"),
    [
        ([1e-4, 1.1e-3, 2.1e-3, 3.1e-3, 4.1e-3], [0.5, -1e308, 2.5, 3.5, 4.5]),  # found by damaging a file
        ([1e-4, 1.1e-3, 2.1e-3], [0.5, 1e151, 2.5]),
        ([1e-4, 1e155, 2.1e-3], [0.5, 1.0, 2.5]),
    ],
)
def test_numbers_whose_squares_overflow_are_refused(d: list[float], f: list[float]) -> None:
    with pytest.raises(InputError, match="more than 1e\\+150"):
        fit_curve(np.array(d), np.array(f))


def test_a_first_step_below_any_resolution_says_nothing_of_the_contact() -> None:
    """The slope of the first sample alone overflows; the curve is that of the other samples."""
    d, k = np.array([0.0, 1.0, 2.0, 3.0, 4.0]) * 1e-3, 1000.0
    first = np.where(d == 0.0, 1e-160, d)
    found, expected = (fit_curve(one, k * d + 0.2 * (d == 0.0)) for one in (first, d))
    assert found.i_N_per_m == pytest.approx(expected.i_N_per_m, rel=1e-12)


@pytest.mark.parametrize(("sigmas", "rises"), [(4.5, False), (5.5, True)])
def test_a_wall_that_does_not_move_under_a_significant_force_is_stiff(sigmas: float, rises: bool) -> None:
    """Deformations within their noise and without a trend: the mean force tells a wall from no contact."""
    noise = TouchNoise(0.1, 1e-4)
    d = np.resize([2e-5, -2e-5], 16)
    f = np.full(16, sigmas * noise.force_N / 4.0)  # the mean of 16 samples has a fourth of their noise
    if not rises:
        with pytest.raises(InputError, match="expected a force that rises"):
            fit_curve(d, f, noise, from_contact=True)
        return
    # Stiffer than this force over twice the noise of the mean deformation.
    assert fit_curve(d, f, noise, from_contact=True).i_N_per_m > f[0] / (2 * noise.deformation_m / 4.0)


@pytest.mark.parametrize("stiffness", [1500.0, 6e3, 4e4])
def test_a_curve_shows_where_its_contact_was(stiffness: float) -> None:
    """The deformation reads 0.12 mm too high: the line through the curve has no force there, with the stated sigma."""
    rng, wrong = np.random.default_rng(2), 1.2e-4
    last = min(0.003, 20 / stiffness)
    d = np.linspace(last / 12, last, 12)
    fits = [
        fit_curve(d + wrong + rng.normal(0, 1e-4, 12), stiffness * d + rng.normal(0, 0.1, 12), from_contact=True)
        for _ in range(1500)
    ]  # fmt: skip
    found, declared = np.array([(fit.contact_m, fit.contact_sigma_m) for fit in fits]).T
    # Three standard errors of the mean, and a twentieth of the error: noise of the forces is a part of their differences.
    assert abs(found.mean() - wrong) < 3 * found.std() / np.sqrt(1500) + 0.05 * wrong
    assert np.sqrt(np.mean(declared**2)) == pytest.approx(found.std(), rel=0.1)


def test_a_curve_without_significant_forces_shows_no_contact() -> None:
    d = np.linspace(2.5e-4, 0.003, 12)
    assert np.isnan(fit_curve(d, 150 * d).contact_m)


def test_places_by_their_fraction_of_the_height(tmp_path: Path) -> None:
    """The height is divided into 16 equal parts, the first is 1; the top belongs to the last."""
    places = {0.0: 1, 0.062: 1, 0.063: 2, 0.5: 9, 0.93: 15, 0.94: 16, 1.0: 16}
    rows = [f"{at},x+,{force},{force / 900},{at}\n" for at in places for force in (0.5, 1.0, 2.0, 4.0, 6.0)]
    path = tmp_path / "curves.csv"
    path.write_text("at,side,force_N,deformation_m,curve\n" + "".join(rows))
    assert [one.height for one in read_curves(path)] == list(places.values())


@pytest.mark.parametrize("key", ["width_m", "object_height_m"])
def test_millimetres_are_no_metres(key: str) -> None:
    """Tables and hands are less than 3 m wide: a finger's breadth in millimetres is more."""
    assert getattr(TouchReading(8, "x", (None, None), **{key: 2.9}), key) == pytest.approx(2.9)
    with pytest.raises(InputError, match=f"found {key} 3.1, expected metres"):
        TouchReading(8, "x", (None, None), **{key: 3.1})


@pytest.mark.parametrize(
    ("stiffness", "sigma", "said"),
    [
        ((0.0, 900.0), 0.05, "stiffness_N_per_m: found 0, 900 N/m"),
        ((900.0, -900.0), 0.05, "stiffness_N_per_m: found 900, -900 N/m"),
        ((900.0,), 0.05, "found 900 N/m, expected more than 0 for both sides"),
        (900.0, 0.05, "found 900 N/m, expected more than 0 for both sides"),
        ((900.0, 900.0), -0.05, "relative_sigma: found -0.05"),
        ((900.0, 900.0), np.nan, "relative_sigma: found nan"),
    ],
)
def test_a_stiffness_without_a_logarithm_or_a_deviation_is_rejected(
    stiffness: tuple[float, ...] | float, sigma: float, said: str
) -> None:
    """Probabilities would be NaN."""
    assert TouchReading.of_stiffness(8, "x", (np.nan, 900.0), 0.05).sides[1] is not None
    with pytest.raises(InputError, match=said):
        TouchReading.of_stiffness(8, "x", stiffness, sigma)


def test_a_touch_is_at_one_of_the_heights() -> None:
    with pytest.raises(InputError, match=r"found x2.5, expected x or y and 1 to 16"):
        TouchReading(2.5, "x", (None, None))


@pytest.mark.parametrize("stiffness", [600.0, 5e3, 4e4])
def test_a_spike_of_one_sample_leaves_the_stiffness_as_accurate_as_declared(stiffness: float) -> None:
    """Samples with the tails of Student's t with three degrees of freedom, at the stated deviation, and one at thirty of it."""
    rng = np.random.default_rng(11)
    last = min(0.003, 20 / stiffness)
    d, z = np.linspace(last / 9, last, 9), []
    for _ in range(1000):
        noise = rng.standard_t(3, (2, 9)) / np.sqrt(3)
        noise[rng.integers(2), rng.integers(9)] += 30 * rng.choice([-1, 1])
        try:
            read = fit_curve(d + 1e-4 * noise[0], stiffness * d + 0.1 * noise[1], from_contact=True)
        except InputError:
            z.append(np.inf)
            continue
        z.append(np.log(read.i_N_per_m / stiffness) / read.i_relative_sigma)
    away = np.abs(z)
    # .67 of a Gaussian, .44 of t at the same deviation.
    assert 0.44 < np.median(away) < 0.7
    # The spike stays if another of its eight neighbours is beyond 5.5 deviations, as .25 % of t are: 2 %, and twice this for two.
    assert np.mean(away > 4) < 0.05


@pytest.mark.parametrize(
    ("curve", "corners"), [("line", 0), ("membrane", 0), ("jump", 0), ("kink", 2), ("snap", 2)]
)
def test_no_sample_of_a_smooth_wall_is_a_spike(curve: str, corners: int) -> None:
    """Beside a corner, two samples may be left out; the noise alone is a spike in one curve of 100,000."""
    rng, d = np.random.default_rng(4), np.linspace(2e-4, 0.003, 15)
    force = {
        "line": 3000 * d,
        "membrane": 7e8 * d**3,
        "jump": 3000 * d + 6.0 * (d > 0.0015),
        "kink": 9000 * np.maximum(d - 0.0012, 0),
        "snap": 3000 * np.where(d < 0.002, d, 0.004 - d),
    }[curve]
    for _ in range(300):
        read = np.stack([d + 1e-4 * rng.standard_normal(15), force + 0.1 * rng.standard_normal(15)])
        assert without_spikes(read, np.array([1e-4, 0.1]), 1e-5).sum() >= 15 - corners
