"""Where simulated pushes end that do not know friction, centre of friction and pose for certain."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from .push_model import PushModel

__all__ = ["PushUncertainty", "sampled_pushes"]

#: A platform that would begin in the object begins so much earlier (m): up to 4 sigma of place and turn.
BACK_M = (0.0, 0.04, 0.08, 0.16, 0.32)
#: So deep the rim may begin in the outline (m).
INSIDE_M = 1e-3


@dataclass(frozen=True, slots=True)
class PushUncertainty:
    """Standard deviations of what a simulated push does not know."""

    contact_friction: float = 0.1
    centre_m: float = 0.015  #: of the centre of friction, along x and y
    place_m: float = 0.01  #: of the object against the platform, along x and y
    yaw_rad: float = 0.05

    def sample(
        self, model: PushModel, object_m: tuple[float, float, float], rng: np.random.Generator
    ) -> tuple[PushModel, Float[np.ndarray, "3"]]:
        """Sample a model and a pose about the nominal ones.

        Parameters
        ----------
        model
            Nominal model; its contact friction and its supports are varied.
        object_m
            Nominal pose: x, y [m], yaw [rad].
        rng
            Source of the samples.
        """
        friction = max(0.0, model.contact_friction + self.contact_friction * rng.standard_normal())
        support = model.support_m + self.centre_m * rng.standard_normal(2)
        sigma = np.array([self.place_m, self.place_m, self.yaw_rad])
        sampled = replace(model, contact_friction=friction, support_m=support)
        return sampled, np.asarray(object_m, dtype=np.float64) + sigma * rng.standard_normal(3)


def sampled_pushes(
    model: PushModel,
    object_m: tuple[float, float, float],
    path_m: Float[np.ndarray, "k 3"],
    radius_m: float,
    rng: np.random.Generator,
    *,
    uncertainty: PushUncertainty | None = None,
    samples: int = 40,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n k 3"], Bool[np.ndarray, "n"]]:
    """Poses of an object before a push and along it, for samples of contact friction, centre of friction and pose.

    The push begins earlier on its line where the object was sampled into the platform.

    Parameters
    ----------
    model
        Nominal model of the object.
    object_m
        Nominal pose: x, y [m], yaw [rad].
    path_m
        Poses of the platform: x, y [m], heading [rad].
    radius_m
        Of the platform [m].
    rng
        Source of the samples.
    uncertainty
        Standard deviations of friction, centre of friction and pose.
    samples
        Number of simulated pushes.

    Returns
    -------
    Poses before, poses where the platform is at each of its own, and whether the object blocks the whole approach:
    then it stays where it was.
    """
    from ._push_kernels import GAP, YAW, X, push_object

    uncertainty = uncertainty if uncertainty is not None else PushUncertainty()
    path = np.ascontiguousarray(path_m, dtype=np.float64)
    ahead = path[min(1, len(path) - 1), :2] - path[0, :2]
    ahead = ahead / max(float(np.hypot(*ahead)), 1e-9)
    paths = [path] + [np.vstack([path[:1] - np.array([*(back * ahead), 0.0]), path]) for back in BACK_M[1:]]
    friction = np.maximum(
        0.0, model.contact_friction + uncertainty.contact_friction * rng.standard_normal(samples)
    )
    shifts = uncertainty.centre_m * rng.standard_normal((samples, 2))
    sigma = np.array([uncertainty.place_m, uncertainty.place_m, uncertainty.yaw_rad])
    before = np.asarray(object_m, dtype=np.float64) + sigma * rng.standard_normal((samples, 3))
    along, blocked = before[:, None].repeat(len(path), axis=1), np.ones(samples, dtype=bool)
    trace = np.zeros((len(path) + 1, 8))
    for k in range(samples):
        support = model.support_m + shifts[k]
        gyration = max(float(np.sqrt(model.load @ (support**2).sum(axis=1))), 1e-3)
        for line in paths:
            push_object(
                model.outline_m, model.round_m, support, model.load, gyration, model.tip_m, float(friction[k]),
                radius_m, line, before[k], trace,
            )  # fmt: skip
            if trace[0, GAP] >= -INSIDE_M:
                along[k] = trace[len(line) - len(path) : len(line), X : YAW + 1]
                blocked[k] = False
                break
    return before, along, blocked
