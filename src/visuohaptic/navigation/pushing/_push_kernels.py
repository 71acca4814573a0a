"""Quasi-static motion of an object pushed by a round platform: one call per candidate.

Lengths in metres, angles in radians. Forces are fractions of the total floor
friction (coefficient times weight), so that neither mass nor floor friction
is needed. Poses are (x, y, yaw) of the object's reference point.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel
from ._contact_kernels import MAX_CONTACTS, advance, features

#: Depth of the platform's rim in the outline at full friction force (m): the compliance of the contact.
SOFT_M = 1e-4
#: A support point that moves less than this fraction of a step carries less than its full friction.
MIN_SLIP_FRACTION = 2e-3
#: Allowed force imbalance, as a fraction of the floor friction.
TOLERANCE = 3e-3
#: Deviation of the object's motion from the prediction, as a fraction of a step, above which the step is solved again.
MAX_STEP_DEVIATION = 0.3
#: Maximum number of attempts per step.
ATTEMPTS = 20
#: Maximum number of Newton iterations per attempt.
ITERATIONS = 40

#: Columns of the trace of each step.
X, Y, YAW, FORCE_X, FORCE_Y, CONTACT_X, CONTACT_Y, GAP = range(8)

#: Sums over support points may be reordered, for vectorization.
_SUMS = {"reassoc", "contract", "arcp", "nsz"}


@kernel(fastmath=_SUMS)
def _balance(z, pulls, arms, load, rho, eps, contacts, count, shift, turn, mu, known, r, even, full):
    """Floor friction minus contact forces for an increment ``z`` = (dx, dy, rho dyaw), and derivatives.

    ``even`` is the derivative with the limit of the contact friction held fixed,
    ``full`` the complete derivative, which is not symmetric.
    """
    r[0] = r[1] = r[2] = 0.0
    xx = xy = xa = yy = ya = aa = 0.0
    for i in range(load.shape[0]):
        gx, gy = -arms[i, 1] / rho, arms[i, 0] / rho
        vx, vy = z[0] + gx * z[2], z[1] + gy * z[2]
        one = 1.0 / np.sqrt(vx * vx + vy * vy + eps * eps)
        ux, uy, w = vx * one, vy * one, load[i]
        r[0] += w * ux
        r[1] += w * uy
        r[2] += w * (gx * ux + gy * uy)
        w *= one
        hxx, hxy, hyy = w * (1.0 - ux * ux), -w * ux * uy, w * (1.0 - uy * uy)
        xx += hxx
        xy += hxy
        yy += hyy
        bx, by = hxx * gx + hxy * gy, hxy * gx + hyy * gy
        xa += bx
        ya += by
        aa += gx * bx + gy * by
    even[0, 0], even[0, 1], even[0, 2] = xx, xy, xa
    even[1, 0], even[1, 1], even[1, 2] = xy, yy, ya
    even[2, 0], even[2, 1], even[2, 2] = xa, ya, aa
    for a in range(3):
        for b in range(3):
            full[a, b] = even[a, b]
    fx, fy = 0.0, 0.0
    for k in range(count):
        nx, ny, qx, qy = contacts[k, 0], contacts[k, 1], contacts[k, 2], contacts[k, 3]
        na, ta = (qx * ny - qy * nx) / rho, (qx * nx + qy * ny) / rho
        gap = contacts[k, 4] + nx * (z[0] - known[0]) + ny * (z[1] - known[1]) + na * (z[2] - known[2])
        pulls[k] = 0.0
        if gap >= 0.0:
            continue
        push = -gap / SOFT_M
        pulls[k] = push
        # Surface of a disc that rotates by ``turn`` while its centre moves by ``shift``.
        slip = -ny * (z[0] - shift[0]) + nx * (z[1] - shift[1]) + ta * z[2] - turn
        root = np.sqrt(slip * slip + eps * eps)
        rub = -mu * slip / root
        stiff = push * mu * eps * eps / (root * root * root)
        px, py, pa = nx - rub * ny, ny + rub * nx, na + rub * ta
        r[0] -= push * px
        r[1] -= push * py
        r[2] -= push * pa
        fx += push * px
        fy += push * py
        n, t, p = (nx, ny, na), (-ny, nx, ta), (px, py, pa)
        for a in range(3):
            for b in range(3):
                rubbed = stiff * t[a] * t[b]
                even[a, b] += n[a] * n[b] / SOFT_M + rubbed
                full[a, b] += p[a] * n[b] / SOFT_M + rubbed
    return fx, fy


@kernel(fastmath=_SUMS)
def _energy(z, pulls, arms, load, rho, eps, contacts, count, shift, turn, mu, known):
    """Work against the floor, in the compliant rim, and against contact friction limited by ``mu pulls``: convex."""
    total = 0.0
    for i in range(load.shape[0]):
        vx, vy = z[0] - arms[i, 1] / rho * z[2], z[1] + arms[i, 0] / rho * z[2]
        total += load[i] * np.sqrt(vx * vx + vy * vy + eps * eps)
    for k in range(count):
        nx, ny, qx, qy = contacts[k, 0], contacts[k, 1], contacts[k, 2], contacts[k, 3]
        n2, t2 = (qx * ny - qy * nx) / rho, (qx * nx + qy * ny) / rho
        gap = contacts[k, 4] + nx * (z[0] - known[0]) + ny * (z[1] - known[1]) + n2 * (z[2] - known[2])
        if gap < 0.0:
            total += 0.5 * gap * gap / SOFT_M
        slip = -ny * (z[0] - shift[0]) + nx * (z[1] - shift[1]) + t2 * z[2] - turn
        total += mu * pulls[k] * np.sqrt(slip * slip + eps * eps)
    return total


@kernel
def _solve(jac, r, damp, step):
    """``step`` = -inverse(jac + damp I) r by Cramer's rule; False if the matrix is singular."""
    a, b, c = jac[0, 0] + damp, jac[0, 1], jac[0, 2]
    d, e, f = jac[1, 0], jac[1, 1] + damp, jac[1, 2]
    g, h, i = jac[2, 0], jac[2, 1], jac[2, 2] + damp
    A, B, C = e * i - f * h, f * g - d * i, d * h - e * g
    det = a * A + b * B + c * C
    if abs(det) < 1e-30:
        return False
    step[0] = -(A * r[0] + (c * h - b * i) * r[1] + (b * f - c * e) * r[2]) / det
    step[1] = -(B * r[0] + (a * i - c * g) * r[1] + (c * d - a * f) * r[2]) / det
    step[2] = -(C * r[0] + (b * g - a * h) * r[1] + (a * e - b * d) * r[2]) / det
    return True


