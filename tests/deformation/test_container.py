from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visuohaptic.core import InputError
from visuohaptic.deformation.shapes import (
    ContainerDescription,
    WallProfile,
    class_names,
    draw_variant,
    draw_variants,
    load_container,
    mesh_container,
    quantity,
    unit_section,
)

TUBE = {"base": {"radius": "35 mm"}, "sections": [{"height": "200 mm"}]}


def describe(**more: object) -> ContainerDescription:
    return ContainerDescription.model_validate({**TUBE, **more})


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("35 mm", "length", 0.035),
        ("1e-3m", "length", 0.001),
        (0.5, "length", 0.5),
        ("2.5 GPa", "pressure", 2.5e9),
        ("30 deg", "angle", np.pi / 6),
        ("5 %", "fraction", 0.05),
    ],
)
def test_quantities_have_units(text: object, kind: str, value: float) -> None:
    assert quantity(text, kind) == pytest.approx(value, rel=1e-11)


@pytest.mark.parametrize("text", ["35", "35 furlongs", "mm", "nan mm", True, None, "1e999 m", [1]])
def test_what_is_no_length_is_refused(text: object) -> None:
    with pytest.raises(ValueError, match="expected"):
        quantity(text, "length")


def test_all_classes_of_the_dissertation_are_shipped() -> None:
    wanted = {"bottle", "cup", "cup-rim", "elliptic", "smoothie", "cien", "isana", "cleaner", "palmo"}
    assert wanted <= set(class_names())


@pytest.mark.parametrize("name", class_names())
def test_a_hundred_variants_of_every_class_have_a_valid_shape(name: str) -> None:
    found = load_container(name)
    assert found.name == name
    for variant in draw_variants(found, 100, seed=1):
        WallProfile.of(variant)


def test_a_variant_depends_on_its_number_and_seed_alone() -> None:
    found = load_container("isana")
    assert draw_variants(found, 9, 4)[6] == draw_variant(found, 6, 4)
    assert draw_variant(found, 6, 4) != draw_variant(found, 6, 5)
    assert draw_variant(found, 6, 4) != draw_variant(found, 7, 4)


def test_variants_fill_their_ranges() -> None:
    found = load_container("cup")
    wall = np.array([variant.wall[0] for variant in draw_variants(found, 64, 2)])
    low, high = found.wall
    # A Sobol sequence has one of 64 points in each 64th of a range; its shift moves them all alike.
    counts = np.histogram(wall, 16, (low, high))[0]
    assert counts.min() >= 2
    assert counts.max() <= 6


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"rings": [{"z": "10 mm", "depth": "3 mm", "width": "2 mm"}]}, "radius of curvature"),
        ({"rings": [{"z": "199 mm", "depth": "1 mm", "width": "8 mm"}]}, "reaches beyond"),
        ({"sections": [{"height": "50 mm", "bulge": "-40 mm"}]}, "intersect itself"),
        ({"wall": "40 mm"}, "intersect itself"),
        (
            {"base": {"shape": "ellipse", "radius": "90 mm", "radius_y": "3 mm"}, "wall": "0.5 mm"},
            "radius of curvature",
        ),
        ({"dents": [{"z": "9 mm", "depth": "34 mm", "width": "9 mm", "height": "9 mm"}]}, "larger than"),
        ({"rim": {"height": "300 mm", "wall": "1 mm"}}, "expected less than"),
    ],
)
def test_impossible_walls_are_refused_with_the_place(change: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        WallProfile.of(describe(**change))


@pytest.mark.parametrize(
    "text",
    [
        "base: {radius: 35 mm}\nsections: []",
        "base: {radius: -35 mm}\nsections: [{height: 2 mm}]",
        "base: {radius: [40 mm, 30 mm]}\nsections: [{height: 2 mm}]",
        "base: {radius: 35 mm, colour: red}\nsections: [{height: 2 mm}]",
        "base: {shape: ellipse, radius: 35 mm}\nsections: [{height: 2 mm}]",
        "base: {radius: 35 mm}\nsections: [{height: 2 mm}]\nmaterial: unobtainium",
        "base: {radius: 35 mm}\nsections: [{height: 2 mm}]\nname: ../up",
        "[1, 2]",
        "base: {radius: 35 mm",
    ],
)
def test_a_bad_description_is_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_container(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


@given(
    st.floats(0.01, 0.1),
    st.floats(0.3, 1.0),
    st.floats(2.0, 15.0),
    st.sampled_from([16, 48, 64]),
)
@settings(max_examples=40, deadline=None)
def test_sections_lie_on_their_curve_equally_spaced_and_mirrored(
    a: float, aspect: float, n: float, around: int
) -> None:
    b = a * aspect
    points = unit_section(np.array([a]), np.array([b]), np.array([n]), around)[0]
    left = np.abs(points[:, 0] / a) ** n + (points[:, 1] / b) ** 2
    np.testing.assert_allclose(left, 1.0, atol=1e-12)
    half = np.roll(points, -around // 2, axis=0)
    assert np.array_equal(half, -points)
    mirrored = points[-np.arange(around)] * np.array([1.0, -1.0])
    assert np.array_equal(mirrored, points)
    if n < 4:
        # Chords of equal arcs differ where the curve bends more: by about (arc / radius)^2 / 24.
        chords = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
        assert np.ptp(chords) < 0.25 * chords.mean()


def test_a_bulge_is_the_sagitta() -> None:
    found = WallProfile.of(describe(sections=[{"height": "100 mm", "bulge": "4 mm"}]))
    assert np.interp(0.05, found.z_m, found.radius_x_m) == pytest.approx(0.039)
    assert found.radius_x_m[-1] == pytest.approx(0.035)


def test_rings_rims_and_sections_set_the_wall() -> None:
    found = WallProfile.of(
        describe(
            sections=[{"height": "100 mm"}, {"height": "100 mm", "wall": "1 mm"}],
            rim={"height": "5 mm", "wall": "3 mm"},
            rings=[{"z": "50 mm", "depth": "1 mm", "width": "10 mm", "wall": "2 mm"}],
        )
    )
    assert found.wall_m(np.array([0.02, 0.05, 0.15, 0.198])).tolist() == pytest.approx(
        [0.0005, 0.002, 0.001, 0.003]
    )


def test_ranges_have_to_be_chosen_first() -> None:
    with pytest.raises(InputError, match="are ranges"):
        mesh_container(load_container("cup"))
