"""A continuum foam strip under rigid bodies: plane-strain finite elements of its own.

Strip: |y| <= length / 2, 0 <= x <= width, glued along x = 0, free at its ends and its front. Ogden-Hill
("hyperfoam") energy per volume with principal stretches a, b and J = a b,

    W = sum_i 2 mu_i / alpha_i^2 [a^alpha_i + b^alpha_i - 2 + (J^(-alpha_i beta) - 1) / beta],

9-node quadrilaterals, 3 x 3 Gauss points, Newton iteration with the exact tangent of the foam; frictionless
contact by penalty at four Gauss points of each surface edge against the exact shape of the body.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_banded

__all__ = ["Foam", "Press", "bar", "cylinder", "press", "together"]

#: Height of a body above its lowest point, and its slope, at places y [m].
Shape = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
#: Slope [-] at which a round edge becomes a straight flank.
_FLANK = 5.0


@dataclass(frozen=True)
class Foam:
    """Hyperelastic foam of one strip; SI units."""

    mu_Pa: tuple[float, ...] = (33600.0, 150.0)
    alpha: tuple[float, ...] = (12.0, -2.0)
    beta: float = 0.0  #: Poisson ratio of small strains is beta / (1 + 2 beta)
    width_m: float = 0.02
    height_m: float = 0.01
    length_m: float = 0.25

    def stresses(self, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, ...]:
        """Principal nominal stresses and their derivatives: Pa, Pb, Paa, Pbb, Pab."""
        pa, pb, paa, pbb, pab = (np.zeros_like(a) for _ in range(5))
        for mu, alpha in zip(self.mu_Pa, self.alpha, strict=True):
            c, volume = 2 * mu / alpha, (a * b) ** (-alpha * self.beta)
            pa += c * (a**alpha - volume) / a
            pb += c * (b**alpha - volume) / b
            more = (1 + alpha * self.beta) * volume
            paa += c * ((alpha - 1) * a ** (alpha - 2) + more / a**2)
            pbb += c * ((alpha - 1) * b ** (alpha - 2) + more / b**2)
            pab += c * alpha * self.beta * volume / (a * b)
        return pa, pb, paa, pbb, pab

    def plate_stress_Pa(self, strain: np.ndarray) -> np.ndarray:
        """Nominal stress under a plate that covers a long strip, compression positive."""
        stretch = 1.0 - np.asarray(strain, dtype=float)
        return -self.stresses(stretch, np.ones_like(stretch))[0]


@dataclass(frozen=True)
class Press:
    """One depth of a press."""

    depth_m: float  #: travel of the body's lowest point below the undeformed front
    force_N: float  #: on the body, away from the base, full height of the strip
    y_m: np.ndarray  #: deformed front, in order of y
    delta_m: np.ndarray  #: its deflection towards the base
    end_low_m: np.ndarray  #: y of the end face at the lower y, at even heights from base to width
    end_high_m: np.ndarray
    pressed_m: tuple[float, float]  #: first and last place that touches the body; NaN without


def cylinder(radius_m: float, y_m: float = 0.0) -> Shape:
    """A cylinder whose axis is along the height of the strip."""
    return bar(0.0, radius_m, y_m)


def bar(half_m: float, radius_m: float, y_m: float = 0.0, tilt_rad: float = 0.0) -> Shape:
    """A plate of half length ``half_m`` + ``radius_m`` with edges of that radius, tilted in the plane."""
    cos, sin = np.cos(tilt_rad), np.sin(tilt_rad)
    straight = max(half_m, 0.0)
    edge = radius_m * _FLANK / np.hypot(1.0, _FLANK)

    def shape(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        u = y - y_m
        # Centre line of the plate's edge: a segment; its lower envelope at a distance of the radius.
        low, high = -straight * cos + radius_m * sin, straight * cos + radius_m * sin
        flat = u * np.tan(tilt_rad) - radius_m / cos
        height, slope = flat, np.full_like(u, np.tan(tilt_rad))
        for side, keep in ((-1.0, u < low), (1.0, u > high)):
            away = u - side * straight * cos
            inner = np.clip(away, -edge, edge)
            root = np.sqrt(radius_m**2 - inner**2)
            round_ = side * straight * sin - root + (away - inner) * np.sign(away) * _FLANK
            steep = np.where(np.abs(away) > edge, np.sign(away) * _FLANK, inner / root)
            height, slope = np.where(keep, round_, height), np.where(keep, steep, slope)
        return height + straight * abs(sin) + radius_m, slope

    return shape


def together(*shapes: tuple[Shape, float]) -> Shape:
    """Bodies on one holder, each with its offset above the lowest [m]."""

    def shape(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        heights, slopes = zip(*((one(y)[0] + offset, one(y)[1]) for one, offset in shapes), strict=True)
        which = np.argmin(heights, axis=0)[None]
        return np.take_along_axis(np.array(heights), which, 0)[0], np.take_along_axis(
            np.array(slopes), which, 0
        )[0]

    return shape


def _graded(half_m: float, spans: list[tuple[float, float]], fine_m: float, coarse_m: float) -> np.ndarray:
    """Corners of elements from -half to half, fine within the spans."""
    y = np.linspace(-half_m, half_m, 4001)
    away = np.min([np.maximum(np.maximum(low - y, y - high), 0.0) for low, high in spans], axis=0)
    density = 1.0 / np.minimum(coarse_m, fine_m + 0.15 * away)
    total = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(y))])
    return np.interp(np.linspace(0, total[-1], int(np.ceil(total[-1])) + 1), total, y)


class _Mesh:
    """Elements, shape functions and degrees of freedom of one strip."""

    def __init__(self, foam: Foam, corners_m: np.ndarray, layers: int) -> None:
        self.foam = foam
        across = foam.width_m * (1 - (1 - np.linspace(0, 1, layers + 1)) ** 1.4)
        y, x = (np.interp(np.arange(2 * len(c) - 1) / 2, np.arange(len(c)), c) for c in (corners_m, across))
        self.columns, self.rows = len(y), len(x)
        grid = np.arange(self.columns * self.rows).reshape(self.columns, self.rows)
        self.nodes = np.stack(np.meshgrid(y, x, indexing="ij"), -1)[..., ::-1].reshape(-1, 2)  # x, y
        starts = grid[:-2:2, :-2:2]
        steps = np.array([i * self.rows + j for i in range(3) for j in range(3)])
        self.elements = starts.reshape(-1, 1) + steps
        self.top, self.back = grid[:, -1], grid[:, 0]
        self.ends = grid[0], grid[-1]
        gauss = np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)])
        weight = np.array([5, 8, 5]) / 9
        value, slope = _quadratic(gauss)
        dy = np.einsum("ai,bj->abij", slope, value).reshape(9, 9)
        dx = np.einsum("ai,bj->abij", value, slope).reshape(9, 9)
        local = np.stack([dx, dy], 1)  # (gauss, local axis, node)
        jacobian = np.einsum("gin,enk->egik", local, self.nodes[self.elements])
        self.gradient = np.einsum("egki,gin->egkn", np.linalg.inv(jacobian), local)
        self.volume = np.linalg.det(jacobian) * np.outer(weight, weight).reshape(1, 9)
        dofs = (2 * self.elements[:, :, None] + np.arange(2)).reshape(-1, 18)
        self.free = np.setdiff1d(np.arange(2 * len(self.nodes)), np.r_[2 * self.back, 2 * self.back + 1])
        place, w4 = np.polynomial.legendre.leggauss(4)
        self.edge_value = _quadratic(place)[0]  # (gauss, node)
        self.edges = np.stack([self.top[:-2:2], self.top[1:-1:2], self.top[2::2]], 1)
        half = 0.5 * (self.nodes[self.edges[:, 2], 1] - self.nodes[self.edges[:, 0], 1])
        self.edge_length = half[:, None] * w4[None]
        edge_dofs = (2 * self.edges[:, :, None] + np.arange(2)).reshape(-1, 6)
        # Degrees of freedom are numbered column by column, so that the tangent is a band.
        self.band = 2 * (2 * self.rows + 2) + 1
        row = np.concatenate([np.repeat(dofs, 18, 1).ravel(), np.repeat(edge_dofs, 6, 1).ravel()])
        column = np.concatenate([np.tile(dofs, (1, 18)).ravel(), np.tile(edge_dofs, (1, 6)).ravel()])
        size = 2 * len(self.nodes)
        self.fixed = np.setdiff1d(np.arange(size), self.free)
        self.kept = np.isin(row, self.free) & np.isin(column, self.free)
        self.place = ((self.band + row - column) * size + column)[self.kept]

    def solve(self, data: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Displacements that the tangent's entries ask for; zero where the strip is glued."""
        size = right.size
        band = np.bincount(self.place, data[self.kept], (2 * self.band + 1) * size).reshape(-1, size)
        band[self.band, self.fixed] = 1.0
        right = np.where(np.isin(np.arange(size), self.fixed), 0.0, right)
        return solve_banded((self.band, self.band), band, right, overwrite_ab=True, check_finite=False)

    def contact(self, u: np.ndarray, shape: Shape, depth_m: float, stiffness: float) -> tuple:
        """Penetration of the edges' Gauss points, with the body's slope there."""
        place = np.einsum("gn,enk->egk", self.edge_value, (self.nodes + u)[self.edges])
        height, slope = shape(place[..., 1])
        depth = np.maximum(place[..., 0] - (self.foam.width_m - depth_m + height), 0.0)
        return stiffness * depth * self.edge_length, slope, depth > 0

    def forces(
        self, u: np.ndarray, shape: Shape, depth_m: float, stiffness: float, tangent: bool
    ) -> tuple | None:
        """Residual, force per height of the body and, if asked for, the tangent; ``None`` beyond validity."""
        deform = np.eye(2) + np.einsum("enk,eghn->egkh", u[self.elements], self.gradient)
        if np.linalg.det(deform).min() < 0.03:
            return None
        left, stretch, right = _principal(deform)
        pa, pb, paa, pbb, pab = self.foam.stresses(stretch[..., 0], stretch[..., 1])
        scaled = np.stack([pa, pb], -1)
        stress = (left * scaled[..., None, :]) @ right * self.volume[..., None, None]
        residual = np.zeros_like(u)
        np.add.at(residual, self.elements, np.einsum("egkh,eghn->enk", stress, self.gradient))
        push, slope, touching = self.contact(u, shape, depth_m, stiffness)
        along = np.stack([push, -push * slope], -1)
        np.add.at(residual, self.edges, np.einsum("egk,gn->enk", along, self.edge_value))
        if not tangent:
            return residual.ravel(), push.sum()
        a, b = stretch[..., 0], stretch[..., 1]
        apart = np.abs(a - b) > 1e-6
        minus = np.where(apart, (pa - pb) / np.where(apart, a - b, 1.0), 0.5 * (paa + pbb) - pab)
        plus = (pa + pb) / (a + b)
        core = np.zeros((*a.shape, 2, 2, 2, 2))
        core[..., 0, 0, 0, 0], core[..., 1, 1, 1, 1] = paa, pbb
        core[..., 0, 0, 1, 1] = core[..., 1, 1, 0, 0] = pab
        core[..., 0, 1, 0, 1] = core[..., 1, 0, 1, 0] = 0.5 * (minus + plus)
        core[..., 0, 1, 1, 0] = core[..., 1, 0, 0, 1] = 0.5 * (minus - plus)
        # Gradient of each degree of freedom in the principal frame: left^T dF right^T.
        turned = np.einsum("egah,eghn->egan", right, self.gradient)
        base = np.einsum("egka,egbn->egabnk", left, turned).reshape(*a.shape, 4, 18)
        weighted = np.matmul(core.reshape(*a.shape, 4, 4) * self.volume[..., None, None], base)
        stiff = np.matmul(base.transpose(0, 1, 3, 2), weighted).sum(1)
        normal = np.stack([np.ones_like(slope), -slope], -1)
        scale = stiffness * self.edge_length * touching
        shape_of = np.einsum("egk,gn->egnk", normal, self.edge_value).reshape(*slope.shape, 6)
        edge = np.einsum("eg,egi,egj->eij", scale, shape_of, shape_of)
        data = np.concatenate([stiff.ravel(), edge.ravel()])
        return residual.ravel(), push.sum(), data


