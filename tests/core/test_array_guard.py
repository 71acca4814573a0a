"""Public functions reject arrays of a wrong type or shape in one line."""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from jaxtyping import Bool, Float, Int, UInt8

from visuohaptic import (
    FoamSensor,
    HapticClassifier,
    HapticTag,
    MovableObject,
    OccupancyMap,
    PlanningProblem,
    RobotModel,
    make_plan,
)
from visuohaptic.core import Camera, FrameSource, InputError, polygon_area, so3_exp, vertex_normals
from visuohaptic.core import geometry as module
from visuohaptic.core.front_door.array_guard import guard_class, guarded


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


@guarded
def weigh(
    path: Path | str = "x",
    *,
    count: int = 1,
    mass_kg: float = 1.0,
    places: Sequence[tuple[float, float]] = (),
    offset_m: tuple[float, float] = (0.0, 0.0),
    names: tuple[str, ...] = (),
    sigma_N: float | Float[np.ndarray, " n"] = 0.0,
    camera: Camera | None = None,
    source: FrameSource | None = None,
    mode: Literal["fast", "exact"] = "fast",
    report: Callable[[str], None] | None = None,
    fails: Exception | None = None,
) -> float:
    if fails is not None:
        raise fails
    raise AttributeError("'int' object has no attribute 'mean'")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"path": True}, "path: found True, expected Path or str"),
        ({"path": [1]}, r"path: found \[1\], expected Path or str"),
        ({"count": 1.5}, "count: found 1.5, expected int"),
        ({"count": True}, "count: found True, expected int"),
        ({"mass_kg": "2"}, "mass_kg: found '2', expected float"),
        ({"places": "ab"}, r"places: found 'ab', expected Sequence\[tuple\[float, float\]\]"),
        ({"places": np.full((2, 3), np.nan)}, r"places: found array\("),
        ({"places": np.array(1.0)}, r"places: found array\("),
        (
            {"offset_m": np.zeros(0)},
            r"offset_m: found array\(\[\], dtype=float64\), expected tuple\[float, float\]",
        ),
        ({"names": np.zeros((2, 2))}, r"names: found array\(.*, expected tuple\[str, \.\.\.\]"),
        ({"sigma_N": "x"}, "sigma_N: found 'x', expected float or Float"),
        ({"sigma_N": None}, "sigma_N: found None, expected float or Float"),
        ({"sigma_N": [[1], [2, 3]]}, r"sigma_N: found \[\[1\], \[2, 3\]\], expected float or Float"),
        ({"places": [(1, 2), (3,)]}, r"places: found \[\(1, 2\), \(3,\)\]"),
        ({"camera": 3}, "camera: found 3, expected Camera or None"),
        ({"source": []}, r"source: found \[\], expected FrameSource or None"),
        ({"mode": "slow"}, "mode: found 'slow', expected Literal"),
        ({"report": 3}, "report: found 3, expected Callable"),
    ],
)
def test_a_foreign_error_names_the_argument_of_another_type(arguments, said):
    with pytest.raises(InputError, match=rf"^weigh: {said}") as refused:
        weigh(**arguments)
    assert isinstance(refused.value.__cause__, AttributeError)


@pytest.mark.parametrize(
    "arguments",
    [
        {"path": Path("x"), "count": np.int64(3), "mass_kg": 2, "places": [[1, 2], np.zeros(2)]},
        {"mass_kg": np.float32(2), "camera": Camera.simple(8, 6, 5.0), "report": print, "mode": "exact"},
        {"places": np.zeros((4, 2)), "offset_m": [1, 2.0], "sigma_N": np.ones(3)},
    ],
)
def test_where_all_arguments_are_as_annotated_the_error_is_that_of_the_function(arguments):
    with pytest.raises(AttributeError, match="has no attribute 'mean'"):
        weigh(**arguments)
    with pytest.raises(InputError, match=r"^file.txt: is empty"):
        weigh(**arguments, fails=InputError("file.txt", "is empty"))


