"""Instrument of the tests: a small finite-strain continuum of a foam strip pressed by a rigid body.

It shares nothing with the library: bilinear quadrilaterals, the Ogden-Hill energy
``W = sum_i 2 mu_i / alpha_i^2 (l^alpha_i - 1 - alpha_i ln l)`` summed over both
principal stretches (Poisson ratio zero, so plane strain equals plane stress),
Newton iteration with a line search, frictionless penalty contact at the surface
nodes. Half strip, symmetry plane at s = 0, back face fixed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu


@dataclass(frozen=True)
class Foam:
    mu: tuple[float, ...]
    alpha: tuple[float, ...]
    width: float = 0.02
    height: float = 0.01

    @property
    def terms(self):
        return tuple(zip(self.mu, self.alpha, strict=True))

    def stress(self, strain):
        """Exact uniaxial nominal stress, compression positive."""
        return -self.dw(1 - np.asarray(strain))

    def dw(self, stretch):
        return sum(2 * m / a * (stretch**a - 1) / stretch for m, a in self.terms)

    def ddw(self, stretch):
        return sum(2 * m / a * ((a - 1) * stretch ** (a - 2) + stretch**-2) for m, a in self.terms)


def plate(half: float, r: float = 0.001) -> Callable:
    def shape(x):
        u = np.clip(x - half + r, 0, r * 0.999)
        y = r - np.sqrt(r * r - u * u)
        return np.where(x < half, y, 1.0), u / np.sqrt(r * r - u * u)

    return shape


def cylinder(radius: float) -> Callable:
    def shape(x):
        u = np.clip(x, 0, radius * 0.98)
        root = np.sqrt(radius**2 - u * u)
        return radius - root, u / root

    return shape


def wedge(angle_rad: float, r: float = 0.003) -> Callable:
    """A blunt edge: flanks inclined by ``angle_rad`` to the strip, tip radius r."""
    x0 = r * np.sin(angle_rad)

    def shape(x):
        u = np.minimum(x, x0)
        y = r - np.sqrt(r * r - u * u) + np.tan(angle_rad) * np.maximum(x - x0, 0)
        return y, np.where(x < x0, u / np.sqrt(r * r - u * u), np.tan(angle_rad))

    return shape


def graded(length: float, centre: float, fine: float, coarse: float) -> np.ndarray:
    xs = [0.0]
    while xs[-1] < length:
        xs.append(xs[-1] + min(coarse, fine + 0.12 * abs(xs[-1] - centre)))
    return np.array(xs) * length / xs[-1]


def press(foam: Foam, body: Callable, depths, *, length=0.06, centre=0.0, fine=3e-4, rows=12, spread=0.0):
    """List of (depth, force of the full body, s of the surface, delta of the surface)."""
    w, h = foam.width, foam.height
    xs = graded(length, centre, fine, 1.5e-3) if spread == 0 else np.linspace(0, length, int(length / spread))
    t = np.linspace(0, 1, rows + 1)
    ys = w * (1 - (1 - t) ** 1.6)
    X, Y = np.meshgrid(xs, ys, indexing="ij")
    nodes = np.stack([X.ravel(), Y.ravel()], 1)
    nx, ny = len(xs), len(ys)
    idx = np.arange(nx * ny).reshape(nx, ny)
    quads = np.stack([idx[:-1, :-1], idx[1:, :-1], idx[1:, 1:], idx[:-1, 1:]], -1).reshape(-1, 4)
    g = 1 / np.sqrt(3)
    grads, weights = [], []
    for a, b in ((-g, -g), (g, -g), (g, g), (-g, g)):
        dn = 0.25 * np.array([[-(1 - b), 1 - b, 1 + b, -(1 + b)], [-(1 - a), -(1 + a), 1 + a, 1 - a]])
        jac = np.einsum("in,enk->eik", dn, nodes[quads])
        grads.append(np.einsum("eij,jn->ein", np.linalg.inv(jac), dn))
        weights.append(np.linalg.det(jac))
    B, W = np.stack(grads, 1), np.stack(weights, 1)  # (e,g,2,4), (e,g)
    dofs = (2 * quads[:, :, None] + np.arange(2)).reshape(-1, 8)
    rowi, coli = np.repeat(dofs, 8, 1).ravel(), np.tile(dofs, (1, 8)).ravel()
    fixed = np.concatenate([2 * idx[:, 0], 2 * idx[:, 0] + 1, 2 * idx[0]])
    free = np.setdiff1d(np.arange(2 * nx * ny), fixed)
    top = idx[:, -1]
    trib = np.gradient(xs)
    trib[[0, -1]] /= 2
    trib[0] = (xs[1] - xs[0]) / 2
    trib[-1] = (xs[-1] - xs[-2]) / 2
    kpen = 3e8 * trib
    u = np.zeros((nx * ny, 2))

    def evaluate(u, depth, tangent):
        F = np.eye(2) + np.einsum("eni,egjn->egij", u[quads], B)
        if np.any(np.linalg.det(F) <= 0.02):
            return None
        U, lam, Vt = np.linalg.svd(F)
        p, d = foam.dw(lam), foam.ddw(lam)
        P = np.einsum("egia,ega,egaj->egij", U, p, Vt) * W[..., None, None]
        f = np.zeros((nx * ny, 2))
        np.add.at(f, quads, np.einsum("egij,egjn->eni", P, B))
        pos = nodes[top] + u[top]
        yb, sl = body(pos[:, 0])
        pen = pos[:, 1] - (w - depth + yb)
        on = pen > 0
        force = np.where(on, kpen * pen, 0)
        f[top, 1] += force
        f[top, 0] += -force * sl
        if not tangent:
            return f.ravel(), 2 * force.sum()
        diff = lam[..., 0] - lam[..., 1]
        mid = foam.ddw(lam.mean(-1))
        al = np.where(np.abs(diff) > 1e-5, (p[..., 0] - p[..., 1]) / np.where(diff == 0, 1, diff), mid)
        be = p.sum(-1) / lam.sum(-1)
        T = np.zeros((*lam.shape[:2], 2, 2, 2, 2))
        T[..., 0, 0, 0, 0], T[..., 1, 1, 1, 1] = d[..., 0], d[..., 1]
        T[..., 0, 1, 0, 1] = T[..., 1, 0, 1, 0] = (al + be) / 2
        T[..., 0, 1, 1, 0] = T[..., 1, 0, 0, 1] = (al - be) / 2
        T = np.einsum("egia,egabcd,egbj,egkc,egdl->egijkl", U, T, Vt, U, Vt, optimize=True)
        K = np.einsum("egijkl,egjn,eglm,eg->enimk", T, B, B, W, optimize=True).reshape(-1, 64)
        Ks = sp.csc_matrix((K.ravel(), (rowi, coli)), shape=(u.size, u.size))
        k = np.where(on, kpen, 0)
        tx, ty = 2 * top, 2 * top + 1
        Ks = Ks + sp.csc_matrix(
            (
                np.concatenate([k, -k * sl, -k * sl, k * sl**2]),
                (np.concatenate([ty, ty, tx, tx]), np.concatenate([ty, tx, ty, tx])),
            ),
            shape=Ks.shape,
        )
        return f.ravel(), 2 * force.sum(), Ks

    out, depth = [], 0.0
    for target in depths:
        step = target - depth
        while depth < target - 1e-12:
            trial = min(target, depth + min(step, 6e-4))
            v, ok = u.copy(), False
            for _ in range(40):
                got = evaluate(v, trial, True)
                if got is None:
                    break
                f, total, K = got
                norm = np.linalg.norm(f[free])
                if norm < 1e-5 * max(total, 0.1 * foam.stress(0.05) * w):
                    ok = True
                    break
                dx = np.zeros(u.size)
                dx[free] = -splu(K[free][:, free]).solve(f[free])
                best = None
                for scale in (1.0, 0.5, 0.25, 0.1, 0.03):
                    cand = v + scale * dx.reshape(v.shape)
                    r = evaluate(cand, trial, False)
                    if r is not None:
                        n = np.linalg.norm(r[0][free])
                        if best is None or n < best[0]:
                            best = (n, cand)
                        if n < 0.9 * norm:
                            break
                if best is None:
                    break
                v = best[1]
            if ok:
                u, depth = v, trial
                step *= 1.3
            else:
                step = (trial - depth) / 2
                if step < 1e-6:
                    return out
        pos = nodes[top] + u[top]
        out.append((depth, h * evaluate(u, depth, False)[1], pos[:, 0].copy(), w - pos[:, 1]))
    return out
