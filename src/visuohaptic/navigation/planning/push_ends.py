"""Where a pushed object ends: the quasi-static model with what is not known of friction and pose (Alt 2016, Sec. 4.3.1)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ...core.geometry import rotation_2d
from ..pushing.push_failure import PushUncertainty, sampled_pushes
from ..pushing.push_model import PushModel
from ..pushing.quasi_static import line_path
from .search.push_states import PushStep
from .search.search_domain import SearchDomain, world_from_grid

__all__ = ["end_covariance"]

#: Simulated pushes; the variance of their variance is 2 / so many.
SAMPLES = 40


def end_covariance(
    domain: SearchDomain, step: PushStep, uncertainty: PushUncertainty | None = None
) -> Float[np.ndarray, "3 3"]:
    """Second moment of x, y [m] and turn [rad] about the planned end, map frame.

    Simulated pushes with sampled contact friction, centre of friction and pose of the object; those in which the
    object blocks the whole approach count as if it stayed where it was.

    Parameters
    ----------
    domain
        Robot, map and bodies.
    step
        The push.
    uncertainty
        Standard deviations of friction, centre of friction and pose.
    """
    rng = np.random.default_rng(0)  # one plan, one answer
    body, turn = domain.bodies[step.body], rotation_2d(domain.map.origin[2])
    ends = np.array([body.centre + step.shifts_before[step.body], body.centre + step.shifts_after[step.body]])
    before_m, after_m = world_from_grid(domain.map, ends)
    outline_m = (body.outline - body.centre) * domain.map.resolution_m @ turn.T
    model = PushModel.patch(outline_m).with_centre_moved(*body.obj.friction_offset_m)
    last = step.touch + step.shifts_after[step.body] - step.shifts_before[step.body]
    path = line_path(*world_from_grid(domain.map, np.array([step.approach, last])))
    place = float(before_m[0]), float(before_m[1]), 0.0
    _, ends, _ = sampled_pushes(
        model, place, path, domain.robot.radius_m, rng, uncertainty=uncertainty, samples=SAMPLES
    )
    errors = ends - np.array([*after_m, 0.0])
    return errors.T @ errors / SAMPLES
