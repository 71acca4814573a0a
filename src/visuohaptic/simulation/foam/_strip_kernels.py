"""Kernels of the foam strip: penetration depth of bodies, and equilibrium of the columns."""

from __future__ import annotations

import numba as nb
import numpy as np
from jaxtyping import Float, Int

from ...core.kernels import kernel

#: Rays of columns start this many widths behind the back contour.
BEHIND = 3.0


@kernel
def penetration(
    base: Float[np.ndarray, "k 2"],
    normal: Float[np.ndarray, "k 2"],
    width: float,
    vertices: Float[np.ndarray, "m 2"],
    starts: Int[np.ndarray, "b1"],
    radii: Float[np.ndarray, "b"],
    depth: Float[np.ndarray, "k"],
    owner: Int[np.ndarray, "k"],
) -> None:
    """Depth to which rounded polygons penetrate below the undeformed front, per column.

    A body is a convex or concave polygon grown by a disc; a single vertex is a
    disc. The ray of a column starts ``BEHIND`` widths behind the back, inside
    the robot, and runs along ``normal``; the first crossing counts. A wall on
    the robot's other side is not touched by the strip.

    Parameters
    ----------
    base, normal
        Back contour and outward unit normals, (k, 2).
    width
        w [m].
    vertices, starts, radii
        All vertices (m, 2) counter-clockwise, first index of every body (b + 1), radius (b).
    depth, owner
        Results (k): depth [m], -1 where nothing is close; index of the body.
    """
    none = -1.0
    for i in range(base.shape[0]):
        depth[i] = none
        owner[i] = -1
        nx, ny = normal[i, 0], normal[i, 1]
        for body in range(len(radii)):
            first, end = starts[body], starts[body + 1]
            r = radii[body]
            nearest = 1e9
            for v in range(first, end):
                px, py = vertices[v, 0] - base[i, 0], vertices[v, 1] - base[i, 1]
                along, across = px * nx + py * ny, nx * py - ny * px
                if abs(across) <= r + 1e-9:
                    along -= np.sqrt(max(r * r - across * across, 0.0))
                    if along > -BEHIND * width:
                        nearest = min(nearest, along)
                if end - first < 2:
                    continue
                u = v + 1 if v + 1 < end else first
                ex, ey = vertices[u, 0] - vertices[v, 0], vertices[u, 1] - vertices[v, 1]
                length = np.sqrt(ex * ex + ey * ey)
                if length < 1e-12:
                    continue
                # Offset to the right of a counter-clockwise edge: outwards.
                ox, oy = px + r * ey / length, py - r * ex / length
                cross = nx * ey - ny * ex
                if abs(cross) < 1e-12 * length:
                    continue
                part = -(nx * oy - ny * ox) / cross
                if 0.0 <= part <= 1.0:
                    along = (ox + part * ex) * nx + (oy + part * ey) * ny
                    if along > -BEHIND * width:
                        nearest = min(nearest, along)
            if nearest < 1e8 and width - nearest > depth[i]:
                depth[i] = width - nearest
                owner[i] = body


