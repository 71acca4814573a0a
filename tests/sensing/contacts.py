"""Truth for contact shapes, made apart from the estimator.

A strip of foam is a row of nonlinear springs under a lateral tension. An
object is pressed into it; the front contour is the solution of an obstacle
problem on a fine grid,

    m(delta) - T delta'' >= 0,  delta >= delta_object,  one of both equal,

with free ends (delta' = 0). It is solved by an active set with Newton steps.
Nothing here is shared with the fit: the foam's law is a stiff start, a
plateau and densification, the outline is a polygon or a disc and not a
primitive, and the kind is what touched the foam.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import solve_banded

STRIP_HALF_M = 0.125
FOAM_M = 0.020
GRID_M = 0.00025
GRID = np.arange(-STRIP_HALF_M, STRIP_HALF_M + 0.5 * GRID_M, GRID_M)


@dataclass(frozen=True)
class Foam:
    """Stress by strain: E e0 tanh(e / e0) + plateau slope + densification [Pa]."""

    initial_Pa: float
    knee: float
    plateau_Pa: float
    densify_Pa: float
    tension_N_per_m: float  # T per height of the strip [N/m]

    def stress(self, delta: np.ndarray) -> np.ndarray:
        e = delta / FOAM_M
        return (
            self.initial_Pa * self.knee * np.tanh(e / self.knee)
            + self.plateau_Pa * e
            + self.densify_Pa * e**5
        )

    def slope(self, delta: np.ndarray) -> np.ndarray:
        e = delta / FOAM_M
        return (
            self.initial_Pa / np.cosh(np.minimum(e / self.knee, 50)) ** 2
            + self.plateau_Pa
            + 5 * self.densify_Pa * e**4
        ) / FOAM_M


def random_foam(rng: np.random.Generator) -> Foam:
    """A foam whose flanks decay within 4 to 10 mm at a deflection of 3 mm."""
    foam = Foam(
        initial_Pa=rng.uniform(4e4, 9e4),
        knee=rng.uniform(0.05, 0.15),
        plateau_Pa=rng.uniform(4e3, 1.5e4),
        densify_Pa=rng.uniform(0, 6e4),
        tension_N_per_m=1.0,
    )
    length = rng.uniform(0.004, 0.010)
    secant = float(foam.stress(np.array(0.003))) / 0.003
    return Foam(foam.initial_Pa, foam.knee, foam.plateau_Pa, foam.densify_Pa, secant * length**2)


def press(foam: Foam, obstacle_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Contour (deflection) and where it touches, for an obstacle on ``GRID`` (-inf: nothing there)."""
    n = len(GRID)
    delta = np.maximum(obstacle_m, 0.0)
    touched = obstacle_m > 0
    stiffness = foam.tension_N_per_m / GRID_M**2
    for _ in range(400):
        # Newton on the free points, touched points held on the obstacle.
        for _ in range(50):
            bent = np.zeros(n)
            bent[1:-1] = delta[2:] - 2 * delta[1:-1] + delta[:-2]
            bent[0] = 2 * (delta[1] - delta[0])  # mirror: free end
            bent[-1] = 2 * (delta[-2] - delta[-1])
            residual = foam.stress(delta) - stiffness * bent
            residual[touched] = delta[touched] - obstacle_m[touched]
            bands = np.zeros((3, n))
            diagonal = foam.slope(delta) + 2 * stiffness
            upper = np.full(n, -stiffness)
            lower = np.full(n, -stiffness)
            upper[0], lower[-1] = -2 * stiffness, -2 * stiffness
            diagonal[touched], upper[touched], lower[touched] = 1.0, 0.0, 0.0
            bands[0, 1:], bands[1], bands[2, :-1] = upper[:-1], diagonal, lower[1:]
            step = solve_banded((1, 1), bands, residual)
            delta = delta - step
            if np.abs(step).max() < 1e-10:
                break
        bent[1:-1] = delta[2:] - 2 * delta[1:-1] + delta[:-2]
        bent[0], bent[-1] = 2 * (delta[1] - delta[0]), 2 * (delta[-2] - delta[-1])
        pressure = foam.stress(delta) - stiffness * bent
        new = np.where(touched, pressure > 0, delta < obstacle_m - 1e-12)
        if np.array_equal(new, touched):
            return delta, touched
        touched = new
    raise RuntimeError("the obstacle problem did not settle")


