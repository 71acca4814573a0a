"""Bodies without symmetry, given by a formula: touches at one place must not degrade another."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.reconstruction.scenes import part
from visuohaptic.reconstruction.completion import Completion, CompletionSettings, HoleRegion, Touch

SIGMA_M = 0.0003
HEIGHT_M, LOW_M, HIGH_M = 0.2, 0.054, 0.146

Wall = Callable[
    [np.ndarray, np.ndarray], np.ndarray
]  #: distance from the z axis [m] by angle [rad] and height [m]


def lopsided(theta, z):
    """One side bulges, with three lobes, alike at all heights."""
    return 0.032 * (1 + 0.2 * np.cos(theta - 0.5) + 0.08 * np.cos(3 * theta + 1)) + 0 * z


def twisted(theta, z):
    """The lobes turn by 100 degrees over the height."""
    turned = theta - 1.75 * z / HEIGHT_M
    return 0.032 * (1 + 0.12 * np.cos(turned) + 0.1 * np.cos(2 * turned + 0.7) + 0.05 * np.cos(3 * turned))


def leaning(theta, z):
    """A round body whose middle line is bent: no common axis."""
    shift = 0.012 * np.sin(np.pi * z / HEIGHT_M)
    c, s = np.cos(theta - 0.3), np.sin(theta - 0.3)
    return shift * c + np.sqrt(0.033**2 - (shift * s) ** 2)


def dented(theta, z):
    """A round body with a dent of 6 mm on one side of the hidden part."""
    turned = np.angle(np.exp(1j * (theta - 2.0)))
    return 0.035 - 0.006 * np.exp(-((turned / 0.5) ** 2) - ((z - 0.1) / 0.02) ** 2)


def rms_m(completion: Completion, wall: Wall) -> float:
    """Radial error of the surface's vertices in the hidden part."""
    points = completion.surface().vertices_m
    points = points[(points[:, 2] > LOW_M) & (points[:, 2] < HIGH_M)]
    error_m = np.hypot(points[:, 0], points[:, 1]) - wall(
        np.arctan2(points[:, 1], points[:, 0]), points[:, 2]
    )
    return float(np.sqrt(np.mean(error_m**2)))


def probed(wall: Wall, start_m: np.ndarray, end_m: np.ndarray) -> np.ndarray | None:
    """First point of a line inside the body, by marching in 10 um."""
    points = start_m + np.linspace(0, 1, 1 + int(np.linalg.norm(end_m - start_m) / 1e-5))[:, None] * (
        end_m - start_m
    )
    inside = np.hypot(points[:, 0], points[:, 1]) < wall(np.arctan2(points[:, 1], points[:, 0]), points[:, 2])
    return points[int(np.argmax(inside))] if inside.any() else None


def explored(wall: Wall, seed: int, touches: int, **settings) -> np.ndarray:
    """Root mean square error [m] before and after each planned touch."""
    rng = np.random.default_rng([77, seed])
    visible = part(wall, 0.0, LOW_M).joined(part(wall, HIGH_M, HEIGHT_M))
    hidden = part(wall, LOW_M, HIGH_M).vertices_m
    region = HoleRegion.of_points(hidden.mean(axis=0) + 0.9 * (hidden - hidden.mean(axis=0)))
    completion = Completion(visible, region, CompletionSettings(**settings))
    rms = [rms_m(completion, wall)]
    for _ in range(touches):
        plan = completion.next_touch()
        contact = probed(wall, plan.start_m, plan.end_m)
        if contact is not None:
            contact = contact + rng.normal(0.0, SIGMA_M, 3)
        completion.add(Touch(contact, plan.start_m, plan.end_m, SIGMA_M))
        rms.append(rms_m(completion, wall))
    return np.array(rms)


@pytest.mark.parametrize(
    ("wall", "priors", "gain"),
    [
        # A third of the error at least goes where the cross-section is that of the bands or turns slowly; a dent as
        # narrow as the distance of the touches may be missed.
        (lopsided, True, 0.5),
        (twisted, True, 0.67),
        (dented, True, None),
        # The bands of a bent body have a common axis that its middle has not: rings around it would be wrong.
        (leaning, False, None),
    ],
)
def test_touches_never_make_a_body_without_symmetry_worse_than_their_noise(wall, priors, gain):
    rms = explored(wall, 2, 12, use_priors=priors)
    assert rms.max() < rms[0] + SIGMA_M
    if gain is not None:
        assert rms[-1] < gain * rms[0]
