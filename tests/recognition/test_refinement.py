from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError, StiffnessMap
from visuohaptic.deformation import mesh_container, object_map
from visuohaptic.deformation.shapes.container import Base, ContainerDescription, WallSection
from visuohaptic.recognition.touch import correct_map, map_of_outline, map_of_oval, stiffness_samples
from visuohaptic.recognition.touch._round_body import round_body


def test_a_corrected_map_is_right_where_it_was_touched_and_doubtful_elsewhere() -> None:
    z = np.linspace(0, 0.2, 81)
    points = np.stack([0 * z, 0 * z, z], axis=1)
    simulated = np.full(81, 1000.0)
    found = StiffnessMap(points, np.array([[0, 1, 2]]), simulated, 200 + 0 * z)
    new = correct_map(found, points[[20, 60]], np.array([1300.0, 1000.0]), np.full(2, 0.01))
    assert new.stiffness_N_per_m[20] == pytest.approx(1300, rel=0.02)
    assert new.stiffness_N_per_m[60] == pytest.approx(1000, rel=0.02)
    relative = new.stiffness_sigma_N_per_m / new.stiffness_N_per_m
    assert relative[20] < 0.015
    assert relative[[0, 40, 80]].min() > 2 * relative[20]
    # All of it by one common factor: no place keeps its old value.
    both = correct_map(found, points[[20, 60]], np.array([1300.0, 1300.0]), np.full(2, 0.01))
    assert (both.stiffness_N_per_m > 1200).all()


def test_the_deviation_of_a_corrected_map_is_that_of_its_two_parts() -> None:
    """A common factor of 55 % and a local one of 25 % over 5 mm, conditioned on one exact measurement, in closed form."""
    z = np.array([0.0, 0.005, 1.0])
    points = np.stack([0 * z, 0 * z, z], axis=1)
    found = StiffnessMap(points, np.array([[0, 1, 2]]), np.full(3, 1000.0), np.full(3, 200.0))
    new = correct_map(found, points[:1], np.array([1300.0]), np.array([1e-6]))
    shared = 0.55**2 + 0.25**2 * np.exp([0.0, -0.5, -np.inf])
    whole = 0.55**2 + 0.25**2
    np.testing.assert_allclose(new.stiffness_N_per_m, 1000 * 1.3 ** (shared / whole), rtol=1e-4)
    sigma = np.sqrt(np.maximum(whole - shared**2 / whole, 0.0))
    relative = new.stiffness_sigma_N_per_m / new.stiffness_N_per_m
    np.testing.assert_allclose(relative, sigma, rtol=1e-3, atol=1e-4)


def test_both_ends_of_a_pinch_are_one_measurement() -> None:
    points = np.array([[0.03, 0.0, 0.1], [-0.03, 0.0, 0.1], [0.0, 0.03, 0.1]])
    found = StiffnessMap(points, np.array([[0, 1, 2]]), np.full(3, 1000.0), np.full(3, 200.0))
    one, other = (
        correct_map(found, points[[k]], np.array([1300.0]), np.array([0.05])).stiffness_sigma_N_per_m
        for k in (0, 1)
    )
    np.testing.assert_allclose(one, other, rtol=1e-9)
    assert one[2] > 3 * one[0]


def test_an_outline_makes_the_errors_of_a_round_body_those_of_its_samples() -> None:
    """Two squeezes of a tube of known radius: far from them what remains is the wall's own variation, nowhere more than before."""
    outline = np.column_stack([np.full(25, 0.03), np.linspace(0.0, 0.2, 25)])
    heights, logs = stiffness_samples(outline, np.zeros((25, 25)), 4e-4, 0.0)
    vertices = np.array([[0.03, 0.0, z] for z in (0.05, 0.1, 0.15)])
    before, deviations = map_of_outline(vertices, np.array([[0, 1, 2]]), heights, logs)
    body = round_body(outline, 4e-4)
    expected = [body.wall_N_per_m(z, False) for z in (0.05, 0.1)]
    np.testing.assert_allclose(before.stiffness_N_per_m[:2], expected, rtol=0.05)
    felt = 1.5 * before.stiffness_N_per_m[[0]]
    after = correct_map(before, vertices[[0]], felt, np.array([0.01]), deviations)
    # Of what is felt, the common part holds everywhere: 18 % to 23 % of the place.
    whole, common = 0.18**2 + 0.23**2, 0.18**2
    ratio = after.stiffness_N_per_m[1] / before.stiffness_N_per_m[1]
    assert ratio == pytest.approx(1.5 ** (common / whole), rel=0.01)
    relative = after.stiffness_sigma_N_per_m / after.stiffness_N_per_m
    assert relative[0] < 0.02
    assert relative[1] == pytest.approx(np.sqrt(whole - common**2 / whole), rel=0.02)


