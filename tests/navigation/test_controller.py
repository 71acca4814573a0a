"""The path tracker reaches its goal and stays on any path."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visuohaptic.core import BaseState, InputError, MobileBase
from visuohaptic.navigation.planning import FollowLimits, PathFollower


class Unicycle:
    """A base with limited accelerations; its wheels slip by a factor."""

    def __init__(self, x, y, heading, slip=1.0):
        self.x, self.y, self.heading, self.slip = x, y, heading, slip
        self.v = self.w = self.target_v = self.target_w = self.t = 0.0
        self.places, self.speeds = [], []

    def drive(self, speed_m_s, turn_rate_rad_s):
        self.target_v, self.target_w = speed_m_s, turn_rate_rad_s

    def stop(self):
        self.drive(0.0, 0.0)

    def state(self):
        return BaseState(self.t, self.x, self.y, self.heading, self.v, self.w)

    def wait(self, period_s):
        for _ in range(4):
            dt = period_s / 4
            self.v += min(max(self.target_v - self.v, -0.5 * dt), 0.5 * dt)
            self.w += min(max(self.target_w - self.w, -2.0 * dt), 2.0 * dt)
            self.heading += self.slip * self.w * dt
            self.x += self.slip * self.v * math.cos(self.heading) * dt
            self.y += self.slip * self.v * math.sin(self.heading) * dt
            self.t += dt
        self.places.append((self.x, self.y))
        self.speeds.append(self.v)


def off_path(path, places):
    import shapely

    return shapely.distance(shapely.LineString(path), shapely.points(np.array(places))).max()


def arrives(base: Unicycle, follower: PathFollower) -> bool:
    """Follow a path at 50 Hz for five minutes at most."""
    for _ in range(15_000):
        speed, turn = follower.command(base.state())
        if follower.done:
            return True
        base.drive(speed, turn)
        base.wait(0.02)
    return False


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 100_000), st.integers(2, 7), st.floats(0.9, 1.05))
def test_every_path_is_followed_to_its_goal(seed, corners, slip):
    rng = np.random.default_rng(seed)
    path = np.cumsum(rng.uniform(-0.7, 0.7, (corners, 2)), axis=0)
    base = Unicycle(path[0, 0] + 0.01, path[0, 1] - 0.01, rng.uniform(-3, 3), slip)
    assert isinstance(base, MobileBase)
    limits = FollowLimits()
    assert arrives(base, PathFollower(path, limits, heading_rad=0.5))
    assert math.hypot(base.x - path[-1, 0], base.y - path[-1, 1]) < limits.tolerance_m + 0.01
    assert abs(math.sin(0.5 * (base.heading - 0.5))) < 0.03
    # A stop from 0.3 m/s overshoots a corner by little; the start was 14 mm off.
    assert off_path(path, base.places) < 0.035


def test_clearance_is_kept_and_slows_down():
    # A slalom between posts: the corners of the path are 0.19 m from their centres' surface.
    posts = np.array([[0.6, 0.0], [1.2, 0.25], [1.8, 0.0]])
    path = np.array([[0.0, 0.0], [0.6, 0.26], [1.2, -0.01], [1.8, 0.26], [2.4, 0.0]])

    def clearance(point):
        return float(np.hypot(*(posts - point).T).min() - 0.05)

    limits = FollowLimits()
    base = Unicycle(0.0, 0.0, 0.0)
    assert arrives(base, PathFollower(path, limits, clearance=clearance))
    given_m = min(
        clearance(a + t * (b - a)) for a, b in itertools.pairwise(path) for t in np.linspace(0, 1, 200)
    )
    kept_m = min(clearance(np.array(p)) for p in base.places)
    assert kept_m > given_m - 0.02
    near = [
        v
        for p, v in zip(base.places, base.speeds, strict=True)
        if clearance(np.array(p)) < 1.2 * limits.radius_m
    ]
    assert max(near) < 1.5 * limits.speed_m_s(1.2 * limits.radius_m)


def test_speed_follows_the_cost_of_equation_4_1():
    limits = FollowLimits()
    assert limits.speed_m_s(0.17) == pytest.approx(0.05)
    assert limits.speed_m_s(0.51) == pytest.approx(0.3)
    assert limits.speed_m_s(math.inf) == pytest.approx(0.3)
    # Half way the cost is the mean: 2 / (20 + 3.33) m/s.
    assert limits.speed_m_s(0.34) == pytest.approx(2 / (20 + 10 / 3))


def test_a_single_point_is_reached_at_once():
    follower = PathFollower(np.array([[1.0, 2.0]]))
    assert follower.command(BaseState(0.0, 1.0, 2.0, 0.0, 0.0, 0.0)) == (0.0, 0.0)
    assert follower.done


def test_bad_paths_are_refused():
    with pytest.raises(InputError, match="path_m"):
        PathFollower(np.array([[0.0, np.nan]]))
    with pytest.raises(InputError, match="v_max"):
        FollowLimits(v_max_m_s=0.01)
