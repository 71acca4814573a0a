from __future__ import annotations

import math

import numpy as np
import pytest

from visuohaptic.core import BaseState, InputError, Motion, Reason
from visuohaptic.core.geometry import compose_2d, relative_2d
from visuohaptic.sensing.scene import EgoMotionFilter, FloorMotionSettings, fit_planar_motion
from visuohaptic.sensing.scene.floor_motion import compose_covariance


def moved_points(rng, motion, count, sigma):
    """Where the same points of the floor are before and after the platform's motion, by its definition."""
    world = rng.uniform([0.05, -0.15], [0.2, 0.15], (count, 2))
    c, s = math.cos(motion[2]), math.sin(motion[2])
    rotation = np.array([[c, -s], [s, c]])
    after = (world - motion[:2]) @ rotation  # R^T (p - t)
    return world + rng.normal(0, sigma, (count, 2)) / np.sqrt(2), after + rng.normal(
        0, sigma, (count, 2)
    ) / np.sqrt(2)


def test_chain_and_inverse_are_the_group_of_planar_motions():
    rng = np.random.default_rng(0)

    def matrix(m):
        c, s = math.cos(m[2]), math.sin(m[2])
        return np.array([[c, -s, m[0]], [s, c, m[1]], [0, 0, 1]])

    for _ in range(20):
        a, b = rng.normal(0, 1, (2, 3))
        np.testing.assert_allclose(matrix(compose_2d(a, b)), matrix(a) @ matrix(b), atol=1e-12)
        np.testing.assert_allclose(relative_2d(a, compose_2d(a, b)), b, atol=1e-12)
        # Covariance against finite differences.
        p, q = (np.diag(rng.uniform(0.1, 1, 3)) for _ in range(2))
        by = [
            np.column_stack([np.subtract(f(1e-6 * e), f(-1e-6 * e)) / 2e-6 for e in np.eye(3)])
            for f in (lambda d, a=a, b=b: compose_2d(a + d, b), lambda d, a=a, b=b: compose_2d(a, b + d))
        ]
        expected = by[0] @ p @ by[0].T + by[1] @ q @ by[1].T
        np.testing.assert_allclose(compose_covariance(a, p, b, q), expected, atol=1e-6)


@pytest.mark.parametrize("wrong", [0.0, 0.4])
def test_covariance_is_that_of_repeated_fits(wrong):
    rng = np.random.default_rng(1)
    motion, sigma, count = np.array([0.02, -0.004, 0.05]), 4e-5, 80
    covariance = np.tile(sigma**2 * np.eye(2), (count, 1, 1))
    errors, declared = [], []
    for _ in range(150):
        before, after = moved_points(rng, motion, count, sigma)
        bad = int(wrong * count)
        # Half of the wrong ones agree with each other: a thing that stays before the camera.
        after[: bad // 2] = before[: bad // 2]
        after[bad // 2 : bad] += rng.normal(0, 0.01, (bad - bad // 2, 2))
        fit = fit_planar_motion(before, after, covariance, rng)
        assert fit.valid
        assert not fit.inliers[: bad // 2].any()
        errors.append(fit.motion - motion)
        declared.append(fit.covariance)
    spread = np.cov(np.array(errors).T)
    # 150 samples know a standard deviation to 6 %; three of that, and 10 % for the robust scale.
    ratio = np.sqrt(np.diag(spread) / np.diag(np.mean(declared, axis=0)))
    assert np.all((ratio > 0.75) & (ratio < 1.25)), ratio
    assert np.abs(np.mean(errors, axis=0) / np.sqrt(np.diag(spread) / 150)).max() < 4


def test_too_few_points_or_no_agreement_is_not_valid():
    rng = np.random.default_rng(2)
    covariance = np.tile(1e-10 * np.eye(2), (40, 1, 1))
    noise = rng.uniform(-0.1, 0.1, (2, 40, 2))
    assert not fit_planar_motion(noise[0], noise[1], covariance, rng).valid
    assert not fit_planar_motion(noise[0][:5], noise[0][:5], covariance[:5], rng).valid
    with pytest.raises(InputError, match="expected"):
        fit_planar_motion(noise[0], noise[1][:3], covariance, rng)
    with pytest.raises(InputError, match="min_fraction"):
        FloorMotionSettings(min_fraction=1.5)


def seen(t_s, motion, sigma=1e-5, valid=True):
    reason = Reason.OK if valid else Reason.LOST
    return Motion(t_s, valid, reason, motion[:2], float(motion[2]), sigma**2 * np.eye(3))


def test_the_filter_follows_a_circle_with_any_of_its_sources():
    dt, speed, turn, ahead = 1 / 30, 0.2, 0.8, 0.17
    for camera, wheels in ((True, True), (True, False), (False, True)):
        ego = EgoMotionFilter()
        base = np.zeros(3)
        offset = np.array([ahead, 0.0, 0.0])
        start = compose_2d(base, offset)
        for i in range(91):
            # Exact motion of the centre along an arc.
            if i:
                chord = np.array([math.sin(turn * dt), 1 - math.cos(turn * dt)]) * speed / turn
                new = compose_2d(base, (*chord, turn * dt))
            else:
                new = base
            step = relative_2d(compose_2d(base, offset), compose_2d(new, offset))
            base = new
            motion = ego.update(
                i * dt,
                floor=seen(i * dt, step) if camera else None,
                odometry=BaseState(i * dt, 0, 0, 0, speed, turn) if wheels else None,
            )
        truth = relative_2d(start, compose_2d(base, offset))
        assert motion.valid
        # The wheels alone need some frames until the filter believes them.
        np.testing.assert_allclose(ego.pose, truth, atol=2e-3 if camera else 2e-2)


def test_slipping_wheels_are_noticed_and_the_floor_wins():
    ego, x = EgoMotionFilter(), 0.0
    for i in range(60):
        stuck = i >= 30
        step = np.array([0.0 if stuck else 0.1 / 30, 0, 0])
        x += step[0] if i else 0.0
        ego.update(i / 30, floor=seen(i / 30, step), odometry=BaseState(i / 30, 0, 0, 0, 0.1, 0.0))
        assert ego.agree or stuck
    assert not ego.agree
    assert ego.pose[0] == pytest.approx(x, abs=1e-3)


def test_nothing_measured_is_said_and_old_frames_are_stale():
    ego = EgoMotionFilter()
    assert ego.update(0.0).reason is Reason.NOT_ZEROED
    lost = ego.update(0.1, floor=seen(0.1, np.zeros(3), valid=False))
    assert not lost.valid
    assert lost.reason is Reason.LOST
    assert ego.update(0.1).reason is Reason.STALE


def test_points_that_slide_along_a_grain_widen_the_covariance():
    """Along x they are off by twice what they declare, across by a third of it."""
    rng, truth, declared = np.random.default_rng(8), np.array([0.004, -0.001, 0.01]), 1e-4
    pulls = []
    for _ in range(60):
        before, after = moved_points(rng, truth, 70, declared / 3)
        after[:, 0] += rng.normal(0, 2.2 * declared, 70)
        fit = fit_planar_motion(before, after, np.tile(declared**2 * np.eye(2), (70, 1, 1)), rng)
        assert fit.valid
        pulls.append((fit.motion - truth) / np.sqrt(np.diag(fit.covariance)))
    # 60 samples know a standard deviation to 9 %; what the gate cuts off the sandwich does not see: 1.6
    # along the grain where it was 2.9 without it.
    rms = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert np.all(rms < 1.75), rms
