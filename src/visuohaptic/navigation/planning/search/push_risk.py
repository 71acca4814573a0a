"""Where a pushed object ends, and how likely it then closes the drives that follow (Alt 2016, Sec. 4.3.1).

The quasi-static model with what is not known of friction and pose: simulated pushes with sampled contact friction,
centre of friction and pose of the object. Those in which the object blocks the whole approach count as if it stayed
where it was.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from ....core.geometry import rotation_2d
from ...pushing.push_failure import sampled_pushes
from ...pushing.push_model import PushModel
from ...pushing.quasi_static import line_path
from .bodies import lower_window
from .drives import drives_cells
from .push_heuristic import PushHeuristic
from .push_states import PushStep, seed_cells
from .search_domain import SearchDomain

__all__ = ["end_covariance", "end_errors", "replanning_units"]

#: Simulated pushes; the variance of their variance is 2 / so many.
SAMPLES = 40
#: Pushes are simulated so many times as far as they are asked for: their lengths are refined.
BEYOND = 1.5
#: Of the ends that touch a drive, so many are asked whether there is another one: their share is known to 0.18.
LOOKED_AT = 8


def end_errors(domain: SearchDomain, step: PushStep) -> Float[np.ndarray, "n 3"]:
    """Ends of simulated pushes from the planned end: x, y along the grid's axes [m], turn [rad].

    Parameters
    ----------
    domain
        Robot, map and bodies.
    step
        The push.
    """
    body, resolution_m = domain.bodies[step.body], domain.map.resolution_m
    # About the body's centre before the push: the same wherever it stands.
    centre = body.centre + step.shifts_before[step.body]
    begin, touch = ((point - centre) * resolution_m for point in (step.approach, step.touch))
    ahead = (touch - begin) / np.hypot(*(touch - begin))
    length_m = float(np.hypot(*(touch - begin)) + step.length * resolution_m)
    key = step.body, step.contact
    if key not in domain.ends or domain.ends[key][0] < length_m:
        reach_m = BEYOND * length_m
        model = PushModel.patch((body.outline - body.centre) * resolution_m)
        _, poses, _ = sampled_pushes(
            model.with_centre_moved(*(body.friction * resolution_m)), (0.0, 0.0, 0.0),
            line_path(begin, begin + reach_m * ahead), domain.robot.radius_m,
            np.random.default_rng(0), samples=SAMPLES,  # one plan, one answer
        )  # fmt: skip
        domain.ends[key] = reach_m, poses
    reach_m, poses = domain.ends[key]
    place = (poses.shape[1] - 1) * length_m / reach_m
    row = min(int(place), poses.shape[1] - 2)
    ends = poses[:, row] + (place - row) * (poses[:, row + 1] - poses[:, row])
    return ends - np.array([*(step.length * resolution_m * ahead), 0.0])


def end_covariance(domain: SearchDomain, step: PushStep) -> Float[np.ndarray, "3 3"]:
    """Second moment of x, y [m] and turn [rad] about the planned end, map frame.

    Parameters
    ----------
    domain, step
        As of :func:`end_errors`.
    """
    errors = end_errors(domain, step)
    errors[:, :2] = errors[:, :2] @ rotation_2d(domain.map.origin[2]).T
    return errors.T @ errors / SAMPLES


def replanning_units(
    heuristic: PushHeuristic, steps: tuple[PushStep, ...], start: Float[np.ndarray, "2"]
) -> float:
    """Expected cost of the pushes that a plan needs where one of its own ends so that it closes a later drive [units].

    Such an object is pushed once more, by its shortest push at least.

    Parameters
    ----------
    heuristic
        Of the search, for its domain, goal and costs of pushes.
    steps
        Pushes in order, whose drives were looked for.
    start
        Where the robot begins [cells].
    """
    import shapely

    domain = heuristic.domain
    if not (steps and heuristic.costs.price_ends):
        return 0.0
    drives = drives_cells(domain, steps, start, heuristic.goal)
    total = 0.0
    for index, step in enumerate(steps):
        again = next((k for k in range(index + 1, len(steps)) if steps[k].body == step.body), len(steps))
        body, errors = domain.bodies[step.body], end_errors(domain, step)
        c, s = np.cos(errors[:, 2]), np.sin(errors[:, 2])
        turns = np.stack([np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=-2)
        ends = body.centre + step.shifts_after[step.body] + errors[:, :2] / domain.map.resolution_m
        outlines = (body.outline - body.centre) @ turns + ends[:, None]
        closed = 0.0
        for k in range(index + 1, again + 1):
            away = shapely.distance(shapely.polygons(outlines), shapely.linestrings(drives[k]))
            near = outlines[away < domain.radius]
            if len(near):
                some = near[:: -(-len(near) // LOOKED_AT)]
                cut = _closed(domain, steps[k - 1].shifts_after, step.body, some, drives[k])
                closed = max(closed, float(cut.mean()) * len(near) / SAMPLES)
        total += closed * heuristic.shortest_push(step.body)
    return total


def _closed(
    domain: SearchDomain,
    shifts: Float[np.ndarray, "bodies 2"],
    index: int,
    outlines: Float[np.ndarray, "n p 2"],
    drive: Float[np.ndarray, "k 2"],
) -> Bool[np.ndarray, "n"]:
    """Whether a body at each outline [cells] cuts a drive, within a window of the lattice around all of them."""
    from ._push_search_kernels import block_patch
    from ._travel_kernels import UNITS, flood

    block, radius = domain.block, domain.radius
    grow = 4.0 * radius + 4.0 * block
    low = np.maximum((outlines.min(axis=(0, 1)) - grow) // block, 0).astype(int)
    high = np.maximum((outlines.max(axis=(0, 1)) + grow) // block + 1, low).astype(int)
    others = np.arange(len(domain.bodies)) != index
    layer = domain.part(domain.lattice, low, high, shifts, block, others)
    corner = low * float(block)
    inside = np.flatnonzero(((drive >= corner) & (drive < high * block)).all(axis=1))
    found = np.zeros(len(outlines), dtype=bool)
    for number, outline in enumerate(outlines):
        among = layer.copy()
        patch, row, column = block_patch(domain.clearance, outline, radius, radius + block, block)
        lower_window(among, patch, row - int(low[1]), column - int(low[0]))
        (begin, _), (end, _) = (
            seed_cells(among, drive[k] - corner, radius, domain.slow, UNITS, reach=2, block=block)
            for k in inside[[0, -1]]
        )
        found[number] = not (begin.size and end.size and flood(among, radius, begin)[end].any())
    return found
