"""Ends of planned pushes by simulation: their errors, and the probability that an object turns away."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ....core.geometry import rotation_2d
from ...problem.push_costs import TURN_LIMIT_RAD
from ...pushing.push_failure import PushUncertainty, sampled_pushes
from ...pushing.push_model import PushModel
from ...pushing.quasi_static import STEP_M, line_path
from .search_domain import SearchDomain

#: Number of simulated pushes for a covariance in three dimensions, and for the probability of an event.
SAMPLES, PRICED = 160, 40
#: Step of these simulations [m]: twice that of a single push, which changes final poses by hundredths of a millimetre.
LONG_STEP_M = 2.0 * STEP_M
#: Standard deviation of the platform's final position [m]: it stops within 6 mm of the target, two standard deviations.
TRACKING_M = 0.003
#: Pushes are simulated to this multiple of the requested length, because lengths are refined later.
REACH_FACTOR = 1.5


def end_errors(
    domain: SearchDomain, index: int, contact: int, length: float, samples: int = SAMPLES
) -> Float[np.ndarray, "n 3"]:
    """Errors of the final poses of simulated pushes: x, y along the grid's axes [m], rotation [rad].

    Parameters
    ----------
    domain
        Robot, map and bodies.
    index, contact
        Indices of the body and of its contact.
    length
        Length of the push [cells].
    samples
        Number of pushes: a smaller number is a prefix of a larger one.
    """
    body, resolution_m = domain.bodies[index], domain.map.resolution_m
    ahead = body.push(contact).direction
    # Relative to the body's centre before the push, hence independent of its position.
    stand_off_m = domain.robot.stand_off_m
    begin = body.push(contact).robot * resolution_m - stand_off_m * ahead
    length_m = stand_off_m + length * resolution_m
    key = index, contact
    if key not in domain.ends:
        model = PushModel.of_footprint((body.outline - body.centre) * resolution_m)
        model = model.with_centre_moved(*(body.friction * resolution_m))
        domain.ends[key] = model, 0.0, np.zeros((0, 2, 3))
    model, reach_m, poses = domain.ends[key]
    if reach_m < length_m or len(poses) < samples:
        known = poses if reach_m >= length_m else poses[:0]
        # Whole steps, so that the first poses do not depend on the simulated length.
        reach_m = float(np.ceil((1.0 if len(known) else REACH_FACTOR) * length_m / LONG_STEP_M)) * LONG_STEP_M
        path_m = line_path(begin, begin + reach_m * ahead, LONG_STEP_M)
        place_m, yaw_rad = body.obj.pose_sigma
        learned, turn = body.obj.friction_covariance_m2, rotation_2d(domain.map.origin[2])
        centre_m2 = None if learned is None else turn.T @ np.array(learned) @ turn
        _, poses, _ = sampled_pushes(
            model, (0.0, 0.0, 0.0), path_m, domain.robot.front_m,
            np.random.default_rng(0), samples=samples, skip=len(known),  # one plan, one answer
            uncertainty=PushUncertainty(centre_m2=centre_m2, place_m=place_m, yaw_rad=yaw_rad),
        )  # fmt: skip
        poses = np.concatenate([known[:, : len(path_m)], poses]) if len(known) else poses
        domain.ends[key] = model, reach_m, poses
    poses = poses[:samples]
    place = (poses.shape[1] - 1) * length_m / reach_m
    row = min(int(place), poses.shape[1] - 2)
    ends = poses[:, row] + (place - row) * (poses[:, row + 1] - poses[:, row])
    ends -= np.array([*(length * resolution_m * ahead), 0.0])
    ends[:, :2] += TRACKING_M * np.random.default_rng(0).standard_normal((samples, 2))
    return ends


def turn_probability(domain: SearchDomain, index: int, contact: int, length: float) -> float:
    """Probability that a push is aborted because the object rotates away from the robot.

    Parameters
    ----------
    domain, index, contact, length
        See :func:`end_errors`.
    """
    turned = np.abs(end_errors(domain, index, contact, length, PRICED)[:, 2]) > TURN_LIMIT_RAD
    return float((turned.sum() + 0.5) / (PRICED + 1.0))  # posterior mean with Jeffreys' prior