def polygon_depth(vertices_m: np.ndarray) -> np.ndarray:
    """Depth of a convex polygon below the rest line at every grid point; vertices are (y, depth)."""
    low, high = vertices_m[:, 0].min(), vertices_m[:, 0].max()
    depth = np.full(len(GRID), -np.inf)
    inside = (low <= GRID) & (high >= GRID)
    for a, b in zip(vertices_m, np.roll(vertices_m, -1, axis=0), strict=True):
        if abs(b[0] - a[0]) < 1e-9:
            continue
        span = inside & (min(a[0], b[0]) <= GRID) & (max(a[0], b[0]) >= GRID)
        y = GRID[span]
        depth[span] = np.maximum(depth[span], a[1] + (b[1] - a[1]) * (y - a[0]) / (b[0] - a[0]))
    return depth


@dataclass(frozen=True)
class TrueContact:
    """One contact as the sensor would see it, and what it was."""

    scene: str
    kind: str  # what touched the foam: line, segment, corner, circle
    points_m: np.ndarray  # (k, 2), frame F
    sigma_m: np.ndarray
    delta_m: np.ndarray
    clear: bool  # told apart by the rule of `is_clear`
    truth: dict[str, float] = field(default_factory=dict)
    outline_m: np.ndarray | None = None


def sample(
    delta: np.ndarray, sigma_m: float, rng: np.random.Generator, spacing_m: float = 0.003
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points every ``spacing_m`` along the strip, the region around the deepest one."""
    start = rng.uniform(0, spacing_m)
    y = np.arange(-STRIP_HALF_M + start, STRIP_HALF_M, spacing_m)
    measured = np.interp(y, GRID, delta) + sigma_m * rng.standard_normal(len(y))
    threshold = max(5 * sigma_m, 5e-5)
    first = last = int(np.argmax(measured))
    while first > 0 and measured[first - 1] > threshold:
        first -= 1
    while last < len(y) - 1 and measured[last + 1] > threshold:
        last += 1
    keep = slice(first, last + 1)
    points = np.stack([FOAM_M - measured[keep], y[keep]], axis=1)
    return points, np.full(len(points), sigma_m), measured[keep]


def _box(width: float, length: float, tilt: float) -> np.ndarray:
    """Corners (y, depth) of a box; its face is along y for tilt 0, its body lies at negative depth."""
    local = np.array([[-width / 2, 0], [width / 2, 0], [width / 2, -length], [-width / 2, -length]])
    c, s = np.cos(tilt), np.sin(tilt)
    return local @ np.array([[c, s], [-s, c]])


def _wedge(angle: float, tilt: float, length: float = 0.3) -> np.ndarray:
    """A tip with the interior angle ``angle`` whose bisector is tilted."""
    left, right = -np.pi / 2 - angle / 2 + tilt, -np.pi / 2 + angle / 2 + tilt
    return length * np.array(
        [[0, 0], [np.cos(right), np.sin(right)], [np.cos(left), np.sin(left)]],
    )


SCENES = ("wall", "box", "corner", "cylinder", "leg")


def random_contact(rng: np.random.Generator, scene: str | None = None) -> TrueContact:
    """One random contact of the campaign; None is never returned."""
    scene = scene or SCENES[int(rng.integers(len(SCENES)))]
    foam = random_foam(rng)
    sigma = float(np.exp(rng.uniform(np.log(5e-6), np.log(5e-5))))
    depth = rng.uniform(0.001, 0.010)
    offset = rng.uniform(-0.09, 0.09)
    truth: dict[str, float] = {}
    vertices = None
    if scene == "cylinder" or (scene == "leg" and rng.random() < 0.5):
        radius = 0.015 if scene == "leg" else float(np.exp(rng.uniform(np.log(0.015), np.log(0.2))))
        t = np.clip((GRID - offset) / radius, -1, 1)
        height = depth - radius * (1 - np.sqrt(1 - t**2))
        obstacle = np.where(np.abs(GRID - offset) < radius, height, -np.inf)
        truth = {"radius_m": radius, "y_m": offset, "x_m": FOAM_M - depth + radius}
        tips = np.zeros((0, 2))
    else:
        if scene == "wall":
            tilt = rng.uniform(-np.pi / 6, np.pi / 6) * rng.random()
            vertices = _box(3.0, 1.0, tilt)
            vertices[:, 1] += depth - _depth_at_strip(vertices)
        elif scene == "box":
            # Tilts of all sizes, so that faces are touched fully, partly or at one corner.
            tilt = rng.uniform(-np.pi / 6, np.pi / 6) * rng.random() ** 2
            vertices = _box(rng.uniform(0.02, 0.12), 0.2, tilt)
        elif scene == "corner":
            vertices = _wedge(np.deg2rad(rng.uniform(60, 120)), np.deg2rad(rng.uniform(-30, 30)))
        else:
            vertices = _box(0.04, 0.04, np.deg2rad(rng.uniform(-45, 45)))
        if scene != "wall":
            vertices[:, 0] += offset
            vertices[:, 1] += depth - _depth_at_strip(vertices)
        obstacle = polygon_depth(vertices)
        tips = vertices
    if not np.any(obstacle > 0):
        return random_contact(rng, scene)
    delta, touched = press(foam, obstacle)
    points, sigmas, deflection = sample(delta, sigma, rng)
    if len(points) < 5:
        return random_contact(rng, scene)
    kind, clear, more = label(delta, touched, obstacle, tips, sigma, truth)
    return TrueContact(scene, kind, points, sigmas, deflection, clear, truth | more, vertices)


def _depth_at_strip(vertices: np.ndarray) -> float:
    depth = polygon_depth(vertices)
    return float(depth.max()) if np.isfinite(depth.max()) else float(vertices[:, 1].max())


def label(
    delta: np.ndarray,
    touched: np.ndarray,
    obstacle: np.ndarray,
    tips: np.ndarray,
    sigma: float,
    truth: dict[str, float],
    spacing: float = 0.003,
) -> tuple[str, bool, dict[str, float]]:
    """Kind by what touched the foam, and whether it can be told at all.

    Two tips of the object in contact, or one and a face that runs out over the
    strip's end: segment. One tip otherwise: corner. None: line, or circle for
    a round object. Fixed before measuring, a contact is *not clear* when

    - round: the touched arc is shorter than two point spacings (a tip) or its
      sagitta is below three sigma (a line);
    - a tip bends the contour so little that the next point moves by less than
      three sigma (it might as well not touch), or it misses the foam by less;
    - a tip lies within two point spacings of the strip's end.
    """
    where = np.flatnonzero(touched)
    first, last = int(where[0]), int(where[-1])
    if "radius_m" in truth:
        width = GRID[last] - GRID[first]
        sagitta = width**2 / (8 * truth["radius_m"])
        return "circle", bool(width >= 2 * spacing and sagitta >= 3 * sigma), {"touched_m": width}
    touching, clear = [], True
    for y, depth in tips:
        if not (GRID[0] <= y <= GRID[-1]) or depth < obstacle.max() - 0.05:
            continue
        index = round((y - GRID[0]) / GRID_M)
        near = touched[max(index - 2, 0) : index + 3].any()
        # The grid may lie half a step beside the tip; a corner on the far side is much shallower.
        if near and abs(delta[index] - depth) < 5e-4:
            # The bend of the contour at the tip, beyond what the face does by itself.
            a, b = max(index - 4, 0), min(index + 4, len(GRID) - 1)
            left = (delta[index] - delta[max(a - 4, 0)]) / (GRID[index] - GRID[max(a - 4, 0)] + 1e-12)
            right = (delta[min(b + 4, len(GRID) - 1)] - delta[index]) / (
                GRID[min(b + 4, len(GRID) - 1)] - GRID[index] + 1e-12
            )
            clear &= bool(abs(left - right) * spacing > 3 * sigma)
            clear &= bool(min(y - GRID[0], GRID[-1] - y) > 2 * spacing)
            touching.append(y)
        elif depth > -0.002 and delta[index] - depth < 3 * sigma:
            clear = False
    ends = {"left_end": float(first == 0), "right_end": float(last == len(GRID) - 1)}
    if len(touching) >= 2 and max(touching) - min(touching) > 2 * spacing:
        kind = "segment" if len(touching) == 2 else "corner"
    elif len(touching) >= 1:
        kind = "segment" if first == 0 or last == len(GRID) - 1 else "corner"
    else:
        kind = "line"
    return kind, clear, ends | {"tip_y_m": touching[0] if touching else np.nan}