@kernel
def _newton(z, pulls, arms, load, rho, eps, contacts, count, shift, turn, mu, known, size, work):
    """Solve for the equilibrium increment ``z``; returns whether it was found, and the contact force."""
    r, even, full, step, trial, bound = work[0], work[1:4], work[4:7], work[7], work[8], work[9]
    # Slight damping limits drift where only friction acts.
    damp = 1e-3 / size
    fx, fy = _balance(z, pulls, arms, load, rho, eps, contacts, count, shift, turn, mu, known, r, even, full)
    size_r = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    for _ in range(ITERATIONS):
        if size_r < TOLERANCE * TOLERANCE:
            return True, fx, fy
        slope = 0.0
        if _solve(full, r, damp, step):
            slope = r[0] * step[0] + r[1] * step[1] + r[2] * step[2]
        if not slope < 0.0:
            _solve(even, r, damp, step)
            slope = r[0] * step[0] + r[1] * step[1] + r[2] * step[2]
        length = np.sqrt(step[0] * step[0] + step[1] * step[1] + step[2] * step[2])
        length = min(1.0, 2.0 * size / length)
        for k in range(count):
            bound[k] = pulls[k]
        for a in range(3):
            trial[a] = z[a] + length * step[a]
        fx, fy = _balance(
            trial, pulls, arms, load, rho, eps, contacts, count, shift, turn, mu, known, r, even, full
        )
        size_new = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
        if size_new > 0.5 * size_r:
            # Newton's step overshot; the energy with the friction limit held fixed is convex.
            here = _energy(z, bound, arms, load, rho, eps, contacts, count, shift, turn, mu, known)
            for _ in range(10):
                there = _energy(trial, bound, arms, load, rho, eps, contacts, count, shift, turn, mu, known)
                if there <= here + 1e-3 * length * slope + 1e-15:
                    break
                length *= 0.4
                for a in range(3):
                    trial[a] = z[a] + length * step[a]
            fx, fy = _balance(
                trial, pulls, arms, load, rho, eps, contacts, count, shift, turn, mu, known, r, even, full
            )
            size_new = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
        for a in range(3):
            z[a] = trial[a]
        size_r = size_new
    return False, fx, fy


@kernel
def _tilted(load, support, ox, oy, fraction):
    """Fill ``fraction``: the load distribution when its centre is moved by (ox, oy), in the object's frame."""
    n = load.shape[0]
    mx, my, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        mx += load[i] * support[i, 0]
        my += load[i] * support[i, 1]
    for i in range(n):
        dx, dy = support[i, 0] - mx, support[i, 1] - my
        sxx += load[i] * dx * dx
        sxy += load[i] * dx * dy
        syy += load[i] * dy * dy
    spread = sxx * syy - sxy * sxy
    if spread <= 0.0:
        for i in range(n):
            fraction[i] = load[i]
        return
    ax, ay = (syy * ox - sxy * oy) / spread, (sxx * oy - sxy * ox) / spread
    total = 0.0
    for i in range(n):
        fraction[i] = max(0.0, load[i] * (1.0 + ax * (support[i, 0] - mx) + ay * (support[i, 1] - my)))
        total += fraction[i]
    for i in range(n):
        fraction[i] /= total