def test_samples_follow_the_errors_of_the_outline() -> None:
    """A tube whose radius is uncertain by 5 % as a whole, against tubes 5 % wider and narrower; 32 samples: 13 % of sigma."""
    outline = np.column_stack([np.full(25, 0.03), np.linspace(0.0, 0.2, 25)])
    common = np.full((25, 25), 0.05**2)
    z, logs = stiffness_samples(outline, common, 4e-4, 0.0)
    loose = float(logs[:, 40].std())
    wide, narrow = (round_body(outline * (f, 1.0), 4e-4).wall_N_per_m(0.1, False) for f in (1.05, 0.95))
    assert loose == pytest.approx(0.5 * abs(np.log(wide / narrow)), rel=0.4)
    # Fingers have measured the radius.
    _, felt = stiffness_samples(outline, common, 4e-4, 0.0, widths_m=[(0.1, 0.03)])
    assert float(felt[:, 40].std()) < 0.5 * loose
    assert z[40] == pytest.approx(0.1)


@pytest.mark.parametrize(("stiffness", "sigma"), [(0.0, 0.1), (1300.0, 0.0)])
def test_measurements_of_no_stiffness_and_without_error_are_refused(stiffness: float, sigma: float) -> None:
    points = np.eye(3)
    found = StiffnessMap(points, np.array([[0, 1, 2]]), np.full(3, 1000.0), np.full(3, 200.0))
    with pytest.raises(InputError, match="above 0"):
        correct_map(found, points[:1], np.array([stiffness]), np.array([sigma]))


def test_deviations_of_another_map_are_refused() -> None:
    points = np.eye(3)
    found = StiffnessMap(points, np.array([[0, 1, 2]]), np.full(3, 1000.0), np.full(3, 200.0))
    with pytest.raises(InputError, match=r"correct_map: deviations: found \(4,\) deviations, .* of 3 points"):
        correct_map(found, points[:1], np.array([1300.0]), np.array([0.1]), np.zeros((5, 4)))


def test_the_lid_of_an_oval_is_a_mixture_that_squeezes_decide() -> None:
    """Near the rim a lid changes the stiffness by a factor; a squeeze there tells it, one in the middle does not."""
    oval = ContainerDescription(
        name="oval",
        base=Base(shape="ellipse", radius=(0.042, 0.042), radius_y=(0.026, 0.026)),
        sections=[WallSection(height=(0.15, 0.15))],
        wall=(7e-4, 7e-4),
    )
    model = mesh_container(oval, around=16)
    x, y, z = model.mesh.vertices_m.T
    on_top = np.flatnonzero((np.abs(y) < 1e-9) & (x > 0) & (z > 0.12) & (z < 0.14))[0]
    alone, held = (map_of_oval(model, p)[0].stiffness_N_per_m for p in (0.0, 1.0))
    given = np.isfinite(alone)
    np.testing.assert_allclose(
        alone[given], object_map(model, band=False).stiffness_N_per_m[given], rtol=1e-9
    )
    assert held[on_top] > 1.5 * alone[on_top]
    surface, deviations = map_of_oval(model, 0.5)
    assert surface.stiffness_N_per_m[on_top] == pytest.approx(np.sqrt(alone[on_top] * held[on_top]), rel=1e-9)
    lid = np.log(held[on_top] / alone[on_top])
    # Variances of the lid and of the wall: p (1 - p) of the factor's logarithm, and 55 % squared.
    assert (deviations[:, on_top] ** 2).sum() / 3 == pytest.approx(0.25 * lid**2 + 0.55**2, rel=1e-9)
    middle = np.flatnonzero((np.abs(y) < 1e-9) & (x > 0) & (z > 0.07) & (z < 0.08))[0]
    places = model.mesh.vertices_m[[middle, on_top]]
    for true in (alone, held):
        after = correct_map(surface, places, true[[middle, on_top]], np.full(2, 0.05), deviations)
        assert after.stiffness_N_per_m[on_top] == pytest.approx(true[on_top], rel=0.1)
