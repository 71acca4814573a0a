"""The geometry kit: axioms, limits and round trips, against SciPy's rotations, Shapely's polygons and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from visuohaptic.core.geometry import (
    area_vectors,
    hat,
    polygon_area,
    polygon_centroid,
    polygon_second_moments,
    rotation_2d,
    so3_exp,
    so3_log,
    sphere_directions,
    vertex_normals,
    wrap_angle,
)

#: Some operations on numbers of order 1 in double precision.
ROUNDING = 1e-13
SEEDS = st.integers(0, 2**32 - 1)
#: Turns as they occur: none, next to none, any, next to a half turn, a half turn.
ANGLES = st.one_of(
    st.just(0.0),
    st.floats(-12, -3).map(lambda power: 10.0**power),
    st.floats(0, np.pi),
    st.floats(-12, -3).map(lambda power: np.pi - 10.0**power),
    st.just(np.pi),
)


def axis_of(seed: int) -> np.ndarray:
    vector = np.random.default_rng(seed).normal(size=3)
    return vector / np.linalg.norm(vector)


@given(SEEDS, ANGLES)
def test_exponential_is_a_rotation_and_that_of_scipy(seed: int, angle: float) -> None:
    vector = angle * axis_of(seed)
    rotation = so3_exp(vector)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=ROUNDING)
    assert np.linalg.det(rotation) > 0
    np.testing.assert_allclose(rotation, Rotation.from_rotvec(vector).as_matrix(), atol=ROUNDING)
    np.testing.assert_allclose(so3_exp(-vector), rotation.T, atol=ROUNDING)
    np.testing.assert_allclose(so3_exp(2 * vector), rotation @ rotation, atol=ROUNDING)


@given(SEEDS, ANGLES)
def test_logarithm_undoes_the_exponential(seed: int, angle: float) -> None:
    vector = angle * axis_of(seed)
    found = so3_log(so3_exp(vector))
    # The entries of the matrix are rounded at 1e-16; a turn is known that well, everywhere from none to a half.
    if np.pi - angle < 1e-7:  # either sign
        found = found if found @ vector > 0 else -found
    np.testing.assert_allclose(found, vector, atol=ROUNDING)
    assert np.linalg.norm(found) <= np.pi + ROUNDING


@given(SEEDS)
def test_batches_of_rotations_are_their_parts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(2, 3, 3)) * rng.choice([0.0, 1e-9, 0.5], (2, 3, 1))
    rotations = so3_exp(vectors)
    assert rotations.shape == (2, 3, 3, 3)
    for index in np.ndindex(2, 3):
        np.testing.assert_allclose(rotations[index], so3_exp(vectors[index]), atol=ROUNDING)
    np.testing.assert_allclose(so3_log(rotations), vectors, atol=ROUNDING)
    assert so3_log(np.zeros((0, 3, 3))).shape == (0, 3)


def test_a_mixed_batch_of_small_and_half_turns() -> None:
    vectors = np.array([[0.0, 0.0, 0.0], [np.pi, 0.0, 0.0], [0.0, 3.0, 0.0], [1e-10, 0.0, 0.0]])
    with np.errstate(all="raise"):
        found = so3_log(so3_exp(vectors))
    np.testing.assert_allclose(np.abs(found), vectors, atol=ROUNDING)


@given(SEEDS)
def test_hat_is_the_cross_product(seed: int) -> None:
    v, w = np.random.default_rng(seed).normal(size=(2, 5, 3))
    np.testing.assert_allclose((hat(v) @ w[..., None])[..., 0], np.cross(v, w), atol=ROUNDING)


@given(st.floats(-1e4, 1e4))
def test_wrapped_angles_point_the_same_way(angle: float) -> None:
    found = wrap_angle(angle)
    assert -np.pi < found <= np.pi
    np.testing.assert_allclose(
        rotation_2d(found), rotation_2d(angle), atol=1e-11
    )  # 2 pi is rounded 1600 times
    np.testing.assert_array_equal(wrap_angle(np.array([[angle]])), [[found]])
    if -np.pi < angle <= np.pi:
        assert found == angle  # untouched, to the last bit


def test_wrapped_angles_at_the_border() -> None:
    assert wrap_angle(-np.pi) == np.pi
    assert wrap_angle(np.pi) == np.pi
    above = np.nextafter(-np.pi, 0.0)
    assert wrap_angle(above) == above
    assert np.isnan(wrap_angle(np.nan))


def simple_polygon(rng: np.random.Generator) -> np.ndarray:
    """Star-shaped about the origin, so that no edges cross; far from the origin as on a large map."""
    angle = np.sort(rng.uniform(0, 2 * np.pi, 12)) + np.arange(12) * 1e-3
    radius = rng.uniform(0.3, 2.0, 12)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]) + rng.uniform(-1e3, 1e3, 2)


@pytest.mark.parametrize(
    "corners", [[], [[1.0, 2.0]], [[0.0, 0.0], [1.0, 1.0]], [[0.0, 0.0], [1.0, 1.0], [3.0, 3.0]]]
)
def test_what_has_no_area_has_no_second_moments(corners: list[list[float]]) -> None:
    outline = np.reshape(corners, (-1, 2))
    assert polygon_area(outline) == pytest.approx(0.0)
    assert np.isnan(polygon_second_moments(outline)).all()
    mean = np.mean(outline, axis=0) if corners else np.full(2, np.nan)
    np.testing.assert_allclose(polygon_centroid(outline), mean)


@given(SEEDS)
def test_polygons_are_those_of_shapely(seed: int) -> None:
    outline = simple_polygon(np.random.default_rng(seed))
    other = shapely.Polygon(outline)
    # Coordinates of 1e3 m are rounded at 1e-13 m, and Shapely multiplies them by a perimeter of 20 m.
    area = polygon_area(outline)
    assert abs(area) == pytest.approx(other.area, abs=1e-8)
    assert area > 0 or not shapely.is_ccw(other.exterior)
    assert polygon_area(outline[::-1]) == pytest.approx(-area, abs=1e-8)
    if other.area > 0.1:
        np.testing.assert_allclose(polygon_centroid(outline), other.centroid.coords[0], atol=1e-7)
        np.testing.assert_allclose(polygon_centroid(outline[::-1]), polygon_centroid(outline), atol=1e-9)


@given(SEEDS)
def test_second_moments_are_those_of_a_triangulation(seed: int) -> None:
    """Truth by Shapely's triangles, which tile a convex outline, each with its moments about its own centroid."""
    hull = shapely.MultiPoint(simple_polygon(np.random.default_rng(seed))).convex_hull
    if hull.area < 0.1:
        return
    outline = np.array(hull.exterior.coords)[:-1]
    whole, centre = np.zeros((2, 2)), np.array(hull.centroid.coords[0])
    for part in shapely.delaunay_triangles(hull).geoms:
        corners = np.array(part.exterior.coords)[:3]
        middle = corners.mean(axis=0)
        own = (corners - middle).T @ (corners - middle) / 12
        whole += part.area * (own + np.outer(middle - centre, middle - centre))
    np.testing.assert_allclose(polygon_second_moments(outline), whole / hull.area, atol=1e-6)


