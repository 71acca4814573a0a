"""A robot arm with a tip: straight motions at limited speed, with realistic errors."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ...core import NON_NEGATIVE, POSITIVE, DeviceError, InputError, Pose, ProbeArm, check_numbers


class SimulatedArm(ProbeArm):
    """A ``robots.ProbeArm`` with straight tip motions; time passes by :meth:`advance`.

    Parameters
    ----------
    T_base_tip
        Initial tip pose reported by the arm.
    error
        True tip pose in the reported tip frame: constant error of joint calibration and
        tool mount.
    repeat_sigma_m
        Standard deviation of every axis at the end of each motion, independent between motions.
    reach_m
        Minimum and maximum distance of the tip from the base.
    turn_rate_rad_s
        Maximum turn rate [rad/s].
    rng
        Source of the errors.
    """

    def __init__(
        self,
        T_base_tip: Pose,
        *,
        error: Pose | None = None,
        repeat_sigma_m: float = 0.0,
        reach_m: tuple[float, float] = (0.15, 1.0),
        turn_rate_rad_s: float = 0.5,
        rng: np.random.Generator | None = None,
    ) -> None:
        if not (0 <= reach_m[0] < reach_m[1] and turn_rate_rad_s > 0 and repeat_sigma_m >= 0):
            raise InputError(
                "SimulatedArm", f"found reach {reach_m}, turn rate {turn_rate_rad_s}, expected them > 0"
            )
        self.t_s = 0.0
        self.error = error if error is not None else Pose.identity()
        self.repeat_sigma_m, self.turn_rate_rad_s = repeat_sigma_m, turn_rate_rad_s
        self._reach = np.array(reach_m)
        self._rng = rng if rng is not None else np.random.default_rng(0)
        self._pose = self._from = self._to = T_base_tip
        self._duration_s = self._done_s = 0.0
        self._slip = np.zeros(3)

    def move_linear(self, T_base_tip: Pose, speed_m_s: float) -> None:
        """Start a straight motion of the tip with uniform rotation.

        Raises
        ------
        DeviceError
            The pose is out of reach.
        """
        check_numbers("move_linear", POSITIVE, speed_m_s=speed_m_s)
        far = float(np.linalg.norm(T_base_tip.translation_m))
        if not self._reach[0] <= far <= self._reach[1]:
            raise DeviceError(
                f"move_linear: {far:.3f} m from the base is out of reach, "
                f"expected {self._reach[0]:g} to {self._reach[1]:g} m; move the object or the base"
            )
        same = np.allclose(T_base_tip.translation_m, self._to.translation_m, atol=1e-9) and np.allclose(
            T_base_tip.rotation, self._to.rotation, atol=1e-9
        )
        self._from, self._to = self._pose, T_base_tip
        way = float(np.linalg.norm(self._to.translation_m - self._from.translation_m))
        self._duration_s = max(way / speed_m_s, self._from.angle_to(self._to) / self.turn_rate_rad_s)
        self._done_s = 0.0
        if self.repeat_sigma_m > 0 and not same:
            self._slip = self.repeat_sigma_m * self._rng.standard_normal(3)

    def stop(self) -> None:
        """Hold the current pose."""
        self._from = self._to = self._pose
        self._duration_s = self._done_s = 0.0

    def pose(self) -> tuple[float, Pose]:
        """Newest time [s] and reported tip pose."""
        return self.t_s, self._pose

    def reach_m(self) -> Float[np.ndarray, "2"]:
        """Smallest and largest distance of the tip from the base."""
        return self._reach.copy()

    def true_pose(self) -> Pose:
        """True pose of the unloaded tip."""
        return Pose(self._pose.rotation, self._pose.translation_m + self._slip) @ self.error

    def advance(self, dt_s: float) -> None:
        """Advance the simulation.

        Parameters
        ----------
        dt_s
            Simulated time [s].
        """
        check_numbers("SimulatedArm.advance", NON_NEGATIVE, dt_s=dt_s)
        self.t_s += dt_s
        self._done_s = min(self._done_s + dt_s, self._duration_s)
        arrived = self._done_s >= self._duration_s
        self._pose = (
            self._to if arrived else self._from.interpolated(self._to, self._done_s / self._duration_s)
        )
