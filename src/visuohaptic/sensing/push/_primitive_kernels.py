"""Contour of a foam strip with a convex outline pressed into it: kernels of the primitive fit."""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel

#: Layout of ``theta``, by family of the outline:
#: STRAIGHT (a, m, tip_left, tip_right, drop, logS_left, logS_right, n)
#: ROUND (u_c, d, log R, logS_left, logS_right, n)
#: BENT (u_0, d, m_left, m_right, logS_left, logS_right, n)
STRAIGHT, ROUND, BENT = 0, 1, 2
#: Distance over which foam detaches at a sharp edge: continuum simulations of an edge of 0.8 mm radius [m].
EDGE_M = 3e-4


@kernel
def _outline(family, theta, u):
    """Depth of the outline [m] and its slope at ``u``."""
    if family == 0:
        return theta[0] + theta[1] * u, theta[1]
    if family == 1:
        radius = np.exp(theta[2])
        t = u - theta[0]
        # Beyond 0.999 R the outline is continued by its tangent, so that a poor start has a gradient.
        limit = 0.999 * radius
        inside = min(max(t, -limit), limit)
        root = np.sqrt(radius * radius - inside * inside)
        slope = -inside / root
        return theta[1] - radius + root + slope * (t - inside), slope
    t = u - theta[0]
    if t < 0:
        return theta[1] + theta[2] * t, theta[2]
    return theta[1] - theta[3] * t, -theta[3]


@kernel
def _detached(family, theta, rest, u, side, log_slope, n, scale):
    """Excess of the slope at which the object recedes over the slope of the foam; positive: the foam has detached."""
    depth, slope = _outline(family, theta, u)
    delta = depth - (rest[0] + (rest[1] + rest[2] * u) * u)
    if delta <= 0.0:
        return 1.0 - delta
    fall = -side * (slope - rest[1] - 2.0 * rest[2] * u)
    return fall - np.exp(log_slope) * (delta / scale) ** (0.5 * (n + 1.0))


@kernel
def _kept(family, theta, which, edge):
    """Fraction of the deflection at an end of the contact with which the flank starts."""
    return 1.0 - theta[4] if family == 0 and edge == theta[2 + which] else 1.0


