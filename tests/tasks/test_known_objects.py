"""Known objects in current laser points: claimed probabilities are calibrated."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import Estimate, HapticTag, VisuoHapticObject
from visuohaptic.core.objects import Geometry, Primitive, PrimitiveKind
from visuohaptic.tasks.mobile import known_objects, recognise
from visuohaptic.tasks.mobile.footprint_after_push import LASER_WIDTH_SIGMA_M, width_sigma_m

#: Noise of the laser, shift of all points of a side by the map's cells, and error of a radius by the foam [m].
LASER_M, CELL_M, FOAM_M = 0.008, 0.004, 0.001


def outline(kind: str, width_m: float) -> np.ndarray:
    count, turn = (16, 0.0) if kind == "round" else (4, np.pi / 4)
    angle = turn + np.arange(count) * 2 * np.pi / count
    radius = 0.5 * width_m * (1.0 if kind == "round" else np.sqrt(2.0))
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def hits(kind: str, width_m: float, rng: np.random.Generator) -> np.ndarray:
    """What a laser sees of it from along x: its near side, some of it hidden by what stands beside it."""
    seen = width_m + CELL_M * rng.standard_normal() - abs(0.01 * rng.standard_normal())
    beside = rng.uniform(-0.5, 0.5, 80) * seen
    depth = -np.sqrt(np.maximum(0.25 * width_m**2 - beside**2, 0.0)) if kind == "round" else -0.5 * width_m
    ahead = depth + CELL_M * rng.standard_normal() + np.zeros(80)
    return np.column_stack([ahead, beside]) + LASER_M * rng.standard_normal((80, 2)) + (5.0, 0.0)


def stored(
    name: str, kind: str, width_m: float, friction_N: float, rng: np.random.Generator
) -> VisuoHapticObject:
    """As a push left it: round ones measured by the foam, half of the others by the laser alone."""
    shape = None
    if kind == "round":
        width_m = width_m + 2 * FOAM_M * rng.standard_normal()
        shape = Primitive(
            PrimitiveKind.CIRCLE, np.array([0.1, 0.0, 0.5 * width_m]), np.diag([1e-6, 1e-8, FOAM_M**2]), 0.98
        )
    elif rng.random() < 0.5:
        width_m = max(width_m + LASER_WIDTH_SIGMA_M * rng.standard_normal(), 0.04)
    else:
        shape = Primitive(
            PrimitiveKind.SEGMENT,
            np.array([0.01, -0.5 * width_m, 0.01, 0.5 * width_m]),
            1e-6 * np.eye(4),
            0.98,
        )
    tag = HapticTag(static_friction_N=Estimate(friction_N, 0.1), fixed=False, primitive=shape)
    return VisuoHapticObject(name, geometry=Geometry(footprint_m=outline(kind, width_m)), tag=tag)


def claims(house: int) -> list[tuple[float, bool]]:
    """Probability and correctness of what is recognised in a house; one object in five was not there before."""
    rng = np.random.default_rng([41, house])
    here = [
        (str(k), "round" if rng.random() < 0.5 else "square", float(rng.uniform(0.06, 0.3)), 2.0**k)
        for k in range(3)
    ]
    known = [stored(*one, rng) for one in here if rng.random() > 0.2]
    gone = ("gone", "square", float(rng.uniform(0.06, 0.3)), 16.0)
    known += [stored(*gone, rng)] * bool(rng.random() < 0.3)
    found = recognise([hits(kind, width, rng) for _, kind, width, _ in here], known, 0.0)
    return [
        (match[1], match[0].id == one[0]) for one, match in zip(here, found, strict=True) if match is not None
    ]


def test_what_is_claimed_with_a_probability_is_right_that_often() -> None:
    found = [one for house in range(50) for one in claims(house)]
    probability, right = np.array(found).T
    assert len(found) > 50  # of 120 that were there before
    expected, deviation = probability.mean(), np.sqrt(np.sum(probability * (1 - probability))) / len(found)
    assert right.mean() > expected - 2 * deviation, (right.mean(), expected)


@pytest.mark.parametrize("seed", range(6))
def test_a_box_of_another_width_is_refused_the_more_the_better_the_stored_width_is_known(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A box of 16 cm stands there, one of 20 cm is stored: with a width by the laser it may be the same."""
    monkeypatch.setattr(known_objects, "CONFIDENT_PROBABILITY", 0.0)
    segment = Primitive(PrimitiveKind.SEGMENT, np.array([0.0, 0.0, 0.0, 0.2]), 1e-6 * np.eye(4), 1.0)
    points = hits("square", 0.16, np.random.default_rng(seed))
    probability = {}
    for name, shape in (("laser", None), ("foam", segment)):
        tag = HapticTag(static_friction_N=Estimate(2.0, 0.1), fixed=False, primitive=shape)
        one = VisuoHapticObject("a", geometry=Geometry(footprint_m=outline("square", 0.2)), tag=tag)
        match = recognise([points], [one], 0.0)[0]
        assert match is not None
        probability[name] = match[1]
    assert probability["foam"] < probability["laser"]


def test_the_standard_deviation_of_a_width_is_that_of_the_shape_that_gave_it() -> None:
    segment = Primitive(
        PrimitiveKind.SEGMENT, np.array([0.0, 0.0, 0.0, 0.2]), np.diag([1.0, 4.0, 1.0, 9.0]) * 1e-6, 1.0
    )
    circle = Primitive(PrimitiveKind.CIRCLE, np.array([0.1, 0.0, 0.1]), np.diag([1.0, 1.0, 4.0]) * 1e-6, 1.0)
    corner = Primitive(PrimitiveKind.CORNER, np.array([0.1, 0.0, -1.5, 0.5]), np.eye(4) * 1e-6, 1.0)
    assert width_sigma_m(segment) == pytest.approx(np.sqrt(13e-6))
    assert width_sigma_m(circle) == pytest.approx(4e-3)
    assert width_sigma_m(corner) == width_sigma_m(None) == LASER_WIDTH_SIGMA_M