def test_a_refusal_of_a_function_inside_is_told_by_the_one_that_was_called():
    @guarded
    def inner(path: str) -> str:
        return path.lower()

    @guarded
    def outer(location: str) -> str:
        return inner(location)

    with pytest.raises(InputError, match=r"^outer: location: found 3, expected str"):
        outer(3)


def test_creation_is_guarded_and_names_the_class():
    @dataclass
    class Load:
        mass_kg: float
        where_m: Float[np.ndarray, "3"]

        def __post_init__(self) -> None:
            self.total = self.mass_kg * 2 + self.where_m.sum()

        @classmethod
        def parse(cls, text: str) -> Load:
            return cls(float(text.strip("kg ")), np.ones(3))

    guard_class(Load)
    guard_class(Load)  # once only
    assert Load(1.0, np.ones(3)).total == pytest.approx(5.0)
    with pytest.raises(InputError, match=r"^Load: mass_kg: found None, expected float"):
        Load(None, np.ones(3))
    with pytest.raises(InputError, match=r"^Load: where_m: found shape \(2,\)"):
        Load(1.0, [1.0, 2.0])
    with pytest.raises(TypeError, match="missing 1 required"):
        Load(1.0)
    assert Load.parse("2 kg").mass_kg == 2.0
    with pytest.raises(InputError, match=r"^Load.parse: text: found None, expected str"):
        Load.parse(None)
    with pytest.raises(ValueError, match="could not convert") as error:
        Load.parse("two")
    assert not isinstance(error.value, InputError)


def test_an_inherited_class_method_is_guarded_without_a_use_of_its_base():
    code = "import visuohaptic; visuohaptic.FingerSensor.load(None)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stderr.splitlines()[-1].endswith("FoamSensor.load: path: found None, expected Path or str")


@pytest.mark.parametrize("made", [FoamSensor, HapticClassifier, OccupancyMap])
def test_class_methods_of_public_classes_are_guarded(made):
    for path in (None, [1, 2]):
        with pytest.raises(
            InputError, match=rf"^{made.__name__}\.load: path: found .*, expected Path or str"
        ):
            made.load(path)


@pytest.mark.parametrize(
    ("robot", "tag", "said"),
    [
        ({"radius_m": 0.17}, None, r"problem.robot: found \{'radius_m': 0.17\}, expected RobotModel"),
        (RobotModel([0.17]), None, r"problem.robot.radius_m: found \[0.17\], expected float"),
        (
            RobotModel(0.17),
            HapticTag(static_friction_N=8.1),
            r"problem.objects\[0\].tag.static_friction_N: found 8.1, expected Estimate or None",
        ),
    ],
)
def test_a_foreign_error_names_the_field_inside_an_argument(robot, tag, said):
    walls = np.zeros((40, 60), dtype=bool)
    walls[:, 30], walls[16:24, 28:34] = True, True
    walls[10:30, 30] = False
    box = MovableObject("box", np.array([[1.4, 0.8], [1.7, 0.8], [1.7, 1.2], [1.4, 1.2]]), tag)
    problem = PlanningProblem(
        OccupancyMap(walls, 0.05), robot, np.array([0.5, 1.0]), np.array([2.4, 1.0]), (box,)
    )
    with pytest.raises(InputError, match=rf"^make_plan: {said}$"):
        make_plan(problem)


def test_records_that_are_as_annotated_leave_the_error_of_the_function():
    robot = RobotModel(1)  # an integer is a number
    problem = PlanningProblem(OccupancyMap(np.zeros((9, 9), bool), 1.0), robot, np.ones(2), np.ones(2))

    @guarded
    def fail(problem: PlanningProblem, others: Sequence[object] = ()) -> None:
        raise AttributeError("a mistake of ours")

    with pytest.raises(AttributeError, match="a mistake of ours"):
        fail(problem, [problem, robot, None, 3])
