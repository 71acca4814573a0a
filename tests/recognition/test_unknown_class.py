"""How an object of no trained class may differ from one: each entry of the covariances against its definition in numbers."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.deformation.shells import fourier_shell
from visuohaptic.deformation.shells.shell_material import IsotropicMaterial
from visuohaptic.recognition import FeatureSet, TouchReading
from visuohaptic.recognition.touch import ModelSettings, fit_model, update_belief
from visuohaptic.recognition.touch.unknown_class import (
    FEATURES,
    FIRST_WIDTH,
    GROOVE_SIGMA,
    HEIGHT,
    OVAL_SIGMA,
    SIMULATED,
    SIZES,
    UNKNOWN_CLASS_SIGMAS,
    simulated_kinds,
    simulated_spread,
    smooth_profile,
    unknown_kinds,
)

GROOVE = GROOVE_SIGMA**2


def side(height: int, number: int) -> int:
    """Index of the stiffness of x+, x-, y+ or y- at a height."""
    return 4 * height + number


def width(height: int, axis: int) -> int:
    return FIRST_WIDTH + 2 * height + axis


def test_profiles_are_smooth_along_the_height_and_similar_around_it() -> None:
    found = smooth_profile(0.5, 0.3, 0.2, 0.1, 0.4, reach=4.0)
    away = np.exp(-0.5)  # of a Gaussian correlation, one length away
    expected = {
        (side(3, 0), side(3, 0)): 0.25 + 0.09 + GROOVE,
        (side(3, 0), side(3, 1)): 0.25 + 0.09 + GROOVE,  # a pinch loads both sides of an axis
        (side(3, 0), side(3, 2)): 0.25 + 0.7 * (0.09 + GROOVE),
        (side(3, 1), side(7, 0)): 0.25 + 0.09 * away,
        (side(3, 1), side(7, 3)): 0.25 + 0.7 * 0.09 * away,
        (width(5, 0), width(5, 0)): 1.4 * 0.04 + 0.01,
        (width(5, 0), width(9, 0)): 1.4 * 0.04 + 0.01 * away,
        (width(5, 0), width(5, 1)): 0.04 + 0.5 * 0.01,
        (HEIGHT, HEIGHT): 0.16,
        (side(3, 0), width(3, 0)): 0.0,
        (HEIGHT, width(0, 0)): 0.0,
    }
    for place, value in expected.items():
        assert found[place] == pytest.approx(value), place
    np.testing.assert_array_equal(found, found.T)
    assert np.linalg.eigvalsh(found).min() > -1e-12


def test_a_round_object_is_alike_on_all_sides() -> None:
    found = smooth_profile(0.5, 0.3, 0.2, 0.1, 0.4, reach=4.0, even=True)
    for height in (0, 15):
        block = found[side(height, 0) : side(height + 1, 0), side(height, 0) : side(height + 1, 0)]
        np.testing.assert_allclose(block, 0.25 + 0.09 + GROOVE)
        assert found[width(height, 0), width(height, 1)] == pytest.approx(1.4 * 0.04 + 0.01)


def test_what_unknown_objects_are_like_is_learned_from_the_classes() -> None:
    alike = np.ones((3, FEATURES))
    kinds, likely = unknown_kinds(alike)
    # Three classes without any difference, and the container of the library's own figures as a fourth sample.
    learned = np.array(UNKNOWN_CLASS_SIGMAS) / np.sqrt(3)
    np.testing.assert_allclose(kinds[0], smooth_profile(*learned, reach=4.0))
    np.testing.assert_allclose(kinds[3], smooth_profile(*UNKNOWN_CLASS_SIGMAS, reach=5.0, even=True))
    np.testing.assert_allclose(likely, [0.1, 0.1, 0.4, 0.4])  # three round of three: (3 + 1) / (3 + 2)

    apart = alike.copy()
    sides = apart[0, :FIRST_WIDTH].reshape(16, 4)
    sides[:, :2] += GROOVE_SIGMA  # one class of two axes: 3/4 of it are its own shape
    sides[:, 2:] -= GROOVE_SIGMA
    apart[1, HEIGHT] += 0.3
    kinds, likely = unknown_kinds(apart)
    np.testing.assert_allclose(likely, [0.2, 0.2, 0.3, 0.3])  # two round of three
    inner = 56  # its own deviation is 2/3 of it, that of both others 1/3
    shape = GROOVE_SIGMA**2 * ((2 / 3) ** 2 + 2 * (1 / 3) ** 2)
    assert inner == FIRST_WIDTH - 8
    learned = np.sqrt(np.array([*UNKNOWN_CLASS_SIGMAS]) ** 2 / 3)
    learned[1] = np.sqrt((shape + UNKNOWN_CLASS_SIGMAS[1] ** 2) / 3)
    tall = np.sum((np.array([-0.1, 0.2, -0.1])) ** 2)
    learned[4] = np.sqrt((tall + UNKNOWN_CLASS_SIGMAS[4] ** 2) / 3)
    np.testing.assert_allclose(kinds[0], smooth_profile(*learned, reach=4.0))


def test_other_features_are_refused() -> None:
    with pytest.raises(InputError, match=f"found 3 features, expected {FEATURES}"):
        unknown_kinds(np.ones((2, 3)))


def test_simulated_containers_are_those_of_the_shells() -> None:
    """Pinched at mid-height, a shell of triangles is as stiff; sizes are within their ranges."""
    data = simulated_kinds()
    assert len(data) == SIMULATED
    np.testing.assert_array_equal(data.features, simulated_kinds.__wrapped__().features)
    stiffness = data.features[..., 0]
    assert np.isfinite(stiffness).all()
    np.testing.assert_allclose(stiffness[..., 1:], stiffness[..., :1].repeat(3, axis=2))  # round
    low, high = np.array(SIZES[0])
    assert (data.height_m > low).all()
    assert (data.height_m < high).all()
    # A wall of five times the modulus is five times as stiff: the level is left open by more than this factor.
    spread = np.ptp(np.log(stiffness).mean(axis=(1, 2)))
    assert spread > 4 * UNKNOWN_CLASS_SIGMAS[0]


def test_simulated_containers_have_the_stated_walls(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 1,920: two thirds have a mouth of 0.6 to 1.65 times the foot, three of ten a rim of 2 to 5 walls and 3 mm, half a lid."""
    built = []

    def pinched(shell: fourier_shell.RevolutionShell, material: IsotropicMaterial, **_: object) -> np.ndarray:
        built.append((shell, material))
        return np.ones(len(shell.radius_m))

    monkeypatch.setattr(fourier_shell, "pinch_stiffness", pinched)
    for seed in range(40):
        simulated_kinds.__wrapped__(seed)
    mouth = np.array([shell.radius_m[-1] / shell.radius_m[0] for shell, _ in built])
    assert ((mouth > 0.6) & (mouth < 1.65)).mean() == pytest.approx(2 / 3, rel=0.06)
    assert np.mean([shell.rim_held for shell, _ in built]) == pytest.approx(0.5, rel=0.06)
    rims = [shell for shell, _ in built if shell.thickness_m[-1] > 1.5 * shell.thickness_m[0]]
    assert len(rims) / len(built) == pytest.approx(0.3, rel=0.1)
    ratio = [shell.thickness_m[-1] / shell.thickness_m[0] for shell in rims]
    assert np.quantile(ratio, [0.0, 0.5, 1.0]) == pytest.approx([2.0, 3.5, 5.0], rel=0.05)
    tall = [
        np.ptp(one.height_m) / 64 * ((one.thickness_m > 1.5 * one.thickness_m[0]).sum() - 1) for one in rims
    ]
    assert np.mean(tall) == pytest.approx(0.003, rel=0.1)
    poisson = [material.poisson_ratio for _, material in built]
    assert (min(poisson), max(poisson)) == pytest.approx((0.22, 0.45), rel=0.01)


