"""Online correction of a sideward push from the tracked contact point (Alt 2016, Sec. 4.3.2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ...core import InputError, wrap_angle
from .push_model import PushModel
from .quasi_static import STEP_M, PushTrace, arc_path, remaining_m, simulate_push

#: Path of the platform: x, y [m], heading [rad].
Poses = Float[np.ndarray, "k 3"]
#: Whether a path and the object's motion along it are possible.
Check = Callable[[Poses, PushTrace], bool]
#: Standard deviation of a tracked contact point along the rim (m).
CONTACT_SIGMA_M = 0.006
#: Standard deviations of the prior: contact friction, centre of friction x, y [m], lateral offset of the object [m].
SIGMAS = (0.12, 0.03, 0.03, 0.01)
#: Iterations of the fit per update.
STEPS = 3
#: Minimum distance of the release from the path's end [m].
RESERVE_M = 0.1
#: Models with which a correction is tried besides the estimate, and the required fraction of successes.
SAMPLES, SUCCESSFUL = 8, 0.8
#: Lateral shifts of the path's end that a correction tries, in order (m).
ASIDE_M = (0.0, 0.04, -0.04, 0.08, -0.08, 0.12, -0.12, 0.17, -0.17, 0.22, -0.22, 0.3, -0.3)


@dataclass(frozen=True, slots=True, eq=False)
class PushEstimate:
    """Estimates from the motion of the contact along the rim so far."""

    model: PushModel
    object_m: Float[np.ndarray, "3"]  #: current pose of the object
    #: contact friction, displacement of the centre of friction x, y from the model [m], lateral offset of the object [m]
    value: Float[np.ndarray, "4"]
    covariance: Float[np.ndarray, "4 4"]
    residual_m: float  #: root mean square of contact positions along the rim


class PushMonitor:
    """Monitors a push, estimates contact friction and centre of friction, and corrects the remaining path.

    After every :data:`~visuohaptic.navigation.pushing.quasi_static.STEP_M` of the drive
    the push so far is simulated with four parameters (contact friction,
    centre of friction, lateral offset of the object), which are fitted
    to the observed contact positions on the rim, with the prior of ``model``.

    Parameters
    ----------
    model, object_m, radius_m
        Model and pose assumed when the push was planned, and the radius of the platform [m].
    """

    def __init__(self, model: PushModel, object_m: Sequence[float], radius_m: float) -> None:
        self._model, self._start = model, np.asarray(object_m, dtype=np.float64)
        self._radius_m = radius_m
        self._sigma = np.array(SIGMAS)
        if not radius_m > 0:
            raise InputError("PushMonitor", f"found a radius of {radius_m} m, expected more than 0")
        self._path: list[Float[np.ndarray, "3"]] = []
        self._angle: list[float] = []
        #: Since the last step: x, y of the platform [m], angle on its rim [rad].
        self._readings: list[tuple[float, float, float]] = []
        self._value = np.zeros(4)
        self._covariance = np.diag(self._sigma**2)
        self._lateral = np.zeros(2)

    def update(self, platform_m: Sequence[float], contact_m: Sequence[float] | None) -> bool:
        """Add an observation; returns whether the estimate has changed.

        After every step of the drive, the estimate is updated with the mean of the readings along the last half of the step.

        Parameters
        ----------
        platform_m
            Pose of the platform: x, y [m], heading [rad], map frame.
        contact_m
            Contact point on its rim: x, y [m], map frame; ``None`` without contact.
        """
        pose = np.asarray(platform_m, dtype=np.float64)
        away = np.full(2, np.nan) if contact_m is None else np.asarray(contact_m, dtype=np.float64) - pose[:2]
        angle = float(np.arctan2(away[1], away[0])) if np.isfinite(away).all() else np.nan
        self._readings.append((pose[0], pose[1], angle))
        if self._path and np.hypot(*(pose[:2] - self._path[-1][:2])) < 0.8 * STEP_M:
            return False
        x, y, angles = np.array(self._readings).T
        near = angles[np.isfinite(angles) & (np.hypot(x - pose[0], y - pose[1]) < 0.5 * STEP_M)]
        angle = float(near[-1] + np.mean(wrap_angle(near - near[-1]))) if len(near) else np.nan
        self._readings.clear()
        self._path.append(pose)
        self._angle.append(angle)
        if len(self._path) == 2:
            chord = self._path[1][:2] - self._path[0][:2]
            self._lateral = np.array([-chord[1], chord[0]]) / max(float(np.hypot(*chord)), 1e-9)
        if len(self._path) > 3 and np.isfinite(self._angle).sum() >= 2:
            self._fit()
        return True

    def estimate(self) -> PushEstimate:
        """The model and the object's pose that explain the contacts so far."""
        model, start = self._with(self._value)
        residual = self._residual(self._value)[: -len(self._value)] * CONTACT_SIGMA_M
        # The object has not moved since the last observed contact, whatever the model predicts afterwards.
        seen = np.flatnonzero(np.isfinite(self._angle))
        where = self._simulate(self._value).object_m[seen[-1]] if len(self._path) > 1 and len(seen) else start
        rms = float(np.sqrt(np.mean(residual**2))) if len(residual) else 0.0
        return PushEstimate(model, where, self._value.copy(), self._covariance.copy(), rms)

    def corrected(
        self, remaining_path_m: Poses, rng: np.random.Generator, *, allowed: Check | None = None
    ) -> Poses | None:
        """The remaining path with the smallest lateral shift of its end that still releases the object.

        Parameters
        ----------
        remaining_path_m
            Remainder of the plan, from the platform's current pose: x, y [m], heading [rad].
        rng
            Random generator for the sampled models.
        allowed
            Returns whether path and motion of the object are collision-free.

        Returns
        -------
        The path, or ``None``: the manipulation has failed and a new plan is needed.
        """
        begin, end = remaining_path_m[0], remaining_path_m[-1]
        chord = end[:2] - begin[:2]
        length = float(np.hypot(*chord))
        if length < 2 * STEP_M:
            return remaining_path_m
        aside = np.array([-chord[1], chord[0]]) / length
        candidates = [self._value]
        root = np.linalg.cholesky(self._covariance + 1e-12 * np.eye(4))
        candidates += [self._value + root @ rng.standard_normal(4) for _ in range(SAMPLES)]
        for step in ASIDE_M:
            path = remaining_path_m if step == 0.0 else arc_path(begin[:2], end[:2] + step * aside, 0.0)
            won = [self._drops(value, path, allowed) for value in candidates]
            if won[0] and sum(won) >= SUCCESSFUL * len(won):
                return path
        return None

    def _drops(self, value: Float[np.ndarray, "4"], path: Poses, allowed: Check | None) -> bool:
        done = np.array(self._path[:-1]) if len(self._path) > 1 else np.zeros((0, 3))
        model, start = self._with(value)
        whole = np.concatenate([done, path])
        try:
            trace = simulate_push(model, start, whole, self._radius_m)
        except InputError:
            return False
        if allowed is not None and not allowed(path, trace):
            return False
        return not trace.touched or remaining_m(whole, trace.last_contact) > RESERVE_M

    def _with(self, value: Float[np.ndarray, "4"]) -> tuple[PushModel, Float[np.ndarray, "3"]]:
        """Model and start pose with the four parameters applied."""
        model = replace(
            self._model,
            contact_friction=max(0.0, self._model.contact_friction + float(value[0])),
            support_m=self._model.support_m + value[1:3],
        )
        start = self._start.copy()
        start[:2] += value[3] * self._lateral
        return model, start

    def _simulate(self, value: Float[np.ndarray, "4"]) -> PushTrace:
        model, start = self._with(value)
        path = np.array(self._path)
        try:
            return simulate_push(model, start, path, self._radius_m)
        except InputError:
            # The changed position overlaps the platform: start the drive earlier.
            chord = path[1] - path[0]
            back = path[0] - chord * (0.05 / max(float(np.hypot(chord[0], chord[1])), 1e-9))
            trace = simulate_push(model, start, np.concatenate([back[None], path]), self._radius_m)
            return replace(
                trace,
                platform_m=trace.platform_m[1:],
                object_m=trace.object_m[1:],
                contact_m=trace.contact_m[1:],
            )

    def _residual(self, value: Float[np.ndarray, "4"]) -> Float[np.ndarray, "n"]:
        """Residuals of contact positions along the rim, and of the prior, divided by their standard deviations."""
        prior = value / self._sigma
        angle = np.array(self._angle)
        rows = np.isfinite(angle)
        if len(self._path) < 2 or not rows.any():
            return prior
        trace = self._simulate(value)
        away = trace.contact_m - trace.platform_m[:, :2]
        predicted = np.arctan2(away[:, 1], away[:, 0])
        # Contact observed where none is predicted counts as a large but bounded residual.
        residual = wrap_angle(predicted - angle)[rows]
        residual = np.clip(np.nan_to_num(residual, nan=0.3), -0.5, 0.5)
        return np.concatenate([residual * self._radius_m / CONTACT_SIGMA_M, prior])

    def _fit(self) -> None:
        """A few damped Gauss-Newton iterations from the result of the last fit."""
        value, damp = self._value, 1e-2
        residual = self._residual(value)
        size = float(residual @ residual)
        slope = np.zeros((len(residual), 4))
        for _ in range(STEPS):
            for i, step in enumerate(0.1 * self._sigma):
                moved = value.copy()
                moved[i] += step
                slope[:, i] = (self._residual(moved) - residual) / step
            normal = slope.T @ slope
            for _ in range(4):
                change = -np.linalg.solve(normal + damp * np.diag(np.diag(normal)), slope.T @ residual)
                trial = value + np.clip(change, -self._sigma, self._sigma)
                trial[0] = max(trial[0], -self._model.contact_friction)
                new = self._residual(trial)
                if float(new @ new) < size:
                    value, residual, size, damp = trial, new, float(new @ new), 0.3 * damp
                    break
                damp *= 10.0
            else:
                break
        self._value = value
        self._covariance = np.linalg.inv(slope.T @ slope)