@kernel
def push_object(outline, round_m, support, load, rho, tip_m, mu, radius, path, start, trace):
    """Drive a disc along ``path`` (k x 3: x, y, heading) and simulate the object; fills ``trace`` (k x 8).

    Each step solves for the increment of the object's pose at which the
    friction of all support points (unit vectors against their motion, times
    their load) balances the contact forces. This is the exact limit
    surface of the support points; slip directions and sticking of
    the contact follow from the same equation. The rim is stiff, not rigid
    (``SOFT_M``), so that any number of contacts may carry the force.

    Returns the last step with contact, or -1.
    """
    n = support.shape[0]
    x, y, yaw = start[0], start[1], start[2]
    arms, fraction = np.zeros((n, 2)), load.copy()
    contacts, pulls = np.zeros((MAX_CONTACTS, 6)), np.zeros(MAX_CONTACTS)
    z, known, shift = np.zeros(3), np.zeros(3), np.zeros(2)
    work = np.zeros((10, 4))
    reach = 0.0
    for i in range(outline.shape[0]):
        reach = max(reach, np.hypot(outline[i, 0], outline[i, 1]))
    reach += round_m + radius
    last, moving = -1, False
    fx, fy = 0.0, 0.0
    for j in range(path.shape[0]):
        cx, cy = path[j, 0], path[j, 1]
        shift[0] = shift[1] = turn = 0.0
        if j > 0:
            shift[0], shift[1] = cx - path[j - 1, 0], cy - path[j - 1, 1]
            turn = path[j, 2] - path[j - 1, 2]
        size = np.hypot(shift[0], shift[1]) + abs(turn) * radius
        gap = np.hypot(cx - x, cy - y) - reach
        # Predicted motion of the object: that of the last step, or none.
        if not moving:
            known[:] = 0.0
        z[:] = 0.0
        pulls[:] = 0.0
        force_x, force_y, solved = 0.0, 0.0, True
        if gap < size or j == 0:
            for attempt in range(ATTEMPTS):
                # Directions at the middle of the step, gaps at its end: errors of third order in the step.
                sx, sy, turned = 0.5 * shift[0], 0.5 * shift[1], 0.5 * known[2] / rho
                hx, hy = 0.5 * known[0], 0.5 * known[1]
                middle = yaw + turned
                count, gap_new = features(
                    outline, round_m, x + hx, y + hy, middle, cx - sx, cy - sy, radius, size, contacts
                )
                if count > 0:
                    gap_new = advance(contacts, count, sx, sy, hx, hy, turned, radius)
                if attempt == 0:
                    gap = gap_new
                if count == 0 or size == 0.0 or (not moving and attempt == 0 and gap >= 0.0):
                    break
                # Lever arms at the middle of the step, so that a rotation has errors of third order only.
                c, s = np.cos(middle), np.sin(middle)
                for i in range(n):
                    arms[i, 0] = c * support[i, 0] - s * support[i, 1]
                    arms[i, 1] = s * support[i, 0] + c * support[i, 1]
                if tip_m > 0.0 and attempt == 0:
                    # A force above the floor shifts the load in the direction of the force.
                    _tilted(load, support, tip_m * (c * fx + s * fy), tip_m * (-s * fx + c * fy), fraction)
                if moving or attempt > 0:
                    for a in range(3):
                        z[a] = known[a]
                else:
                    z[0], z[1], z[2] = shift[0], shift[1], 0.0
                # At the transition from sticking to slipping Newton may cycle; stronger regularization prevents that.
                eps, spin = MIN_SLIP_FRACTION * size, turn * radius
                for _ in range(5):
                    solved, force_x, force_y = _newton(
                        z,
                        pulls,
                        arms,
                        fraction,
                        rho,
                        eps,
                        contacts,
                        count,
                        shift,
                        spin,
                        mu,
                        known,
                        size,
                        work,
                    )
                    if solved:
                        break
                    eps *= 6.0
                off = np.hypot(z[0] - known[0], z[1] - known[1]) + abs(z[2] - known[2])
                # The prediction was wrong: linearize again at the result, with a decreasing step fraction, because full
                # steps may alternate between two contact modes.
                if off < MAX_STEP_DEVIATION * size or not solved:
                    break
                if attempt + 1 < ATTEMPTS:
                    weight = 1.0 if attempt == 0 else 0.5 if attempt < 4 else 1.0 / attempt
                    for a in range(3):
                        known[a] += weight * (z[a] - known[a])
        x, y, yaw = x + z[0], y + z[1], yaw + z[2] / rho
        for a in range(3):
            known[a] = z[a]
        fx, fy = force_x, force_y
        best, pull = -1, 0.0
        for a in range(MAX_CONTACTS):
            if pulls[a] > pull:
                best, pull = a, pulls[a]
        moving = best >= 0
        trace[j, X], trace[j, Y], trace[j, YAW] = x, y, yaw
        trace[j, FORCE_X], trace[j, FORCE_Y] = fx, fy
        trace[j, CONTACT_X] = trace[j, CONTACT_Y] = np.nan
        trace[j, GAP] = gap
        if moving:
            last = j
            trace[j, CONTACT_X] = cx + radius * contacts[best, 0]
            trace[j, CONTACT_Y] = cy + radius * contacts[best, 1]
            trace[j, GAP] = -SOFT_M * pull
    return last