def test_second_moments_of_an_angle_iron() -> None:
    """A square of 2 m less one of 1 m, by the parallel-axis theorem."""
    outline = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2.0]])
    centre = (4 * 1.0 - 1 * 1.5) / 3
    own = (4 * (4 / 12 + (1.0 - centre) ** 2) - (1 / 12 + (1.5 - centre) ** 2)) / 3
    mixed = (4 * (1.0 - centre) ** 2 - (1.5 - centre) ** 2) / 3
    np.testing.assert_allclose(polygon_second_moments(outline), [[own, mixed], [mixed, own]], atol=ROUNDING)


def test_second_moments_of_a_rectangle() -> None:
    outline = np.array([[0, 0], [3, 0], [3, 2], [0, 2.0]]) + 100.0
    expected = np.diag([3**2 / 12, 2**2 / 12])
    np.testing.assert_allclose(polygon_second_moments(outline), expected, atol=1e-10)
    np.testing.assert_allclose(polygon_second_moments(outline[::-1]), expected, atol=1e-10)


def test_polygons_without_area() -> None:
    line = np.array([[0, 0], [1, 1], [2, 2.0]])
    assert polygon_area(line) == 0.0
    np.testing.assert_array_equal(polygon_centroid(line), [1, 1])
    np.testing.assert_array_equal(polygon_centroid(line[:1]), line[0])
    assert polygon_area(line[:2]) == 0.0


def test_area_vectors_of_a_closed_surface_add_up_to_nothing() -> None:
    cube = np.array([[x, y, z] for x in (0, 1.0) for y in (0, 2.0) for z in (0, 3.0)])
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    vectors = area_vectors(cube, quads)
    np.testing.assert_allclose(vectors[0], [-6, 0, 0], atol=ROUNDING)
    np.testing.assert_allclose(vectors.sum(axis=0), 0, atol=ROUNDING)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    halves = area_vectors(cube, triangles)
    np.testing.assert_allclose(halves[:6] + halves[6:], vectors, atol=ROUNDING)
    normals = vertex_normals(np.vstack([cube, [9, 9, 9.0]]), quads)
    # Each corner has faces of 6, 3 and 2 m^2, along x, y and z.
    expected = (cube > 0) * 2.0 - 1
    np.testing.assert_allclose(normals[:8], expected * np.array([6, 3, 2]) / 7, atol=ROUNDING)
    np.testing.assert_array_equal(normals[8], 0)


def test_directions_are_spread_evenly_over_the_sphere() -> None:
    ways = sphere_directions(200)
    np.testing.assert_allclose(np.linalg.norm(ways, axis=1), 1.0, atol=ROUNDING)
    # Of an even distribution the mean is 0, and the second moments are a third: those of heights exactly, but for 1 / n^2.
    np.testing.assert_allclose(ways.mean(axis=0), 0.0, atol=0.01)
    np.testing.assert_allclose(ways.T @ ways / 200, np.eye(3) / 3, atol=0.01)
    # No two of them are nearer than half of what 200 discs of the sphere's area are wide.
    nearest = np.sort(np.arccos(np.clip(ways @ ways.T, -1, 1)), axis=1)[:, 1]
    assert nearest.min() > 0.5 * 2 * np.arccos(1 - 2 / 200)
