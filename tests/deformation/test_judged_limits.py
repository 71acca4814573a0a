"""What is a container, and what its wall and its material are: each limit from both sides, with the geometry that it stands for."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from visuohaptic.core import InputError
from visuohaptic.deformation import load_object
from visuohaptic.deformation.maps.curve_features import _judged
from visuohaptic.deformation.maps.thickness_map import with_thickness_map
from visuohaptic.deformation.shapes.coverage import SAMPLES, _lid_area, check_container
from visuohaptic.deformation.shapes.import_mesh import _thick
from visuohaptic.deformation.shapes.mesh_repair import DIAGONAL, MOVED_FRACTION, _holes, _noise, clamped_foot
from visuohaptic.deformation.shapes.posture import _check_upright, _metres_per_unit
from visuohaptic.deformation.shells.shell_material import MATERIALS, YIELD_Pa
from visuohaptic.io.meshes import inspect_mesh


def test_noise_of_a_flat_scan_is_its_standard_deviation() -> None:
    """Triangles with six neighbours at each vertex; 3,600 residuals, correlated within two rings, know their median to 3 %."""
    n, sigma = 60, 1e-4
    row, column = (part.ravel() for part in np.mgrid[:n, :n])
    flat = np.column_stack([column + 0.5 * row, np.sqrt(0.75) * row, np.zeros(n * n)]) * 0.005
    k = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.vstack([np.column_stack([k, k + 1, k + n]), np.column_stack([k + 1, k + n + 1, k + n])])
    flat[:, 2] = sigma * np.random.default_rng(3).standard_normal(n * n)
    assert _noise(flat, faces) == pytest.approx(sigma, rel=0.08)


@pytest.mark.parametrize(("extent", "usual"), [(0.028, False), (0.032, True), (0.57, True), (0.63, False)])
def test_a_container_has_the_size_of_a_hand(extent: float, usual: bool) -> None:
    """From an egg cup of 3 cm to a canister of 60 cm."""
    _, notes = _metres_per_unit(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, extent]]), "m", None, "a.stl")
    assert (not notes) == usual


@pytest.mark.parametrize(
    ("fraction", "said"),
    [(0.093, ""), (0.107, "relative error"), (0.31, "relative error"), (0.36, "thin-walled")],
)
def test_a_wall_is_thin_up_to_a_tenth_of_its_radius_and_none_beyond_a_third(
    fraction: float, said: str
) -> None:
    heights, radius = np.linspace(0.0, 0.1, 9), np.full(9, 0.03)
    if said == "thin-walled":
        with pytest.raises(InputError, match=said):
            _thick(heights, radius, fraction * radius, "a.stl")
        return
    notes = _thick(heights, radius, fraction * radius, "a.stl")
    assert [said in note for note in notes] == ([True] if said else [])


def _curve(force: np.ndarray, d: np.ndarray) -> Any:
    return SimpleNamespace(force_N=force, deformation_m=d, stable=np.ones(len(d), bool), reason="")


def test_a_curve_a_fifth_beside_every_parabola_has_no_quadratic_coefficient() -> None:
    """Powers of the deformation are ever farther from a parabola; their distance by the normal equations."""
    d = np.linspace(0.0, 0.008, 41)
    terms = np.stack([d, d**2], axis=1) / [0.008, 0.008**2]

    def beside(power: float) -> float:
        force = (d / 0.008) ** power
        return float(
            np.linalg.norm(force - terms @ np.linalg.solve(terms.T @ terms, terms.T @ force))
            / np.linalg.norm(force)
        )

    for wanted, parabola in ((0.18, True), (0.22, False)):
        power = brentq(lambda one, wanted=wanted: beside(one) - wanted, 2.5, 40.0)
        valid, why = _judged(_curve(d[1:] ** power, d[1:]), d[1:], 1.0)
        assert valid.tolist() == [True, True, parabola]
        assert ("from a parabola" in why) != parabola


def _wall(radius: float, low_m: float, step: float = 0.0, part: float = 0.0) -> Any:
    """A tube of one surface; in a part of the directions it is wider in its upper half."""

    def radius_m(heights: np.ndarray, angles: int) -> np.ndarray:
        wide = np.arange(angles) < part * angles
        return np.where((heights[:, None] < 0.05) & wide, radius * (1.0 - step), radius) * np.ones(
            (len(heights), angles)
        )

    return SimpleNamespace(
        low_m=low_m, high_m=0.1, radius_m=radius_m, double=False, axis_point_m=(0.0, 0.0), where="a"
    )


def _state(*points: tuple[float, float, float]) -> Any:
    return SimpleNamespace(vertices=np.array(points), faces=np.arange(len(points) // 3 * 3).reshape(-1, 3))


@pytest.mark.parametrize(
    ("reach", "low_m", "said"),
    [(2.5, 0.0, ""), (2.7, 0.0, "it reaches"), (1.0, 0.0095, ""), (1.0, 0.0105, "stands on legs")],
)
def test_a_handle_is_shorter_than_its_container_is_wide_and_a_foot_no_leg(
    reach: float, low_m: float, said: str
) -> None:
    """A handle reaches 1.6 radii beyond the wall; legs are a tenth of a height of 0.1 m."""
    state = _state((0.03 * reach, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.1))
    if not said:
        check_container(state, _wall(0.03, low_m), closed=False)
        return
    with pytest.raises(InputError, match=said):
        check_container(state, _wall(0.03, low_m), closed=False)


@pytest.mark.parametrize(("step", "part", "tool"), [(0.3, 0.3, True), (0.23, 0.3, False), (0.3, 0.22, False)])
def test_a_closed_surface_with_a_ledge_is_a_tool(step: float, part: float, tool: bool) -> None:
    """The ledge is a fraction of the radius, in a fraction of the directions; a level top of the whole cross-section is a lid."""
    square = 0.03 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    top = [(*square[k], 0.1) for k in (0, 1, 2, 0, 2, 3)]
    state = _state(*top, (0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (0.0, 0.01, 0.0))
    if tool:
        with pytest.raises(InputError, match="like a tool"):
            check_container(state, _wall(0.03, 0.0, step, part), closed=True)
        return
    check_container(state, _wall(0.03, 0.0, step, part), closed=True)


@pytest.mark.parametrize(("above", "known"), [(0.22, True), (0.28, False)])
def test_thickness_is_measured_within_a_quarter_of_the_height_from_the_wall(
    above: float, known: bool
) -> None:
    cup = load_object("cup", around=16)
    top = float(cup.mesh.vertices_m[cup.mesh.faces].mean(axis=1)[:, 2].max())
    values = np.array([[0.0, 5e-4], [top + above * cup.height_m, 5e-4]])
    if known:
        with_thickness_map(cup, values, "a.csv")
        return
    with pytest.raises(InputError, match="row 2"):
        with_thickness_map(cup, values, "a.csv")


def _ring(radius: float, z: float, count: int = 24) -> np.ndarray:
    angle = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, z)])


@pytest.mark.parametrize(
    ("radius", "z", "mouth"),
    [(0.01, 0.096, True), (0.01, 0.094, False), (0.0066, 0.099, True), (0.0054, 0.099, False)],
)
def test_a_mouth_is_at_an_end_and_wide(radius: float, z: float, mouth: bool) -> None:
    """Within a twentieth of the height, and a fifth as wide as the mesh of 6 cm."""
    vertices = np.vstack([_ring(0.03, 0.0), _ring(0.03, 0.1), _ring(radius, z)])
    state: Any = SimpleNamespace(vertices=vertices, loops=(np.arange(48, 72),))
    assert (not _holes(state)) == mouth


def test_a_foot_is_the_lowest_part_that_surrounds_the_axis() -> None:
    """Two thousandths of the height; a hundredth where in one of twelve sectors nothing is as low."""
    low, next_, higher = _ring(0.03, 0.0, 12), _ring(0.03, 0.9e-3, 12), _ring(0.03, 1.1e-3, 12)
    for z, clamped in ((0.19e-3, True), (0.21e-3, False)):
        points = np.vstack([low, [[0.03, 0.0, z], [0.0, 0.0, 0.1]]])
        assert clamped_foot(points)[12] == clamped
    found = clamped_foot(np.vstack([low[1:], next_, higher, [[0.0, 0.0, 0.1]]]))
    assert found[:23].all()
    assert not found[23:].any()


def test_a_foot_with_a_gap_of_a_thirteenth_surrounds_it() -> None:
    """Thirteen points leave no sector of twelve empty, eleven do."""
    for count, whole in ((13, True), (11, False)):
        points = np.vstack([_ring(0.03, 0.0, count), _ring(0.03, 0.9e-3, count), [[0.0, 0.0, 0.1]]])
        assert clamped_foot(points).sum() == (count if whole else 2 * count)


def _lying(height: float, degrees: float) -> Any:
    """A closed can of radius 0.03 m that is turned about y."""
    import trimesh

    can = trimesh.creation.cylinder(0.03, height, sections=48)
    can.apply_transform(trimesh.transformations.rotation_matrix(np.radians(degrees), [0.0, 1.0, 0.0]))
    return inspect_mesh(np.asarray(can.vertices), np.asarray(can.faces))


@pytest.mark.parametrize(
    ("height", "degrees", "told"),
    [(0.2, 14.0, False), (0.2, 16.0, True), (0.0915, 90.0, False), (0.1005, 90.0, True)],
)
def test_a_can_lies_where_its_wall_tells_its_axis(height: float, degrees: float, told: bool) -> None:
    """Areas whose normals are along the axis, 2 pi r^2, and along each direction across it, pi r h: 1.6 times as large from
    a height of 3.2 radii on."""
    state = _lying(height, degrees)
    if not told:
        _check_upright(state, "a.stl")
        return
    with pytest.raises(InputError, match="degrees from the height axis"):
        _check_upright(state, "a.stl")


#: Density [kg/m^3] of Callister, Materials Science and Engineering, 8th edition, Appendix B; middle of a range.
DENSITIES = {
    "LDPE": 925, "HDPE": 959, "PP": 905, "PET": 1350, "PS": 1050, "PVC": 1440, "aluminium": 2710, "copper": 8940, "glass": 2500,
}  # fmt: skip
#: Yield strength [MPa], there.
STRENGTHS = {"LDPE": 11.8, "HDPE": 29.7, "PP": 34.1, "PET": 59.3, "PVC": 42.8, "copper": 69.0}


def test_densities_and_strengths_are_those_of_a_handbook() -> None:
    """Densities to twice their two per cent and the range of PVC; strengths to the 20 % that they are known to."""
    for name, density in DENSITIES.items():
        entry = MATERIALS[name].density_kg_per_m3
        assert entry is not None
        assert entry.value == pytest.approx(density, rel=0.045)
    for name, strength in STRENGTHS.items():
        assert YIELD_Pa[name] == pytest.approx(1e6 * strength, rel=0.2)


def test_a_top_is_level_within_ten_degrees_in_the_uppermost_tenth() -> None:
    """The cap of a ball, by Archimedes: 2 pi r^2 (1 - cos 10 degrees); and triangles below nine and eleven per cent of the height."""
    import trimesh

    ball = trimesh.creation.icosphere(5, 0.03)
    state: Any = SimpleNamespace(vertices=np.asarray(ball.vertices), faces=np.asarray(ball.faces))
    assert _lid_area(state, 0.06) == pytest.approx(
        2.0 * np.pi * 0.03**2 * (1.0 - np.cos(np.radians(10.0))), rel=0.06
    )
    for depth, counts in ((0.0095, True), (0.0105, False)):
        level = [(0.0, 0.0, 0.1 - depth), (0.02, 0.0, 0.1 - depth), (0.0, 0.02, 0.1 - depth)]
        state = _state(*level, (0.0, 0.0, 0.1), (0.0, 0.0, 0.0), (0.0, 0.001, 0.0))
        assert _lid_area(state, 0.1) == pytest.approx(2e-4 if counts else 0.0)


def test_waves_of_this_fraction_of_a_wall_stiffen_it_by_four_thousandths() -> None:
    """Second moment of a strip whose middle is a sine, by quadrature, relative to that of a straight one."""
    x = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    y = np.linspace(-0.5, 0.5, 2001)
    place = MOVED_FRACTION * np.sin(x)[:, None] + y
    assert np.mean(place**2) / np.mean(y**2) - 1.0 == pytest.approx(0.00375, rel=0.1)


def test_half_of_a_square_has_its_diagonal() -> None:
    assert pytest.approx(np.hypot(1.0, 1.0)) == DIAGONAL


def test_a_fraction_of_a_wall_is_sampled_to_half_a_percent() -> None:
    seen = np.random.default_rng(1).binomial(SAMPLES, 0.5, 5_000) / SAMPLES
    assert seen.std() == pytest.approx(0.005, rel=0.07)


@pytest.mark.parametrize(("lean", "stands"), [(13.5, True), (16.5, False)])
def test_a_tube_may_lean_by_fifteen_degrees(lean: float, stands: bool) -> None:
    """Of its axis against the height; its foot is a ring that stands on one point."""
    around, z = np.meshgrid(np.linspace(0, 2 * np.pi, 24, endpoint=False), np.linspace(0, 0.3, 13))
    points = np.stack([0.03 * np.cos(around), 0.03 * np.sin(around), z], axis=2).reshape(-1, 3)
    k = np.arange(12 * 24)
    right = k // 24 * 24 + (k + 1) % 24
    faces = np.vstack([np.column_stack([k, right, k + 24]), np.column_stack([right, right + 24, k + 24])])
    state: Any = SimpleNamespace(
        vertices=Rotation.from_euler("x", lean, degrees=True).apply(points), faces=faces
    )
    if stands:
        _check_upright(state, "a.stl")
        return
    with pytest.raises(InputError):
        _check_upright(state, "a.stl")