def _principal(f: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Singular values of 2 x 2 matrices of positive determinant, with rotations: left diag(values) right."""
    e, g = 0.5 * (f[..., 0, 0] + f[..., 1, 1]), 0.5 * (f[..., 0, 0] - f[..., 1, 1])
    h, k = 0.5 * (f[..., 1, 0] - f[..., 0, 1]), 0.5 * (f[..., 1, 0] + f[..., 0, 1])
    mean, half = np.hypot(e, h), np.hypot(g, k)
    one, two = np.arctan2(k, g), np.arctan2(h, e)
    turns = []
    for angle in (0.5 * (two + one), 0.5 * (two - one)):
        cos, sin = np.cos(angle), np.sin(angle)
        turns.append(np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], -2))
    return turns[0], np.stack([mean + half, mean - half], -1), turns[1]


def _quadratic(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quadratic shape functions of nodes at -1, 0, 1 and their slopes at t, (t, 3)."""
    return (
        np.stack([0.5 * t * (t - 1), 1 - t**2, 0.5 * t * (t + 1)], 1),
        np.stack([t - 0.5, -2 * t, t + 0.5], 1),
    )


def _solve(mesh: _Mesh, u: np.ndarray, shape: Shape, depth_m: float, stiffness: float) -> np.ndarray | None:
    """Displacements in equilibrium, from a guess; ``None`` if Newton's iteration does not converge."""
    floor = 1e-4 * mesh.foam.plate_stress_Pa(np.array(0.02)) * mesh.foam.width_m
    for _ in range(30):
        found = mesh.forces(u, shape, depth_m, stiffness, tangent=True)
        if found is None:
            return None
        residual, total, tangent = found
        size = np.linalg.norm(residual[mesh.free])
        if size < 1e-5 * total + floor:
            return u
        step = -mesh.solve(tangent, residual)
        best, best_size = None, np.inf
        for part in (1.0, 0.5, 0.2, 0.05):
            trial = u + part * step.reshape(u.shape)
            got = mesh.forces(trial, shape, depth_m, stiffness, tangent=False)
            if got is not None and (norm := np.linalg.norm(got[0][mesh.free])) < best_size:
                best, best_size = trial, norm
            if best_size < 0.9 * size:
                break
        if best is None:
            return None
        u = best
    return None


def press(
    foam: Foam,
    shape: Shape,
    depths_m: np.ndarray,
    *,
    spans_m: list[tuple[float, float]],
    fine_m: float = 0.9e-3,
    coarse_m: float = 6e-3,
    layers: int = 5,
    penalty: float = 60.0,
) -> list[Press]:
    """Press a body into the strip; stops early where no equilibrium is found.

    ``spans_m`` are intervals of y where the mesh is fine; ``penalty`` is the contact's stiffness in units of the foam's
    initial modulus per width.
    """
    mesh = _Mesh(foam, _graded(0.5 * foam.length_m, spans_m, fine_m, coarse_m), layers)
    modulus = 2 * sum(foam.mu_Pa)
    stiffness = penalty * modulus / foam.width_m * 40.0
    u, before, reached, done = np.zeros_like(mesh.nodes), None, 0.0, []
    for target in depths_m:
        step = target - reached
        while reached < target - 1e-9:
            depth = min(target, reached + step)
            guess = u if before is None else u + (u - before[1]) * (depth - reached) / (reached - before[0])
            found = _solve(mesh, guess, shape, depth, stiffness)
            if found is None and before is not None:
                found = _solve(mesh, u, shape, depth, stiffness)
            if found is None:
                step *= 0.4
                if step < 2e-5:
                    return done
                continue
            before, u, reached = (reached, u), found, depth
        done.append(_record(mesh, u, shape, reached, stiffness))
    return done


def _record(mesh: _Mesh, u: np.ndarray, shape: Shape, depth_m: float, stiffness: float) -> Press:
    """What the camera sees and the scale shows."""
    foam = mesh.foam
    push, _, touching = mesh.contact(u, shape, depth_m, stiffness)
    # Between the nodes by their shape functions: eight places of each edge.
    value = _quadratic(np.linspace(-1, 1, 9)[:-1])[0]
    place = np.einsum("gn,enk->egk", value, (mesh.nodes + u)[mesh.edges]).reshape(-1, 2)
    place = np.vstack([place, (mesh.nodes + u)[mesh.top[-1]]])
    y = np.maximum.accumulate(place[:, 1])
    heights = np.linspace(0, 1.1 * foam.width_m, 45)
    faces = []
    for face in mesh.ends:
        at = (mesh.nodes + u)[face]
        faces.append(np.interp(heights, np.maximum.accumulate(at[:, 0]), at[:, 1]))
    spots = np.einsum("gn,en->eg", mesh.edge_value, (mesh.nodes + u)[mesh.edges][..., 1])[touching]
    pressed = (float(spots.min()), float(spots.max())) if len(spots) else (np.nan, np.nan)
    return Press(depth_m, foam.height_m * float(push.sum()), y, foam.width_m - place[:, 0], *faces, pressed)
