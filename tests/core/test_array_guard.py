"""Public functions reject arrays of a wrong type or shape in one line."""

from __future__ import annotations

import pickle
from fractions import Fraction

import numpy as np
import pytest
from jaxtyping import Bool, Float, Int, UInt8

from visuohaptic.core import InputError, polygon_area, so3_exp, vertex_normals
from visuohaptic.core import geometry as module
from visuohaptic.core.front_door.array_guard import guarded


@guarded
def measure(
    points_m: Float[np.ndarray, "n 2"],
    weights: Float[np.ndarray, " n"] | float = 1.0,
    faces: Int[np.ndarray, "f 3"] | None = None,
    image: UInt8[np.ndarray, "rows columns *colour"] | None = None,
    keep: Bool[np.ndarray, " n"] | None = None,
) -> tuple[object, ...]:
    return points_m, weights, faces, image, keep


POINTS = np.arange(6.0).reshape(3, 2)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"points_m": POINTS.T}, r"points_m: found shape \(2, 3\), expected numbers \(n, 2\)"),
        ({"points_m": POINTS[0]}, r"points_m: found shape \(2,\), expected numbers \(n, 2\)"),
        ({"points_m": None}, "points_m: found None"),
        ({"points_m": "points"}, "points_m: found 'points'"),
        ({"points_m": [[1, 2], [3]]}, "points_m: found list with parts of unequal length"),
        ({"points_m": POINTS + 1j}, "points_m: found an array of complex128"),
        ({"points_m": POINTS.astype(object)}, "points_m: found an array of object"),
        ({"points_m": np.ma.masked_array(POINTS)}, "points_m: found masked"),
        ({"points_m": POINTS, "weights": np.ones(4)}, r"weights: found shape \(4,\) with n = 3"),
        (
            {"points_m": POINTS, "faces": np.zeros((2, 3))},
            "faces: found an array of float64, expected integers",
        ),
        ({"points_m": POINTS, "faces": np.zeros((2, 4), int)}, r"faces: found shape \(2, 4\)"),
        (
            {"points_m": POINTS, "image": np.zeros((4, 5))},
            "image: found an array of float64, expected uint8 values",
        ),
        ({"points_m": POINTS, "image": np.zeros(4, np.uint8)}, r"image: found shape \(4,\)"),
        ({"points_m": POINTS, "keep": np.ones(3)}, "keep: found an array of float64, expected truth values"),
    ],
)
def test_another_kind_or_shape_is_refused(arguments, said):
    with pytest.raises(InputError, match=rf"^measure: {said}"):
        measure(**arguments)


def test_the_same_numbers_in_another_type_are_converted():
    for other in (POINTS.astype(">f8"), POINTS.astype(np.float32), POINTS.astype(int), POINTS.tolist()):
        points, *_ = measure(other)
        assert points.dtype == np.dtype("=f8")
        assert points.dtype.isnative
        np.testing.assert_array_equal(points, POINTS)
    assert measure(POINTS)[0] is POINTS, "nothing is copied where nothing has to change"
    assert measure(POINTS, 2.5)[1] == pytest.approx(2.5)
    _, _, faces, *_ = measure(POINTS, faces=np.zeros((2, 3), ">i4"))
    assert faces.dtype == np.dtype("=i4")
    for shape in ((4, 5), (4, 5, 3)):
        assert measure(POINTS, image=np.zeros(shape, np.uint8))[3].shape == shape


def test_what_cannot_be_computed_names_the_array_and_mistakes_of_ours_stay_visible():
    @guarded
    def solve(matrix: Float[np.ndarray, "3 3"]) -> np.ndarray:
        return np.linalg.inv(matrix)

    @guarded
    def wrong(matrix: Float[np.ndarray, "3 3"]) -> float:
        raise KeyError("ours")

    @guarded
    def shade(image: UInt8[np.ndarray, "rows columns"], gain: float) -> Fraction:
        return Fraction(int(image.max()), int(gain))

    @guarded
    def pick(values: Float[np.ndarray, " n"], index: Int[np.ndarray, " m"]) -> np.ndarray:
        return values[index]

    with pytest.raises(InputError, match="solve: matrix: found 3 equal rows"):
        solve(np.zeros((3, 3)))
    with pytest.raises(InputError, match=r"solve: cannot be computed from these arrays \(Singular matrix\)"):
        solve(np.diag([1.0, 1.0, 0.0]))
    # Grey levels and cells may all be equal: another argument is at fault.
    with pytest.raises(InputError, match=r"shade: cannot be computed from these arrays \(Fraction"):
        shade(np.zeros((4, 4), np.uint8), 0.0)
    with pytest.raises(InputError, match="pick: values: found no values"):
        pick(np.zeros(0), np.zeros(2, int))
    with pytest.raises(InputError, match="pick: index: found integers from 1 to 9, which are not indices"):
        pick(np.arange(3.0), np.array([1, 9]))
    for value, said in ((np.nan, "found NaN or infinity"), (1e200, "found 1e.200, expected at most")):
        with pytest.raises(InputError, match=said):
            wrong(np.diag([value, 1.0, 1.0]))


def test_public_names_are_guarded_and_stay_one_object():
    import visuohaptic.core as core

    assert core.so3_exp is so3_exp
    assert so3_exp is not module.so3_exp, "inside the library nothing is checked twice"
    assert pickle.dumps(so3_exp), "its name leads to the same object"
    with pytest.raises(InputError, match=r"so3_exp: .*found shape"):
        so3_exp(np.zeros(4))
    with pytest.raises(InputError, match="polygon_area"):
        polygon_area(np.zeros((3, 3)))
    with pytest.raises(InputError, match="faces: found an array of float64"):
        vertex_normals(np.zeros((3, 3)), np.zeros((1, 3)))
