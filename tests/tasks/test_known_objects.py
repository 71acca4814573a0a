"""Known objects in current laser points: claimed probabilities are calibrated."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import Estimate, HapticTag, VisuoHapticObject
from visuohaptic.core.objects import Geometry
from visuohaptic.tasks.mobile import FloorOutline, fit_outlines, known_objects, recognise
from visuohaptic.tasks.mobile.floor_outline import SIDE_M

from .laser_hits import VIEWS_M, box, cylinder, scans

#: Shift of all points by the map's cells, and error of a radius by the foam [m].
CELL_M, FOAM_M = 0.004, 0.001


def outline(kind: str, width_m: float) -> np.ndarray:
    count, turn = (16, 0.0) if kind == "round" else (4, np.pi / 4)
    angle = turn + np.arange(count) * 2 * np.pi / count
    radius = 0.5 * width_m * (1.0 if kind == "round" else np.sqrt(2.0))
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def hits(kind: str, width_m: float, rng: np.random.Generator) -> np.ndarray:
    """What a laser sees of it from both sides of the path: every tenth side is in part hidden by what stands beside it."""
    shape = cylinder(0.5 * width_m) if kind == "round" else box(width_m, width_m, rng.uniform(-0.1, 0.1))
    points = scans(shape, rng) + CELL_M * rng.standard_normal(2)
    if rng.random() < 0.1:
        points = points[points[:, 1] > rng.uniform(-0.5, 0.0) * width_m]
    return points


def stored(
    name: str, kind: str, width_m: float, friction_N: float, rng: np.random.Generator
) -> VisuoHapticObject:
    """As a push left it: round ones measured by the foam, half of the others by the laser alone."""
    sigma_m = 2 * FOAM_M if kind == "round" else SIDE_M if rng.random() < 0.5 else 1.5 * FOAM_M
    width_m = max(width_m + sigma_m * rng.standard_normal(), 0.04)
    tag = HapticTag(static_friction_N=Estimate(friction_N, 0.1), fixed=False)
    # The depth of a box is that of the laser.
    state = {"width_sigma_m": sigma_m, "depth_sigma_m": sigma_m if kind == "round" else SIDE_M}
    return VisuoHapticObject(
        name, geometry=Geometry(footprint_m=outline(kind, width_m)), tag=tag, state=state
    )


def seen(points_m: np.ndarray) -> tuple[FloorOutline, FloorOutline]:
    return fit_outlines(points_m, VIEWS_M, 0.0)


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
    found = recognise([seen(hits(kind, width, rng)) for _, kind, width, _ in here], known)
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
    """A box of 16 cm stands there, one of 17.5 cm is stored: with a width by the laser it may be the same."""
    monkeypatch.setattr(known_objects, "CONFIDENT_PROBABILITY", 0.0)
    points = hits("square", 0.16, np.random.default_rng(seed))
    tag, probability = HapticTag(static_friction_N=Estimate(2.0, 0.1), fixed=False), []
    for sigma_m in (0.010, 0.0015):
        state = {"width_sigma_m": sigma_m, "depth_sigma_m": 0.06}
        one = VisuoHapticObject(
            "a", geometry=Geometry(footprint_m=outline("square", 0.175)), tag=tag, state=state
        )
        match = recognise([seen(points)], [one])[0]
        assert match is not None
        probability.append(match[1])
    assert probability[1] < probability[0]
