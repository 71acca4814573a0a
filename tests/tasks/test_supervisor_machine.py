"""A task that does anything, on a platform whose sensors do anything: the supervisor keeps what it promises.

The model knows when the odometry and the force were last read anew, and nothing of how the supervisor decides.
"""

from __future__ import annotations

import math

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from tests.tasks.test_supervisor import PERIOD_S, STOPPED_S, Rolling

from visuohaptic.core import DeviceError, InputError
from visuohaptic.tasks.framework import SafetyLimits, Supervisor

LIMITS = SafetyLimits(max_force_N=20.0, max_speed_m_s=0.5, max_turn_rate_rad_s=1.5)
SPEEDS = st.sampled_from([0.0, 0.2, -0.2, 3.0, math.nan, math.inf]) | st.floats(-2.0, 2.0)


class Driven(RuleBasedStateMachine):
    """Commands, readings, frozen and jumping clocks, forces and waits in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.base = Rolling()
        self.guard = Supervisor(LIMITS, clock=lambda: self.base.now)
        self.watched = self.guard.base(self.base)
        self.fresh_s = 0.0  #: when the odometry was last read, or a motion began
        self.read_s = -math.inf  #: time of the newest odometry that was read
        self.force_N, self.pressing = 0.0, 0.0  #: newest force, and the speed at which it reached the limit
        self.failed = False

    def teardown(self) -> None:
        self.guard.close()
        assert not self.base.velocity.any()

    def _tried(self, act: object) -> None:
        """A fault is permanent: nothing that is asked afterwards is done."""
        try:
            act()
        except DeviceError:
            self.failed = True
        else:
            assert not self.failed, "a fault was forgotten"

    @rule(speed=SPEEDS, turn=SPEEDS)
    def drive(self, speed: float, turn: float) -> None:
        stood = not self.base.velocity.any()
        if not math.isfinite(speed + turn):
            with pytest.raises((InputError, DeviceError)):
                self.watched.drive(speed, turn)
        elif speed == 0.0 == turn:
            self.watched.drive(speed, turn)
            assert not self.base.velocity.any()
        else:
            self._tried(lambda: self.watched.drive(speed, turn))
            if self.pressing * speed > 0.0 == turn:
                assert not self.base.velocity.any(), "it presses on at the limit"
        if stood and self.base.velocity.any():
            self.fresh_s = self.base.now

    @rule()
    def stop(self) -> None:
        self.watched.stop()
        assert not self.base.velocity.any()

    @rule(periods=st.integers(1, 12), read=st.booleans())
    def wait(self, periods: int, read: bool) -> None:
        for _ in range(periods):
            self.base.wait(PERIOD_S)
            if read:
                self.read()
            self.guard.check()
            self.failed = self.failed or bool(self.guard.fault)
            self.it_stands_when_it_has_to()

    @rule()
    def read(self) -> None:
        self._tried(self.watched.state)
        if (read_s := self.base.state().t_s) > self.read_s:  # the first of a frozen one is new
            self.fresh_s, self.read_s = self.base.now, read_s

    @rule()
    def freeze(self) -> None:
        last = self.base.state()
        self.base.lie = lambda _: last

    @rule()
    def thaw(self) -> None:
        self.base.lie = lambda state: state

    @rule(jump_s=st.sampled_from([0.7, -0.7, 10.0]))
    def clock_jumps(self, jump_s: float) -> None:
        self.base.t_s += jump_s

    @rule(force_N=st.sampled_from([0.0, 5.0, 25.0, math.inf, math.nan]))
    def feel(self, force_N: float) -> None:
        speed, turn = self.base.velocity
        self._tried(lambda: self.guard.note_force(self.base.now, force_N))
        if force_N >= LIMITS.max_force_N > self.force_N:
            self.pressing = 0.0 if turn else speed
        elif force_N < LIMITS.max_force_N:
            self.pressing = 0.0
        self.force_N = self.force_N if math.isnan(force_N) else force_N
        if self.pressing:
            assert not self.base.velocity.any(), "it was not stopped within the reading"

    @invariant()
    def it_stands_when_it_has_to(self) -> None:
        speed, turn = self.base.velocity
        assert abs(speed) <= LIMITS.max_speed_m_s + 1e-9
        assert abs(turn) <= LIMITS.max_turn_rate_rad_s + 1e-9
        if self.failed or self.base.now - self.fresh_s > STOPPED_S:
            assert not self.base.velocity.any()


Driven.TestCase.settings = settings(
    max_examples=60, stateful_step_count=25, deadline=None, suppress_health_check=list(HealthCheck)
)
TestDriven = Driven.TestCase
