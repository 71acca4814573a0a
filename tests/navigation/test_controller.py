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


def told(follower, x, y, heading=0.0):
    return follower.command(BaseState(0.0, x, y, heading, 0.0, 0.0))


def test_commands_are_those_of_the_law():
    """Samson's law with its gains, along x: a tenth of a radian and 2 cm off; on the other side both signs change."""
    for side in (1.0, -1.0):
        follower = PathFollower(np.array([[0.0, 0.0], [5.0, 0.0]]))
        assert told(follower, 0.0, 0.0, 0.029 * side)[0] > 0.0  # no rotation at standstill
        speed, turn = told(follower, 1.0, 0.02 * side, 0.1 * side)
        v = 0.3 * math.cos(0.1)
        assert speed == pytest.approx(v)
        assert turn == pytest.approx(side * (-30.0 * v * 0.02 * math.sin(0.1) / 0.1 - 3.0 * 0.1))
        assert told(follower, 1.0, 0.5 * side)[1] == pytest.approx(-1.2 * side)
        # From 0.8 rad on it stands and turns until 0.03 rad are left.
        assert told(follower, 1.0, 0.0, 0.79 * side)[0] == pytest.approx(0.3 * math.cos(0.79))
        for error, rate in ((0.81, 1.2), (0.3, 0.9), (0.031, 0.093)):
            assert told(follower, 1.0, 0.0, error * side) == pytest.approx((0.0, -rate * side))
        assert told(follower, 1.0, 0.0, 0.029 * side)[0] > 0.29
    assert told(PathFollower(np.array([[0.0, 0.0], [5.0, 0.0]])), 0.0, 0.0, 0.031)[0] == pytest.approx(0.0)


def test_speeds_before_the_goal_and_at_corners():
    """sqrt(2 a s) before a stop; before a gentle corner not below the least speed, before a slight one no slower at all."""
    goal = PathFollower(np.array([[0.0, 0.0], [2.0, 0.0]]))
    for rest_m in (0.5, 0.1, 0.02, 0.007):
        expected = min(0.3, max(math.sqrt(2 * 0.25 * rest_m), 0.02))
        assert told(goal, 2.0 - rest_m, 0.0)[0] == pytest.approx(expected)
    assert told(goal, 1.995, 0.0) == (0.0, 0.0)
    assert goal.done
    for corner, expected in ((0.04, 0.3), (0.06, math.sqrt(0.5 * 0.1)), (0.29, math.sqrt(0.5 * 0.1))):
        path = np.array([[0.0, 0.0], [1.0, 0.0], [1.0 + math.cos(corner), math.sin(corner)]])
        follower = PathFollower(path)
        assert told(follower, 0.9, 0.0)[0] == pytest.approx(expected)
        assert follower.rest_m == pytest.approx(path[1:])
        # Within a centimetre the next segment counts, without a stop.
        expected = max(0.05, math.sqrt(0.5 * 0.0105)) if corner > 0.05 else 0.3
        assert told(follower, 0.9895, 0.0)[0] == pytest.approx(expected)
        assert told(follower, 0.9905, 0.0)[0] == pytest.approx(0.3 * math.cos(corner))
        assert follower.rest_m == pytest.approx(path[2:])
    sharp = PathFollower(np.array([[0.0, 0.0], [1.0, 0.0], [1.0 + math.cos(0.31), math.sin(0.31)]]))
    assert told(sharp, 0.9905, 0.0)[0] == pytest.approx(math.sqrt(0.5 * 0.0095))
    assert told(sharp, 0.995, 0.0) == pytest.approx((0.0, 3.0 * 0.31))
    near = PathFollower(
        np.array([[0.0, 0.0], [2.0, 0.0]]), clearance=lambda point: float(np.hypot(2.0 - point[0], point[1]))
    )
    limits = FollowLimits()
    # What is nearest 30 cm ahead counts, if the path goes as far.
    assert told(near, 1.3, 0.0)[0] == pytest.approx(limits.speed_m_s(0.4))
    assert told(near, 1.8, 0.0)[0] == pytest.approx(0.05)


def test_beside_the_goal_it_drives_there_slowly_and_then_turns():
    """Slipped off by 6 cm to the left: it turns to the goal, drives at 5 cm/s at most, and turns to the heading that is wanted."""
    follower = PathFollower(np.array([[0.0, 0.0], [2.0, 0.0]]), heading_rad=1.0)
    told(follower, 1.0, 0.0)
    down = -math.pi / 2
    assert told(follower, 2.0, 0.06, down + 0.21) == pytest.approx((0.0, -0.63))
    assert told(follower, 2.0, 0.06, down - 0.19) == pytest.approx((0.05, 0.57))
    assert told(follower, 2.0, 0.03, down) == pytest.approx((0.03, 0.03))
    assert told(follower, 2.0, 0.019, 1.5) == pytest.approx((0.0, -1.2))
    assert told(follower, 2.0, 0.019, 0.979) == pytest.approx((0.0, 0.063))
    assert not follower.done
    assert told(follower, 2.0, 0.019, 0.981) == (0.0, 0.0)
    assert follower.done
    assert follower.rest_m == pytest.approx(np.array([[2.0, 0.0]]))


def test_a_robot_that_brakes_gently_still_reaches_its_stop():
    """With 1 cm/s^2, the last centimetre is driven at 2 cm/s, not ever slower; before a gentle corner at the least speed."""
    gentle = FollowLimits(acceleration_m_s2=0.01)
    goal = PathFollower(np.array([[0.0, 0.0], [2.0, 0.0]]), gentle)
    assert told(goal, 1.9, 0.0)[0] == pytest.approx(math.sqrt(2 * 0.01 * 0.1))
    assert told(goal, 1.99, 0.0)[0] == pytest.approx(0.02)
    corner = PathFollower(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.2]]), gentle)
    assert told(corner, 0.95, 0.0)[0] == pytest.approx(0.05)