@kernel
def contact_profile(family, theta, rest, scale, low, high, u, delta, touched):
    """Deflection ``delta`` [m] and contact mask ``touched`` at the positions ``u`` [m]; returns the ends of the contact.

    Flanks satisfy T delta'' = c delta^n, whose first integral gives the slope
    of the foam at a deflection, S(delta) = S_scale (delta / scale)^((n+1)/2).
    The object is in contact from its deepest point outwards until it recedes
    more steeply than S or ends at a tip. At a tip the foam leaves the object
    perpendicularly, like any elastic body under a sharp punch: within ``EDGE_M``
    the flank drops by the fraction ``drop`` of the deflection.

    Parameters
    ----------
    family
        ``STRAIGHT``, ``ROUND`` or ``BENT``.
    theta
        Parameters of the outline and its flanks in the layout above, (p,).
    rest
        Polynomial of the undeformed front, (3,).
    scale
        Largest deflection [m].
    low, high
        Range of u that the strip covers [m].
    u
        Positions along the strip, increasing [m], (K,).
    delta, touched
        Deflection [m] and whether the point is in contact with the object, (K,), filled.
    """
    k = len(theta)
    n = theta[k - 1]
    if abs(n - 1.0) < 1e-4:
        n = 1.0 - 1e-4
    left, right = low, high
    if family == 0:
        left, right = max(theta[2], low), min(theta[3], high)
        if left > right:
            left = right = 0.5 * (left + right)
    # Deepest point: the outline is convex towards the foam, so a ternary search finds it.
    a, b = left, right
    if family == 2:
        a = b = min(max(theta[0], left), right)
    for _ in range(40):
        if b - a < 1e-7:
            break
        p, q = a + (b - a) / 3.0, b - (b - a) / 3.0
        depth_p = _outline(family, theta, p)[0] - (rest[0] + (rest[1] + rest[2] * p) * p)
        depth_q = _outline(family, theta, q)[0] - (rest[0] + (rest[1] + rest[2] * q) * q)
        if depth_p < depth_q:
            a = p
        else:
            b = q
    start = 0.5 * (a + b)
    ends = np.full(2, start)
    kept = np.ones(2)
    for which in range(2):
        side = -1.0 if which == 0 else 1.0
        edge = left if which == 0 else right
        log_slope = theta[k - 3 + which]
        # The bent outline has its tip at the start: evaluate the flank next to the tip.
        near = start + side * 1e-9
        if side * (edge - near) <= 0.0:
            ends[which] = edge
            kept[which] = _kept(family, theta, which, edge)
            continue
        if _detached(family, theta, rest, near, side, log_slope, n, scale) > 0.0:
            ends[which] = start
            continue
        if _detached(family, theta, rest, edge, side, log_slope, n, scale) <= 0.0:
            ends[which] = edge
            kept[which] = _kept(family, theta, which, edge)
            continue
        inner, outer = near, edge
        for _ in range(45):
            middle = 0.5 * (inner + outer)
            if _detached(family, theta, rest, middle, side, log_slope, n, scale) > 0.0:
                outer = middle
            else:
                inner = middle
        ends[which] = 0.5 * (inner + outer)
    for i in range(len(u)):
        touched[i] = ends[0] <= u[i] <= ends[1]
        if touched[i]:
            depth = _outline(family, theta, u[i])[0]
            delta[i] = depth - (rest[0] + (rest[1] + rest[2] * u[i]) * u[i])
            continue
        which = 0 if u[i] < ends[0] else 1
        end = ends[which]
        height = _outline(family, theta, end)[0] - (rest[0] + (rest[1] + rest[2] * end) * end)
        full = height
        height *= kept[which]
        if height <= 0.0:
            delta[i] = 0.0
            continue
        slope = np.exp(theta[k - 3 + which]) * (height / scale) ** (0.5 * (n + 1.0))
        run = abs(u[i] - end) * slope / height
        base = 1.0 + 0.5 * (n - 1.0) * run
        delta[i] = height * base ** (2.0 / (1.0 - n)) if base > 0.0 else 0.0
        delta[i] += (full - height) * np.exp(-abs(u[i] - end) / EDGE_M)
    return ends[0], ends[1]


@kernel
def profile_and_jacobian(family, theta, steps, rest, scale, low, high, u, delta, touched, jacobian, ends):
    """Profile and its Jacobian with respect to ``theta`` (central differences with the given steps).

    Parameters
    ----------
    family, theta, rest, scale, low, high, u, delta, touched
        As in :func:`contact_profile`.
    steps
        Half step of each parameter, (p,); 0: not differentiated.
    jacobian
        Derivative of ``delta``, (K, p), filled.
    ends
        Ends of the contact [m], (2,), filled.
    """
    ends[0], ends[1] = contact_profile(family, theta, rest, scale, low, high, u, delta, touched)
    other = np.empty(len(u))
    flags = np.empty(len(u), dtype=np.bool_)
    moved = theta.copy()
    for j in range(len(theta)):
        if steps[j] == 0.0:
            for i in range(len(u)):
                jacobian[i, j] = 0.0
            continue
        moved[j] = theta[j] + steps[j]
        contact_profile(family, moved, rest, scale, low, high, u, other, flags)
        for i in range(len(u)):
            jacobian[i, j] = other[i]
        moved[j] = theta[j] - steps[j]
        contact_profile(family, moved, rest, scale, low, high, u, other, flags)
        for i in range(len(u)):
            jacobian[i, j] = (jacobian[i, j] - other[i]) / (2.0 * steps[j])
        moved[j] = theta[j]
