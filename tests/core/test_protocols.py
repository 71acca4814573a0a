"""Protocols of robots, their clocks, and one revolution of a laser scanner."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import ClockWatch, InputError, LaserScan, MobileBase, require_members
from visuohaptic.core.robots import FrameSource


class Whole:
    """A base without inheriting anything."""

    def drive(self, speed_m_s, turn_rate_rad_s):
        """Go."""

    def stop(self):
        """Stand."""

    def state(self):
        """Where it is."""


def _with(**changes):
    return type("Mine", (Whole,), changes)()


def test_a_whole_robot_passes_and_one_that_forwards_as_well():
    require_members(Whole(), MobileBase, "travel", "base")
    forwarding = type("Proxy", (), {"__getattr__": lambda self, name: getattr(Whole(), name)})()
    require_members(forwarding, MobileBase, "travel", "base")


@pytest.mark.parametrize(
    ("robot", "said"),
    [
        (
            object(),
            r"found base of type object without method drive\(speed_m_s, turn_rate_rad_s\), which must return",
        ),
        (_with(stop=3), r"found base of type Mine whose stop is int, expected the method stop\(\)"),
        (
            _with(drive=lambda self, speed: None),
            r"found base of type Mine whose drive takes other arguments than the method drive\(",
        ),
    ],
)
def test_what_is_missing_is_named_with_its_arguments(robot, said):
    with pytest.raises(InputError, match=f"travel: {said}.*see .*MobileBase"):
        require_members(robot, MobileBase, "travel", "base")


def test_a_property_is_asked_for_but_not_read():
    class Device:
        frame_count = None

        def __iter__(self):
            return iter(())

        @property
        def camera(self):
            raise RuntimeError("asks the device")

    require_members(Device(), FrameSource, "run", "source", members=("__iter__", "camera", "frame_count"))
    with pytest.raises(InputError, match=r"Whole without property camera, which must return Camera \| None"):
        require_members(Whole(), FrameSource, "run", "source", members=("camera",))


def test_a_clock_that_stands_is_noticed_by_periods_and_by_the_host():
    host = [0.0]
    watch = ClockWatch(max_periods=3, max_host_s=10.0, host_clock=lambda: host[0])
    assert [watch.update(t) for t in (1.0, 1.5, 1.5, 1.5)] == ["", "", "", ""]
    assert watch.update(1.5) == "the robot's clock has stood still at 1.5 s for 3 control periods"
    assert watch.update(1.6) == ""
    assert watch.update(float("nan")) == ""
    host[0] = 10.5
    assert watch.update(0.1).startswith("the robot's clock has stood still at 0.1 s for 2 ")
    polled = ClockWatch(max_periods=None, max_host_s=10.0, host_clock=lambda: host[0])
    assert not any(polled.update(2.0) for _ in range(1000))
    host[0] = 20.6
    assert polled.update(2.0)


def test_a_clock_may_stand_for_five_seconds_or_as_many_periods_of_20_ms():
    host = [0.0]
    polled = ClockWatch(max_periods=None, host_clock=lambda: host[0])
    for host[0], stopped in ((0.0, False), (4.9, False), (5.1, True)):
        assert bool(polled.update(1.0)) is stopped
    counted = ClockWatch(host_clock=lambda: 0.0)
    assert [bool(counted.update(1.0)) for _ in range(251)].index(True) == 250


def test_beams_that_hit_are_points_of_the_plane():
    ranges = np.array([2.0, np.inf, np.nan, 0.01, 3.0, 30.0])
    scan = LaserScan(0.0, ranges, np.pi / 2, np.pi / 4)
    assert scan.hits.tolist() == [True, False, False, False, True, False]
    assert scan.points_m == pytest.approx(np.array([[0.0, 2.0], [0.0, -3.0]]), abs=1e-12)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"ranges_m": np.zeros((2, 2))}, r"found shape \(2, 2\), expected 1 to"),
        ({"ranges_m": np.zeros(0)}, r"found shape \(0,\)"),
        ({"range_min_m": 30.0}, r"range_max_m: found 30.0, expected more than range_min_m \(30.0\)"),
        ({"angle_step_rad": 0.0}, "angle_step_rad: found 0, expected a non-zero step"),
        ({"t_s": np.nan}, "t_s: found nan"),
    ],
)
def test_a_scan_that_cannot_be_is_refused(change, said):
    fields = {"t_s": 0.0, "ranges_m": np.ones(3), "angle_min_rad": 0.0, "angle_step_rad": 0.1}
    with pytest.raises(InputError, match=f"LaserScan: {said}"):
        LaserScan(**(fields | change))
