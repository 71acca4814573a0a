"""Equilibrium paths of shells: load, displacement and arc-length control.

A path is followed in steps. Each step solves ``lambda q = f(u)`` together with a constraint equation:
a load, a displacement of the control, or an arc length. Newton's method with
the exact tangent takes three to six iterations; a step that does not converge is halved, and
at a snap-back of the control the path is continued by arc length.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ..shells.corotational import CorotationalShell, ShellState
from .equilibrium_path import EquilibriumPath, PathPoint

_log = logging.getLogger(__name__)

#: Iterations after which a step is rejected and halved.
MAX_ITERATIONS = 16
#: Maximum number of arc-length steps through a snap-back.
MAX_ARCS = 60
#: Residual force at which a step has converged, relative to the larger of load and reactions.
TOLERANCE = 1e-5


def follow_displacement(
    shell: CorotationalShell,
    load: Float[np.ndarray, "v 6"],
    targets_m: Sequence[float],
    *,
    control: Float[np.ndarray, "v 6"] | None = None,
    max_iterations: int = 5000,
    until_load: float = np.inf,
) -> EquilibriumPath:
    """Increase the control displacement to each of ``targets_m`` and compute the required load.

    At a snap-back of the control, the path is followed by arc length until the control has
    advanced again: a target is then the next state with that displacement.

    Parameters
    ----------
    shell
        Wall and contents.
    load
        Reference load q at the vertices [N], [N m]; directions do not follow the wall.
    targets_m
        Displacements of the control.
    control
        Weights c of the control ``c . u``, displacements only. By default the load divided by the
        sum of its forces: the mean displacement of the loaded vertices, along the load.
    max_iterations
        Maximum Newton iterations of the whole path, which ends when they are used up.
    until_load
        Load factor at which the path is complete, whatever targets are left.
    """
    walk = _Walk(shell, load, control, max_iterations)
    return walk.run(list(targets_m), "displacement", until_load=until_load)


def reach_loads(
    shell: CorotationalShell,
    load: Float[np.ndarray, "v 6"],
    factors: Sequence[float],
    *,
    control: Float[np.ndarray, "v 6"] | None = None,
    past_limits: bool = True,
    max_iterations: int = 5000,
) -> EquilibriumPath:
    """Increase the load to each of ``factors``.

    Where the load cannot be increased, the path is followed by arc length until it can: the point of a factor is then
    the next state on the path at that load.

    Parameters
    ----------
    shell, load
        As of :func:`follow_displacement`.
    factors
        Load factors, in the order in which they are reached.
    control
        As of :func:`follow_displacement`.
    past_limits
        Whether to continue beyond a limit load; otherwise the path ends there.
    max_iterations
        Newton iterations of the whole path, which ends when they are used up.
    """
    walk = _Walk(shell, load, control, max_iterations)
    return walk.run(list(factors), "load", past_limits=past_limits)


_Kind = Literal["load", "displacement", "arc"]


@dataclass(frozen=True, slots=True)
class _Constraint:
    """Constraint equation of a step."""

    kind: _Kind
    target: float  #: load factor, displacement of the control [m], or arc length [m]


class _Walk:
    """Current state of the path-following, with its history."""

    def __init__(
        self,
        shell: CorotationalShell,
        load: Float[np.ndarray, "v 6"],
        control: Float[np.ndarray, "v 6"] | None = None,
        max_iterations: int = 5000,
    ) -> None:
        self.left, self.shell = max_iterations, shell
        self.fixed = shell.model.fixed
        self.load = np.where(self.fixed, 0.0, np.asarray(load, dtype=float))
        if control is None:
            total = float(np.linalg.norm(self.load[:, :3], axis=1).sum())
            control = self.load / total if total else np.zeros_like(self.load)
        self.control = np.where(self.fixed, 0.0, np.asarray(control, dtype=float))
        self.control[:, 3:] = 0.0
        if not self.load.any():
            raise InputError("load", "is zero on everything that can move")
        sides = np.ptp(shell.model.mesh.vertices_m, axis=0)
        self.length_m = float(np.linalg.norm(sides)) / 10
        self.state, self.factor = shell.rest, 0.0
        self.stable = True
        self.last_step: np.ndarray | None = None
        self.last_factor = 0.0
        self.last_advance = 0.0
        self.spent = 0

    # -- Steps -------------------------------------------------------------------------------

    def run(
        self, targets: list[float], kind: _Kind, *, past_limits: bool = True, until_load: float = np.inf
    ) -> EquilibriumPath:
        points: list[PathPoint] = []
        reached = 0.0
        for target in targets:
            self.spent, cuts = 0, 0
            fraction = 1.0
            while reached != target:
                aim = target if fraction == 1.0 else reached + fraction * (target - reached)
                if self._step(_Constraint(kind, aim), aim - reached):
                    reached = aim
                    remaining = target - reached
                    fraction = (
                        1.0 if cuts == 0 or not remaining else min(1.0, 1.5 * fraction / (1 - fraction))
                    )
                    cuts = max(0, cuts - 1)
                else:
                    cuts += 1
                    fraction *= 0.5
                    if past_limits and cuts in (4, 8) and self._pass_turning_point(kind, target):
                        reached, fraction, cuts = target, 1.0, 0
                    elif cuts > 7 or self.left <= 0:
                        ended = "the iterations ended at" if self.left <= 0 else "no equilibrium found beyond"
                        reason = f"{ended} {kind} {reached:.6g} on the way to {target:.6g}"
                        _log.info("%s", reason)
                        return EquilibriumPath(tuple(points), False, reason)
            points.append(self._point())
            if self.factor >= until_load:
                break
        return EquilibriumPath(tuple(points), True)

    def _pass_turning_point(self, kind: _Kind, target: float) -> bool:
        """Follow the path by arc length until the target is passed in its own direction, then converge to it."""
        if self.last_step is None:
            return False
        kept = self.state, self.factor, self.last_step, self.last_factor, self.last_advance
        start = self.factor if kind == "load" else self._control(self.state)
        ahead = np.sign(target - start)
        arc = float(np.linalg.norm(self._lengths(self.last_step)))
        self.last_advance, longest, shrunk = arc, 4 * arc, 0
        for _ in range(MAX_ARCS):
            before = self.spent
            if self._step(_Constraint("arc", arc), arc):
                at = self.factor if kind == "load" else self._control(self.state)
                if (at - target) * ahead >= 0:
                    self.last_step = None  # moving backwards does not continue the path
                    if self._step(_Constraint(kind, target), target - at):
                        return True
                    break
                arc = min(longest, arc * np.sqrt(5.0 / max(self.spent - before, 2)))
                shrunk = 0
            else:
                arc, shrunk = 0.5 * arc, shrunk + 1
                if shrunk > 8 or self.left <= 0:
                    break
        self.state, self.factor, self.last_step, self.last_factor, self.last_advance = kept
        return False

    def _point(self) -> PathPoint:
        return PathPoint(self.factor, self._control(self.state), self.state, self.spent, self.stable)

    # -- Newton ------------------------------------------------------------------------------

    def _step(self, constraint: _Constraint, advance: float) -> bool:
        start, start_factor = self.state, self.factor
        state, factor = start, start_factor
        step = np.zeros_like(self.load)
        ratio = advance / self.last_advance if self.last_step is not None and self.last_advance else 0.0
        if self.last_step is not None and 0 < ratio <= 3:
            # Extrapolate the previous step: the first residual is then of second order in the step.
            step = ratio * self.last_step
            state, factor = start.moved(step), start_factor + ratio * self.last_factor
        best = error = np.inf
        sign = 1
        for iteration in range(min(MAX_ITERATIONS, self.left)):
            self.spent += 1
            self.left -= 1
            # Near convergence Newton's next residual is likely small enough: test it before factorising.
            tangent = None
            if iteration > 0 and error < 3e-3:
                internal = self.shell.internal_force(state)
            else:
                internal, tangent = self.shell.linearised(state)
            residual = np.where(self.fixed, 0.0, factor * self.load - internal)
            scale = max(self._size(factor * self.load), self._size(internal), 1e-300)
            error = self._size(residual) / scale
            gap = self._gap(constraint, state, factor, step)
            if error < TOLERANCE and gap < 1e-6 and iteration > 0:
                self.stable = sign > 0
                self.last_step, self.last_factor = start.step_to(state), factor - start_factor
                self.last_advance = advance
                self.state, self.factor = state, factor
                return True
            if not np.isfinite(error) or (iteration > 3 and error > 1e3 * max(best, 1.0)):
                return False
            best = min(best, error)
            if tangent is None:
                _, tangent = self.shell.linearised(state)
            sign = tangent.sign
            both = tangent.solve(np.column_stack([residual.ravel(), self.load.ravel()]))
            by_residual, by_load = both[:, 0].reshape(self.load.shape), both[:, 1].reshape(self.load.shape)
            more = self._load_change(constraint, state, factor, step, by_residual, by_load, sign)
            change = by_residual + more * by_load
            largest = float(np.abs(change[:, 3:]).max())
            if not np.isfinite(largest) or largest > 3.0:
                # A rotation of a vertex by half a turn in one iteration means that the step is too large.
                return False
            state, factor = state.moved(change), factor + more
            step = step + change
        return False

    def _load_change(
        self,
        constraint: _Constraint,
        state: ShellState,
        factor: float,
        step: np.ndarray,
        by_residual: np.ndarray,
        by_load: np.ndarray,
        sign: int,
    ) -> float:
        """Change of the load factor with which the linearised step meets the constraint."""
        target = constraint.target
        if constraint.kind == "load":
            return target - factor
        if constraint.kind == "displacement":
            along = float(np.sum(self.control * by_load))
            return (target - self._control(state) - float(np.sum(self.control * by_residual))) / along
        done, r, q = (self._lengths(part) for part in (step, by_residual, by_load))
        if not done.any():
            forward = sign
            if self.last_step is not None:
                forward = np.sign(np.sum(self._lengths(self.last_step) * q)) or forward
            return forward * target / float(np.linalg.norm(q))
        # Linearised |step|^2 = arc^2.
        slope = 2 * float(np.sum(done * q))
        missing = target * target - float(np.sum(done * done)) - 2 * float(np.sum(done * r))
        return missing / slope if slope else 0.0

    def _gap(self, constraint: _Constraint, state: ShellState, factor: float, step: np.ndarray) -> float:
        """Relative residual of the constraint."""
        target = constraint.target
        if constraint.kind == "arc":
            # The arc length only sets the step size: a tolerance of a tenth is sufficient.
            return 1e-5 * abs(float(np.linalg.norm(self._lengths(step))) / target - 1.0)
        reached = factor if constraint.kind == "load" else self._control(state)
        return abs(target - reached) / max(abs(target), 1e-300)

    # -- Measures ----------------------------------------------------------------------------

    def _control(self, state: ShellState) -> float:
        return float(np.sum(self.control[:, :3] * (state.points_m - self.shell.model.mesh.vertices_m)))

    def _size(self, forces: np.ndarray) -> float:
        return float(np.sqrt(np.sum(forces[:, :3] ** 2) + np.sum(forces[:, 3:] ** 2) / self.length_m**2))

    def _lengths(self, step: np.ndarray) -> np.ndarray:
        # Only displacements count: rotations have another unit and follow from them.
        return step[:, :3]