def test_axes_of_oval_containers_differ_as_those_of_an_ellipse() -> None:
    """Stiffness is inverse to the radius of curvature, b^2 / a at the end of the long axis and a^2 / b at that of the short one."""
    round_, oval = simulated_spread()
    more = oval - round_
    first, second = 4 * 7, 4 * 7 + 2  # along x and y at one height
    apart = np.zeros(FEATURES)
    apart[first], apart[second] = 1, -1
    wide = np.zeros(FEATURES)
    wide[FIRST_WIDTH + 14], wide[FIRST_WIDTH + 15] = 1, -1
    a, b = np.exp(OVAL_SIGMA / 2), np.exp(-OVAL_SIGMA / 2)
    assert wide @ more @ wide == pytest.approx(np.log(a / b) ** 2)
    assert wide @ more @ apart == pytest.approx(np.log(a / b) * np.log((a**2 / b) / (b**2 / a)))
    assert apart @ round_ @ apart == pytest.approx(0.0, abs=1e-12)
    level = UNKNOWN_CLASS_SIGMAS[0]
    assert round_[first, first + 20] == pytest.approx(level**2)


def test_containers_of_no_class_are_recognised_by_stiffness_alone() -> None:
    """Two classes of made-up tubes; containers that are simulated with another seed are asked for."""
    rng, height = np.random.default_rng(0), np.linspace(0, 1, 16)
    top = np.repeat([1e3, 4e4], 20)
    profile = 8e3 * (top[:, None] / 8e3) ** height * rng.lognormal(0, 0.15, (40, 1))
    data = FeatureSet.of_stiffness(
        np.repeat(profile[:, :, None], 4, axis=2), np.full((40, 16, 2), 0.06), ["cup"] * 20 + ["can"] * 20
    )
    model = fit_model(data, settings=ModelSettings(use_width=False))
    asked = simulated_kinds.__wrapped__(1).features[..., 0]
    told = [
        update_belief(model, [TouchReading.of_stiffness(h, "x", one[h - 1, :2]) for h in (3, 6, 9, 12, 15)])
        for one in asked
    ]
    said = np.mean([one.answer == "unknown" for one in told])
    known = [
        update_belief(
            model, [TouchReading.of_stiffness(h, "x", one[h - 1, [0, 0]]) for h in (3, 6, 9, 12, 15)]
        ).answer
        for one in profile[:, :, None]
    ]
    assert known == list(data.label)
    assert said > 0.9
