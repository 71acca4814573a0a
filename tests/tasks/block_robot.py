"""A platform that pushes a block on a floor with dry friction: a quasi-static model of two equations."""

from __future__ import annotations

import math

import numpy as np

from visuohaptic.core import BaseState

RADIUS_M, HALF_M = 0.17, 0.175


class BlockRobot:
    """Disc with a rim of stiffness ``k`` against a block that slides at ``friction_N``; base and senses in one.

    The block only moves along x. Its face is at ``block_x - HALF_M``; the disc meets it where it overlaps.
    """

    def __init__(self, friction_N: float, *, stiffness_N_per_m: float = 1e6, at=(0.7, 1.4), block_x=1.95):
        self.friction_N, self.k = friction_N, stiffness_N_per_m
        self.x, self.y, self.heading = *at, 0.0
        self.block_x, self.t_s, self.force_N = block_x, 0.0, 0.0
        self.speed = self.turn = 0.0
        self.clock_runs = self.read = True
        self.pressed = []  #: (force before the command, speed towards the block) of each period

    def drive(self, speed_m_s, turn_rate_rad_s):
        self.speed, self.turn = speed_m_s, turn_rate_rad_s

    def stop(self):
        self.drive(0.0, 0.0)

    def state(self):
        return BaseState(self.t_s, self.x, self.y, self.heading, self.speed, self.turn)

    def wait(self, period_s):
        self.pressed.append((self.force_N, self.speed * math.cos(self.heading)))
        self.t_s += period_s if self.clock_runs else 0.0
        self.heading += self.turn * period_s
        self.x += self.speed * math.cos(self.heading) * period_s
        self.y += self.speed * math.sin(self.heading) * period_s
        beside = self.y - 1.4
        overlap = 0.0
        if abs(beside) < HALF_M:
            overlap = max(0.0, self.x + RADIUS_M - (self.block_x - HALF_M))
        self.force_N = min(self.k * overlap, self.friction_N)
        if overlap > self.force_N / self.k:  # it slides: the spring holds no more than friction
            self.block_x += overlap - self.force_N / self.k

    def pose(self):
        return self.x, self.y, self.heading

    def touch(self):
        if not self.read:
            return math.nan, None
        return self.force_N, ((self.x + RADIUS_M, self.y) if self.force_N > 0 else None)

    def look(self, id):
        return self.block_x, 1.4, 0.0

    def overloaded(self, limit_N):
        """Periods in which it drove on against the block although the force was at the limit before."""
        return int(np.sum([force >= limit_N and speed > 0 for force, speed in self.pressed]))
