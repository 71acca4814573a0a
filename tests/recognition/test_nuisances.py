"""Effects of the errors of a gripper, against lines fitted to curves with these errors; scatter found from made-up curvatures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from visuohaptic.deformation.shells.shell_material import IsotropicMaterial
from visuohaptic.recognition.data import TouchProtocol
from visuohaptic.recognition.touch import ModelSettings, few_curves
from visuohaptic.recognition.touch.nuisances import HEIGHTS, NUISANCES, nuisance_effects
from visuohaptic.recognition.touch.unknown_class import FEATURES, FIRST_WIDTH, HEIGHT, USUAL_HEIGHT_m
from visuohaptic.simulation.tabletop import oval_container


def _fitted(deformation_m: np.ndarray, force_N: np.ndarray) -> float:
    """Slope of a line through the origin."""
    return float(deformation_m @ force_N / (deformation_m @ deformation_m))


@pytest.mark.parametrize("stiffness", [800.0, 2e4])
def test_each_error_changes_the_fitted_stiffness_as_a_curve_with_it(stiffness: float) -> None:
    settings, protocol = ModelSettings(zero_m=2e-5, mouth=0.2), TouchProtocol()
    mean = np.zeros(FEATURES)
    mean[:FIRST_WIDTH] = np.log(stiffness)
    found = dict(
        zip(NUISANCES, nuisance_effects(mean, np.zeros((FEATURES,) * 2), settings, protocol), strict=True)
    )
    reach = min(protocol.max_deformation_m, protocol.max_force_N / stiffness)
    d = reach * (np.arange(2000) + 0.5) / 2000
    curves = {
        "gain": stiffness * d * (1 + settings.gain),
        "zero of the force": stiffness * d + settings.zero_N,
        "zero of the deformation": stiffness * (d - settings.zero_m),  # it reads too high
    }
    for name, force in curves.items():
        # Effects are linear in the error: relative changes, here below 10 %, of which the logarithm differs by half the square.
        expected = _fitted(d, force) / stiffness - 1
        np.testing.assert_allclose(found[name][:FIRST_WIDTH], expected, rtol=1e-3, err_msg=name)
    # The mouth is felt at the top, and less by the same factor from each height to the next below it.
    mouth = found["mouth"][:FIRST_WIDTH].reshape(HEIGHTS, -1)
    np.testing.assert_allclose(mouth[-1], settings.mouth)
    ratio = mouth[1:] / mouth[:-1]
    np.testing.assert_allclose(ratio, ratio[0, 0])
    assert ratio[0, 0] > 1.0
    for effect in found.values():
        assert not effect[FIRST_WIDTH:].any()  # none of these changes a width


def test_lid_and_air_hinder_the_flattening_of_ovals_alone() -> None:
    """Against Koiter shells: what little air above a filling adds, to ovals that are closed."""
    height_m, axes_m = 0.15, np.array([0.074, 0.042])
    z, settings = np.linspace(0.0, height_m, 41), ModelSettings(flattening=0.22)
    wall = np.column_stack([np.full(41, 0.5 * axes_m[0]), z, np.full(41, 8e-4)])
    material, squash = IsotropicMaterial.of("HDPE"), float(axes_m[1] / axes_m[0])
    empty, full = (
        oval_container(wall, (squash, 0.0), material, closed=True, fill=fill) for fill in (0.0, 0.8)
    )
    level = (np.arange(HEIGHTS) + 0.5) / HEIGHTS * height_m
    less, more = (
        np.array(
            [
                [np.log(side.force_at(float(h), 1e-4) / 1e-4) for side in (one.along, one.across)]
                for h in level[4:12]
            ]
        )
        for one in (empty, full)
    )
    added = more - less
    # Both axes are hindered alike, though one is several times as stiff.
    assert less[:, 0].mean() - less[:, 1].mean() > 0.5
    np.testing.assert_allclose(added[:, 0], added[:, 1], rtol=0.25)
    mean = np.zeros(FEATURES)
    mean[:FIRST_WIDTH] = np.repeat(np.full((HEIGHTS, 2), less.mean(axis=0)), 2, axis=1).ravel()
    mean[FIRST_WIDTH:HEIGHT] = np.tile(np.log(axes_m), HEIGHTS)
    mean[HEIGHT] = np.log(height_m / USUAL_HEIGHT_m)
    nothing = np.zeros((FEATURES,) * 2)
    felt = nuisance_effects(mean, nothing, settings, TouchProtocol())[-1][:FIRST_WIDTH].reshape(HEIGHTS, 4)
    # The same part of it at all heights, to the distance over which a finger alone dents the wall.
    ratio = added.mean(axis=1) / felt[4:12, 0]
    np.testing.assert_allclose(ratio, ratio.mean(), rtol=0.05)
    assert 0.4 < ratio.mean() < 1.0  # an empty and a full one are not as different as one that is open
    # Twice the height has twice the air behind it; what is round keeps its volume.
    mean[HEIGHT] += np.log(2.0)
    mean[:FIRST_WIDTH] += np.log(2.0)
    twice = nuisance_effects(mean, nothing, settings, TouchProtocol())[-1][:FIRST_WIDTH]
    np.testing.assert_allclose(twice, felt.ravel())
    mean[FIRST_WIDTH:HEIGHT] = np.log(0.06)
    assert not nuisance_effects(mean, nothing, settings, TouchProtocol())[-1].any()


@pytest.mark.parametrize(("along", "across"), [(0.3, 1.0), (1.0, 0.3), (0.1, 0.3)])
def test_scatter_of_curvatures_between_places_and_objects_is_found(
    along: float, across: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(5)
    objects: list[Any] = [
        (middle + along * rng.standard_normal(40), np.full(40, 1e-4), np.zeros(40))
        for middle in 0.2 + across * rng.standard_normal(60)
    ]
    monkeypatch.setattr(few_curves, "curvatures", lambda _, readings: readings)
    squeezed = [few_curves.SqueezedObject("cup", "cup", one) for one in objects]
    model: Any = None  # not needed for curvatures that are given
    found = few_curves._curvature_scatter(model, squeezed)
    # Standard deviations of 2,340 and 59 degrees of freedom are known to 1.5 and 9 %: no candidate beside the true one is likely.
    np.testing.assert_allclose(found, (along, across), rtol=0.05)
    # Two objects already show how far one differs from another, one alone does not.
    two = few_curves._curvature_scatter(model, squeezed[:2])
    assert two[0] == pytest.approx(along, rel=0.3)  # 78 degrees of freedom
    assert few_curves._curvature_scatter(model, squeezed[:1]) == (np.inf, 0.0)
