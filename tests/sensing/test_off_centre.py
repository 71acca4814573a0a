"""Off-centre pushes against exact limit surfaces of points, and a stiff fast push against Newton's law."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from visuohaptic.core import Primitive, PrimitiveKind
from visuohaptic.sensing.push import PushRecord, tag_from_push
from visuohaptic.sensing.push.off_centre import LEVER, LEVER_SIGMA, straight_push_factor

WIDTH_M = 0.16
FACE = Primitive(PrimitiveKind.SEGMENT, np.array([0.0, -0.5 * WIDTH_M, 0.0, 0.5 * WIDTH_M]), np.eye(4), 1.0)


def bottom(name: str, deep: float = 1.0) -> np.ndarray:
    """Points of one weight each: a bottom that rests evenly, or on feet at its corners."""
    even = (np.arange(30) + 0.5) / 30.0 - 0.5 if name == "even" else np.array([-0.5, 0.5])
    return WIDTH_M * np.stack(np.meshgrid(deep * even, even), axis=-1).reshape(-1, 2)


def lever(points: np.ndarray) -> float:
    """Of the ellipsoid that has the exact force at three tenths of the width, by the width."""
    return 0.3 / float(np.sqrt(least_force(points, 0.3 * WIDTH_M) ** -2 - 1.0))


def least_force(points: np.ndarray, arm_m: float) -> float:
    """Least force along x, ``arm_m`` beside the centre, that slides the points, by their whole friction.

    Of all motions that the force's place takes along by 1 the one that takes least power (maximum dissipation).
    """

    def power(motion: np.ndarray) -> float:
        side, turn = motion
        # Along x the point at (0, arm) goes by 1: the middle goes by 1 + turn arm.
        x, y = 1.0 + turn * arm_m - turn * points[:, 1], side + turn * points[:, 0]
        return float(np.hypot(x, y).mean())

    return float(
        minimize(power, [0.0, -1.0], method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9}).fun
    )


@pytest.mark.parametrize("name", ["even", "feet"])
@pytest.mark.parametrize("part", [0.1, 0.3, 0.5])
def test_a_corner_takes_less_by_the_exact_limit_surface(name: str, part: float) -> None:
    """Within two deviations, wherever a square bottom rests."""
    factor, sigma = straight_push_factor(np.array([0.02 + part * WIDTH_M]), 0.02, FACE)
    assert abs(factor - 1.0 / least_force(bottom(name), part * WIDTH_M)) < 2.0 * sigma


def test_the_lever_is_that_of_a_square_bottom_between_all_and_its_corners() -> None:
    even, feet = (lever(bottom(name)) for name in ("even", "feet"))
    assert pytest.approx(0.5 * (even + feet), rel=0.05) == LEVER
    deep = np.log([lever(bottom(name, 2**0.5)) / lever(bottom(name, 0.5**0.5)) for name in ("even", "feet")])
    of_depth, of_load = 0.5 * float(np.mean(deep)), (feet - even) / np.sqrt(12.0) / LEVER
    assert pytest.approx(np.hypot(of_depth, of_load), rel=0.1) == LEVER_SIGMA


def test_without_ends_of_a_face_nothing_is_known() -> None:
    line = Primitive(PrimitiveKind.LINE, np.zeros(3), np.eye(3), 1.0)
    for centre, shape, place in (
        (None, FACE, 0.05),
        (0.0, line, 0.05),
        (0.0, FACE, np.nan),
        (0.0, None, 0.05),
    ):
        assert straight_push_factor(np.array([place]), centre, shape) == (1.0, 0.0)


def coulomb(phase: float, stiffness: float = 1200.0) -> PushRecord:
    """A wide face, pushed fast: between two frames the force grows by a quarter of the friction (5.2 N, at rest 5.5)."""
    step, speed, mass = 1e-5, 0.04, 1.5
    x, y, v, rows = 0.0, 0.0, 0.0, []
    frames = iter((np.arange(60) + phase) / 30.0)
    frame = next(frames)
    for t in np.arange(0.0, 1.4, step):
        x = speed * min(t, 1.2) - 0.003
        force = stiffness * max(x - y, 0.0)
        if v > 0.0 or force > 5.5:
            v = max(v + step * (force - 5.2) / mass, 0.0)
        y += step * v
        if t >= frame:
            rows.append((t, force, max(x - y, 0.0), x))
            frame = next(frames)
    t, force, depth, travel = np.array(rows).T
    rng, nothing = np.random.default_rng(int(100 * phase)), np.full(len(t), np.nan)
    return PushRecord(
        t, np.ones(len(t), dtype=bool), force * (1 + 0.005 * rng.standard_normal(len(t))), np.full(len(t), 0.02), 0.01,
        depth + 1e-5 * rng.standard_normal(len(t)), np.full(len(t), 1e-5), travel, 0 * t, nothing, nothing,
    )  # fmt: skip


def test_what_breaks_away_below_the_dynamic_friction_is_seen_to_go() -> None:
    """Static friction is not read low where the force passes it in less than a frame."""
    found = [tag_from_push(coulomb(phase)).static_friction_N for phase in (np.arange(12) + 0.5) / 12]
    value, sigma = np.array([(one.value, one.sigma) for one in found if one is not None]).T
    assert len(value) == 12
    assert np.mean(value) == pytest.approx(5.5, rel=0.03)
    assert np.max(np.abs(value - 5.5) / sigma) < 3.0
    assert np.median(sigma) < 0.08 * 5.5
