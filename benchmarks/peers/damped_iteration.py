"""The published baseline: the pressure of the contents as an iterated boundary condition (Alt 2016, Eq. (6.2))."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from visuohaptic.core import InputError
from visuohaptic.deformation.nonlinear import Contents, enclosed_gradient
from visuohaptic.deformation.shapes import ShellObject
from visuohaptic.deformation.shells import ShellModel

__all__ = ["DampedIteration", "damped_iteration"]


@dataclass(frozen=True, slots=True, eq=False)
class DampedIteration:
    """Result of the published iteration."""

    displacement: Float[np.ndarray, "v 6"]
    gauge_Pa: float
    passes: int
    converged: bool


def damped_iteration(
    container: ShellObject,
    model: ShellModel,
    load: Float[np.ndarray, "v 6"],
    contents: Contents,
    *,
    damping: float = 0.5,
    threshold: float = 1e-9,
    max_passes: int = 500,
) -> DampedIteration:
    """Pressure as a boundary condition that is updated, Eq. (6.2): the published baseline.

    Diverges when ``|1 - c (1 + g)| >= 1`` with the loop gain ``g = kappa a . w``; the rank-one term has no such
    limit.

    Parameters
    ----------
    container, model
        As of :func:`~visuohaptic.deformation.nonlinear.enclosed_gradient`.
    load
        Forces and moments at the vertices [N], [N m].
    contents
        What is enclosed, with some gas.
    damping
        c, the weight of a new pressure against the old one, 0 to 1.
    threshold
        Change of the volume between passes, relative to the volume, at which the iteration has converged.
    max_passes
        Passes after which it is given up.

    Raises
    ------
    InputError
        There is no gas: the pressure is not a function of the volume.
    """
    a = enclosed_gradient(container, model)
    free, w = model.solve(load), model.solve(a)
    rest = container.volume_m3
    kappa = contents.bulk_stiffness(rest)
    if not np.isfinite(kappa):
        raise InputError("damped_iteration", "without gas the pressure is not a function of the volume")
    gauge, before = 0.0, np.inf
    for passes in range(1, max_passes + 1):
        change = float(np.sum(a * (free + gauge * w)))
        if not abs(change) < 1e3 * rest:
            return DampedIteration(free + gauge * w, gauge, passes, False)
        if abs(change - before) < threshold * rest:
            return DampedIteration(free + gauge * w, gauge, passes, True)
        before = change
        gauge = damping * (-kappa * change) + (1 - damping) * gauge
    return DampedIteration(free + gauge * w, gauge, max_passes, False)
