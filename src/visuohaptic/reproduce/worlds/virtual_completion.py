"""Bottles with the middle removed and explored by touch, and the error of the estimated surface.

The middle 46 % of the height of each bottle is hidden. It is touched at planned or at
random points. The error is the mean square distance of a regular grid on the true wall from the
estimated surface.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from ...reconstruction.completion import Completion, CompletionSettings, HoleRegion, Touch
from ...reconstruction.mesh import SurfaceMesh
from ...simulation.tabletop.bottles import Bottle

TOUCHES = 20
#: Noise of a contact in each direction [m].
SIGMA_M = 0.0003
HOLE = (0.27, 0.73)


def scene(bottle: Bottle) -> tuple[SurfaceMesh, HoleRegion]:
    """The visible parts, and a transparency region slightly smaller than the hidden part.

    Parameters
    ----------
    bottle
        Object.
    """
    low, high = HOLE[0] * bottle.height_m, HOLE[1] * bottle.height_m
    visible = SurfaceMesh(*bottle.mesh(0.0, low)).joined(SurfaceMesh(*bottle.mesh(high, bottle.height_m)))
    hidden, _ = bottle.mesh(low, high, caps=False)
    centre = hidden.mean(axis=0)
    return visible, HoleRegion.of_points(centre + 0.9 * (hidden - centre))


def true_points(bottle: Bottle) -> Float[np.ndarray, "n 3"]:
    """A regular grid of the hidden wall.

    Parameters
    ----------
    bottle
        Object.
    """
    z = (HOLE[0] + (HOLE[1] - HOLE[0]) * (np.arange(24) + 0.5) / 24) * bottle.height_m
    theta = 2 * np.pi * np.arange(48) / 48
    tt, zz = (part.ravel() for part in np.meshgrid(theta, z))
    rho = bottle.radius_m(tt, zz)
    return np.column_stack([rho * np.cos(tt), rho * np.sin(tt), zz])


def errors_m(points: Float[np.ndarray, "n 3"], mesh: SurfaceMesh) -> Float[np.ndarray, "n"]:
    """Distance of points from a mesh [m]: from the plane of the nearest triangle, if one is close.

    Parameters
    ----------
    points
        Points (n, 3) [m].
    mesh
        Estimated surface.
    """
    from scipy.spatial import cKDTree

    centres, normals = mesh.vertices_m[mesh.faces].mean(axis=1), mesh.face_normals
    gaps, near = cKDTree(centres).query(points)
    plane = np.abs(((points - centres[near]) * normals[near]).sum(axis=1))
    spacing = 2.0 * np.sqrt(float(np.median(mesh.face_areas_m2)))
    along = np.sqrt(np.maximum(gaps**2 - plane**2, 0.0))
    return np.where(along < spacing, plane, gaps)


def explore(
    bottle: Bottle,
    rng: np.random.Generator,
    *,
    planned: bool = True,
    priors: bool = True,
    touches: int = TOUCHES,
    on_plan: Callable[[int, Completion], None] = lambda number, completion: None,
) -> dict[str, Any]:
    """Mean square error after each touch, and the computing time of a step.

    Parameters
    ----------
    bottle
        Object.
    rng
        Source of noise and of random touches.
    planned
        Whether touches are planned, else at random.
    priors
        Whether priors of the shape are used.
    touches
        Number of touches.
    on_plan
        Called before each planned touch, with the number of previous touches.
    """
    visible, region = scene(bottle)
    completion = Completion(visible, region, CompletionSettings(use_priors=priors))
    truth = true_points(bottle)
    mse, steps_s = [float(np.mean(errors_m(truth, completion.surface()) ** 2))], []
    for number in range(touches):
        started_s = time.process_time()
        if planned:
            plan = completion.next_touch()
            start, end = plan.start_m, plan.end_m
            spent_s = time.process_time() - started_s
            on_plan(number, completion)
        else:
            # Along random directions, within the hole.
            angle = rng.uniform(0, 2 * np.pi)
            z = rng.uniform(*HOLE) * bottle.height_m
            end = np.array([*completion.axis_m, z])
            start = end + 0.15 * np.array([np.cos(angle), np.sin(angle), 0.0])
            spent_s = 0.0
        way = end - start
        length = float(np.linalg.norm(way))
        contact = bottle.probe(start, way / length, length, sigma_m=SIGMA_M, rng=rng)
        started_s = time.process_time()
        completion.add(Touch(contact, start, end, SIGMA_M))
        surface = completion.surface()
        steps_s.append(spent_s + time.process_time() - started_s)
        mse.append(float(np.mean(errors_m(truth, surface) ** 2)))
    return {"kind": bottle.kind, "mse": mse, "step_s": steps_s}


def touches_to_tenth(mse: list[float]) -> float:
    """First touch after which the error is a tenth of that of the untouched extrapolation.

    Parameters
    ----------
    mse
        Mean square error [m^2] before and after each touch.
    """
    below = np.flatnonzero(np.array(mse) <= 0.1 * mse[0])
    return float(below[0]) if len(below) else float("inf")