@kernel
def solve_strip(
    memory: Float[np.ndarray, "k0 fields"],
    at: Float[np.ndarray, "k"],
    u: Float[np.ndarray, "k n"],
    limit: Float[np.ndarray, "k"],
    cell: Float[np.ndarray, "k n"],
    gap: Float[np.ndarray, "k1 n"],
    thickness: Float[np.ndarray, "n"],
    height: float,
    table_start: float,
    table_step: float,
    tables: Float[np.ndarray, "3 t"],
    losses: Float[np.ndarray, "2 j"],
    relaxation: float,
    relaxation_strain: float,
    decay: float,
    shear_limit: float,
    iterations: int,
    free_strain: float,
    reaction: Float[np.ndarray, "k"],
) -> tuple[int, float]:
    """Equilibrium of K columns of N layers against a rigid outline (active set and Newton steps), and its hysteresis.

    The unknowns are the displacements towards the base of the layers' front
    faces. Energy of a layer of a column: that of :class:`StripLaw`; energy of
    its tie to the next column: shear, from the mean square slope of its two
    faces. The front faces obey u >= limit with a reaction >= 0 where equal.

    Parameters
    ----------
    memory
        (k0, 3 n + n j + 1) of the strip's regular columns: displacements [m], strains, chi (n each), xi (n j), touched;
        those of this step are changed.
    at
        (k,) columns of this step as indices of regular ones, between two of them when not whole.
    u
        (k, n) result [m].
    limit
        (k,) smallest displacement of the front [m].
    cell, gap
        (k, n) length of a column along s, (k - 1, n) distance to the next one [m].
    thickness
        (n,) of the layers [m].
    height
        Height of the strip across the sensor plane [m].
    table_start, table_step
        First strain and step of the tables.
    tables
        Stress [Pa], shear modulus [Pa] and its slope by strain [Pa], at the strains of the tables (3, t).
    losses
        Hysteresis elements: relative stress and scale of the strain (2, j).
    relaxation, relaxation_strain, decay
        Relaxation: relative stress, scale of the strain, and decay over the step.
    shear_limit
        Parameter g0 of the shear energy.
    iterations
        Maximum number of Newton steps.
    free_strain
        Strain up to which a layer has left the body, and its hysteresis ends.
    reaction
        (k,) result: force of the body on the column [N].

    Returns
    -------
    (iterations used, last step [m])
    """
    K, N = u.shape
    count = K * N
    band = N + 1
    J = losses.shape[1]
    last = tables.shape[1] - 2
    stress_table, shear_table, shear_slope_table = tables[0], tables[1], tables[2]
    loss, loss_strain = losses[0], losses[1]
    gradient = np.zeros(count)
    matrix = np.zeros((count, band + 1))
    active = np.zeros(K, nb.boolean)
    strain, strain_before, relaxing = np.zeros((K, N)), np.zeros((K, N)), np.zeros((K, N))
    state, touched = np.zeros((K, N, J)), np.zeros(K, nb.boolean)
    for i in range(K):
        low = min(int(at[i]), len(memory) - 2)
        before, after, part = memory[low], memory[low + 1], at[i] - low
        for m in range(N):
            u[i, m] = before[m] * (1.0 - part) + after[m] * part
            strain_before[i, m] = before[N + m] * (1.0 - part) + after[N + m] * part
            relaxing[i, m] = before[2 * N + m] * (1.0 - part) + after[2 * N + m] * part
            for j in range(J):
                field = 3 * N + m * J + j
                state[i, m, j] = before[field] * (1.0 - part) + after[field] * part
        touched[i] = before[-1] * (1.0 - part) + after[-1] * part > 0.5
    for i in range(K):
        active[i] = limit[i] >= u[i, N - 1] or (touched[i] and limit[i] > 0.0)
    released = np.zeros(K, nb.int64)
    step = 0.0
    for i in range(K):
        if active[i] or touched[i]:
            step = max(step, abs(max(limit[i], 0.0) - u[i, N - 1]))
    used = 0
    for iteration in range(iterations):
        used = iteration + 1
        gradient[:] = 0.0
        matrix[:] = 0.0
        for i in range(K):
            for m in range(N):
                e = (u[i, m] - (u[i, m - 1] if m > 0 else 0.0)) / thickness[m]
                strain[i, m] = e
                x = (e - table_start) / table_step
                k = min(max(int(x), 0), last)
                tangent = (stress_table[k + 1] - stress_table[k]) / table_step
                stress = stress_table[k] + (x - k) * (stress_table[k + 1] - stress_table[k])
                if e > 0.0:
                    factor, slope = 1.0, 0.0
                    change = e - strain_before[i, m]
                    for j in range(J):
                        xi = state[i, m, j] + change / loss_strain[j]
                        if xi >= 1.0:
                            continue
                        if xi > -1.0:
                            slope += loss[j] / loss_strain[j]
                        else:
                            xi = -1.0
                        factor -= loss[j] * (1.0 - xi)
                    if relaxation > 0.0:
                        chi = (relaxing[i, m] + change / relaxation_strain) * decay
                        factor += relaxation * chi
                        slope += relaxation * decay / relaxation_strain
                    tangent = tangent * factor + stress * slope
                    stress *= factor
                force = stress * height * cell[i, m]
                stiffness = tangent * height * cell[i, m] / thickness[m]
                p = i * N + m
                gradient[p] += force
                matrix[p, 0] += stiffness
                if m > 0:
                    gradient[p - 1] -= force
                    matrix[p - 1, 0] += stiffness
                    matrix[p - 1, 1] -= stiffness
        # Far from the solution the curvature of a majoriser is used, near it the true one.
        near = 1.0 if step < 0.03 * thickness[0] else 0.0
        for i in range(K - 1):
            for m in range(N):
                d = gap[i, m]
                b = (u[i + 1, m] - u[i, m]) / d
                a = (u[i + 1, m - 1] - u[i, m - 1]) / d if m > 0 else 0.0
                square = (a * a + a * b + b * b) / 3.0
                x = (0.5 * (strain[i, m] + strain[i + 1, m]) - table_start) / table_step
                k = min(max(int(x), 0), last)
                shear = shear_table[k] + (x - k) * (shear_table[k + 1] - shear_table[k])
                # Its own table: a slope that jumps at every entry would prevent Newton's method from converging.
                rise = shear_slope_table[k] + (x - k) * (shear_slope_table[k + 1] - shear_slope_table[k])
                root = np.sqrt(1.0 + square / shear_limit**2)
                volume = height * thickness[m] * d
                weight = volume * shear * 0.5 / root / d
                da, db = (2.0 * a + b) / 3.0, (a + 2.0 * b) / 3.0
                bend = -near * volume * shear * 0.25 / (root**3 * shear_limit**2) / (d * d)
                kbb = weight / d * (2.0 / 3.0) + bend * db * db
                kaa = weight / d * (2.0 / 3.0) + bend * da * da
                kab = weight / d / 3.0 + bend * da * db
                p, q = i * N + m, (i + 1) * N + m
                # Change of the modulus with compression.
                swell = volume * rise * shear_limit**2 * (root - 1.0) * 0.5 / thickness[m]
                gradient[p] += swell - weight * db
                gradient[q] += swell + weight * db
                mix = near * volume * rise * 0.25 / (root * d * thickness[m])
                matrix[p, 0] += kbb - 2.0 * mix * db
                matrix[q, 0] += kbb + 2.0 * mix * db
                matrix[p, N] -= kbb
                if m > 0:
                    gradient[p - 1] -= swell + weight * da
                    gradient[q - 1] += weight * da - swell
                    matrix[p - 1, 0] += kaa + 2.0 * mix * da
                    matrix[q - 1, 0] += kaa - 2.0 * mix * da
                    matrix[p - 1, N] -= kaa
                    matrix[p - 1, 1] += kab + mix * (db - da)
                    matrix[q - 1, 1] += kab - mix * (db - da)
                    matrix[p - 1, N + 1] -= kab + mix * (da + db)
                    matrix[p, N - 1] += mix * (da + db) - kab
        changed = False
        for i in range(K):
            p = i * N + N - 1
            reaction[i] = 0.0
            if active[i]:
                # A column that was released several times stays in contact: two neighbours may alternate endlessly.
                if gradient[p] < 0.0 and released[i] < 4:
                    active[i] = False
                    released[i] += 1
                    changed = True
                else:
                    reaction[i] = max(gradient[p], 0.0)
            elif u[i, N - 1] < limit[i]:
                active[i] = True
                changed = True
        if iteration > 0 and step < 2e-8 and not changed:
            break
        for i in range(K):
            p = i * N + N - 1
            if active[i]:
                # The step of this unknown is prescribed: move its column to the right-hand side.
                given = u[i, N - 1] - limit[i]
                for m in range(1, band + 1):
                    if p + m < count:
                        gradient[p + m] -= matrix[p, m] * given
                    matrix[p, m] = 0.0
                    if p >= m:
                        gradient[p - m] -= matrix[p - m, m] * given
                        matrix[p - m, m] = 0.0
                matrix[p, 0] = 1.0
                gradient[p] = given
        for p in range(count):
            pivot = matrix[p, 0]
            if not pivot > 1e-9:  # not convex here: take a short step along this unknown instead
                matrix[p, 0] = pivot = 1e6
            for m in range(1, min(band, count - 1 - p) + 1):
                v = matrix[p, m] / pivot
                if v != 0.0:
                    for r in range(m, band + 1):
                        matrix[p + m, r - m] -= v * matrix[p, r]
                    gradient[p + m] -= v * gradient[p]
        step = 0.0
        for p in range(count - 1, -1, -1):
            v = gradient[p]
            for m in range(1, min(band, count - 1 - p) + 1):
                v -= matrix[p, m] * gradient[p + m]
            gradient[p] = v / matrix[p, 0]
            step = max(step, abs(gradient[p]))
        scale = 1.0 if step < 0.3 * thickness[0] else 0.3 * thickness[0] / step
        for p in range(count):
            u[p // N, p % N] -= scale * gradient[p]
    for i in range(K):
        if at[i] != int(at[i]):
            continue
        row = memory[int(at[i])]
        for m in range(N):
            row[m] = u[i, m]
            row[N + m] = (u[i, m] - (u[i, m - 1] if m > 0 else 0.0)) / thickness[m]
            change, free = row[N + m] - strain_before[i, m], row[N + m] <= free_strain
            row[2 * N + m] = 0.0 if free else (relaxing[i, m] + change / relaxation_strain) * decay
            for j in range(J):
                xi = min(max(state[i, m, j] + change / loss_strain[j], -1.0), 1.0)
                row[3 * N + m * J + j] = 1.0 if free else xi
        row[-1] = 1.0 if reaction[i] > 0.0 else 0.0
    return used, step
