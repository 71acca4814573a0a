"""The simulated foam strip: columns that are compressed by rigid outlines and coupled by shear."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ._strip_kernels import penetration, solve_strip
from .outline import Outline
from .strip_geometry import FoamStripGeometry
from .strip_law import FREE_STRAIN, SOFT_FOAM, TABLE_END, TABLE_SIZE, TABLE_START, StripLaw


@dataclass(frozen=True, slots=True, eq=False)
class StripState:
    """Equilibrium of the strip with the bodies; all in frame F."""

    s_m: Float[np.ndarray, "k"]  #: columns along the back contour
    delta_m: Float[np.ndarray, "k"]  #: deflection of the front towards the base
    pressure_Pa: Float[np.ndarray, "k"]  #: contact force by undeformed front area
    front_m: Float[np.ndarray, "k 2"]  #: front contour
    body: Int[np.ndarray, "k"]  #: index of the touching body, -1 if none
    load_N: float  #: integral of the pressure over the front: the F of Eq. (3.1)
    #: of the foam on all bodies; its length is ``load_N`` on a straight strip
    force_N: Float[np.ndarray, "2"]
    moment_Nm: float  #: of the foam on all bodies about the origin of F
    body_force_N: Float[np.ndarray, "b 2"]  #: on every body
    body_moment_Nm: Float[np.ndarray, "b"]  #: on every body about the origin of F

    @property
    def touching(self) -> Bool[np.ndarray, "k"]:
        """Columns with contact pressure."""
        return self.pressure_Pa > 0.0

    def centre_m(self, body: int) -> float:
        """Position along s at which the contact force of a body acts [m]; NaN without contact.

        Parameters
        ----------
        body
            Index of the body.
        """
        weight = np.where(self.body == body, self.pressure_Pa, 0.0)
        total = float(weight.sum())
        return float(weight @ self.s_m / total) if total > 0 else math.nan


class FoamStrip:
    """A strip with hysteresis; :meth:`press` moves bodies against it.

    Forces act along the columns' normals only: shear along the mounting curve
    is negligible (Alt 2016, Sec. 3.3).

    Parameters
    ----------
    geometry
        Size and spacing; the standard strip by default.
    law
        Material law of the foam.

    Examples
    --------
    >>> strip = FoamStrip(FoamStripGeometry(spacing_m=0.001), SOFT_FOAM)
    >>> wall = Outline.box((0.02 + 0.05 - 0.004, 0.0), (0.1, 0.6))
    >>> state = strip.press([wall])
    >>> round(float(state.force_N[0]) / (0.25 * 0.01 * float(SOFT_FOAM.uniaxial([0.2])[0])), 3)
    1.0
    """

    def __init__(self, geometry: FoamStripGeometry | None = None, law: StripLaw = SOFT_FOAM) -> None:
        self.geometry = geometry if geometry is not None else FoamStripGeometry()
        self.law = law
        self.s_m = self.geometry.positions_m()
        self._stress, shear = law.tables()
        slope = np.gradient(shear, (TABLE_END - TABLE_START) / (TABLE_SIZE - 1))
        self._tables = np.stack([self._stress, shear, slope])
        self._losses = np.array([law.loss, law.loss_strain], dtype=np.float64)
        self._thickness = np.asarray(law.layers) * self.geometry.width_m
        middle = np.cumsum(self._thickness) - 0.5 * self._thickness
        self._stretch = np.array([[self.geometry.stretch(float(y)) for y in middle]])
        self._back, self._normal = self.geometry.back_m(self.s_m), self.geometry.normals(self.s_m)
        front_m = (self.s_m[1] - self.s_m[0]) * self.geometry.stretch(self.geometry.width_m)
        self._area_m2 = np.full(len(self.s_m), front_m * self.geometry.height_m)
        self._area_m2[[0, -1]] *= 0.5
        self.reset()

    def reset(self) -> None:
        """Reset to the undeformed state: no deflection and no memory."""
        k, n, j = len(self.s_m), len(self._thickness), self._losses.shape[1]
        # One row per column: displacements, strains, chi (n each), xi (n j), touched (1).
        self._undeformed = np.zeros((k, 3 * n + n * j + 1))
        self._undeformed[:, 3 * n : -1] = 1.0
        self._memory = self._undeformed.copy()
        #: Displacement of the front, and length along the strip, of the columns that touched in the last step [m].
        self._pressed = np.zeros(0), np.zeros(0)

    def inner_m(self, height_m: float) -> Float[np.ndarray, "k 2"]:
        """Present position of a material line of the foam, frame F [m].

        Parameters
        ----------
        height_m
            Height of the line above the back in the undeformed strip [m].
        """
        layers = np.concatenate([[0.0], np.cumsum(self._thickness)])
        upper = int(np.clip(np.searchsorted(layers, height_m), 1, len(self._thickness)))
        fraction = (height_m - layers[upper - 1]) / (layers[upper] - layers[upper - 1])
        above = self._memory[:, upper - 1]
        below = self._memory[:, upper - 2] if upper > 1 else np.zeros(len(self.s_m))
        moved = below + fraction * (above - below)
        return self._back + self._normal * (height_m - moved[:, None])

    def press(self, bodies: Sequence[Outline], dt_s: float = 0.0) -> StripState:
        """Find the equilibrium with bodies at new positions and update the hysteresis.

        Parameters
        ----------
        bodies
            Outlines in frame F. A move by more than about 1 mm is treated as one
            step: use small moves where the order of loading matters.
        dt_s
            Time since the last call; affects only relaxation.
        """
        geometry, law, w, n = self.geometry, self.law, self.geometry.width_m, len(self._thickness)
        vertices, starts, radii = _flat(bodies)
        window = self._window(vertices, np.repeat(radii, np.diff(starts)))
        if window is None:
            return self._free(len(bodies))
        at = self._columns(vertices, starts, radii, *window)
        s = self.s_m[0] + at * (self.s_m[1] - self.s_m[0])
        normal = geometry.normals(s)
        depth, owner = np.empty(len(s)), np.empty(len(s), dtype=np.int64)
        back = geometry.back_m(s)
        penetration(back, normal, w, vertices, starts, radii, depth, owner)
        if not (depth > 0.0).any() and np.array_equal(self._memory, self._undeformed):
            return self._free(len(bodies))

        distance = np.diff(s)
        cell = np.zeros(len(s))
        cell[1:] += 0.5 * distance
        cell[:-1] += 0.5 * distance
        decay = math.exp(-dt_s / law.relaxation_time_s)
        u, reaction = np.zeros((len(s), n)), np.zeros(len(s))
        solve_strip(
            self._memory, at, u, np.minimum(depth, 0.97 * TABLE_END * w), cell[:, None] * self._stretch,
            distance[:, None] * self._stretch, self._thickness, geometry.height_m,
            TABLE_START, (TABLE_END - TABLE_START) / (TABLE_SIZE - 1),
            self._tables, self._losses,
            law.relaxation, law.relaxation_strain, decay, law.shear_limit,
            60, FREE_STRAIN, reaction,
        )  # fmt: skip
        touching = reaction > 0
        self._pressed = u[touching, -1], cell[touching]
        front = back + normal * (w - u[:, -1:])
        return self._result(
            front, reaction, np.where(touching, owner, -1), at, len(bodies), reaction[:, None] * normal
        )

    def _window(
        self, vertices: Float[np.ndarray, "m 2"], radius: Float[np.ndarray, "m"]
    ) -> tuple[int, int] | None:
        """First and last regular column that can move; free ones far from any contact stay at rest."""
        moved = np.flatnonzero(np.abs(self._memory[:, len(self._thickness) - 1]) > 1e-8)
        spacing, margin = self.s_m[1] - self.s_m[0], 3.0 * self.geometry.width_m
        low, high = (self.s_m[moved[0]], self.s_m[moved[-1]]) if len(moved) else (math.inf, -math.inf)
        if len(vertices):
            place = self.geometry.position_of(vertices)
            low, high = min(low, float((place - radius).min())), max(high, float((place + radius).max()))
        if low > high:
            return None
        first = max(0, math.floor((low - margin - self.s_m[0]) / spacing))
        last = min(len(self.s_m) - 1, math.ceil((high + margin - self.s_m[0]) / spacing))
        return (first, last) if last - first >= 2 else None

    def _columns(
        self, vertices: Float[np.ndarray, "m 2"], starts: Int[np.ndarray, "b1"],
        radii: Float[np.ndarray, "b"], first: int, last: int,
    ) -> Float[np.ndarray, "k"]:  # fmt: skip
        """Columns of this step as (fractional) indices: the regular ones and more at the bodies' corners.

        Without the extra columns the force would jump by a whole column when a
        corner slides along the strip.
        """
        regular = np.arange(first, last + 1, dtype=np.float64)
        if not len(vertices):
            return regular
        count = np.diff(starts)
        radius, corner = np.repeat(radii, count), np.repeat(count > 1, count)
        place = self.geometry.position_of(vertices)[corner]
        reach = 0.7 * radius[corner]
        spacing = self.s_m[1] - self.s_m[0]
        index = np.unique((np.concatenate([place, place - reach, place + reach]) - self.s_m[0]) / spacing)
        index = index[(index > first) & (index < last) & (np.abs(index - np.round(index)) > 0.02)]
        index = index[np.diff(index, prepend=-1.0) > 0.02]
        return np.sort(np.concatenate([regular, index]))

    def stiffness_N_per_m(self) -> float:
        """Upper bound of d force / d depth of all columns that touched in the last step: every hysteresis element sticks."""
        delta, cell = self._pressed
        strain = np.clip(delta / self.geometry.width_m, 0.0, 0.9)
        x = (strain - TABLE_START) / (TABLE_END - TABLE_START) * (TABLE_SIZE - 1)
        low = x.astype(np.int64)
        stress = self._stress[low]
        slope = (self._stress[low + 1] - stress) / (TABLE_END - TABLE_START) * (TABLE_SIZE - 1)
        gain = slope + stress * float(np.sum(self._losses[0] / self._losses[1]))
        return float(gain @ cell) * self.geometry.height_m / self.geometry.width_m

    def _free(self, bodies: int) -> StripState:
        """State without any contact."""
        none, points = np.zeros(0), np.zeros((0, 2))
        self._pressed = none, none
        return self._result(points, none, none.astype(np.int64), none, bodies, points)

    def _result(
        self, front: Float[np.ndarray, "q 2"], reaction: Float[np.ndarray, "q"], who: Int[np.ndarray, "q"],
        at: Float[np.ndarray, "q"], bodies: int, force: Float[np.ndarray, "q 2"],
    ) -> StripState:  # fmt: skip
        """Forces from the reactions; profiles on the regular columns."""
        k = len(self.s_m)
        moment = front[:, 0] * force[:, 1] - front[:, 1] * force[:, 0]
        parts = [
            np.bincount(who + 1, weights=x, minlength=bodies + 1)[1:]
            for x in (force[:, 0], force[:, 1], moment)
        ]
        # The load of an extra column is assigned to its regular neighbours, so that the profile preserves the force.
        low = np.floor(at).astype(np.int64)
        fraction = at - low
        load = np.bincount(low, weights=reaction * (1 - fraction), minlength=k)
        load = load + np.bincount(np.minimum(low + 1, k - 1), weights=reaction * fraction, minlength=k)
        body = np.full(k, -1)
        body[low[fraction == 0]] = who[fraction == 0]
        delta = self._memory[:, len(self._thickness) - 1].copy()
        return StripState(
            s_m=self.s_m,
            delta_m=delta,
            pressure_Pa=load / self._area_m2,
            front_m=self._back + self._normal * (self.geometry.width_m - delta[:, None]),
            body=body,
            load_N=float(reaction.sum()),
            force_N=force.sum(axis=0),
            moment_Nm=float(moment.sum()),
            body_force_N=np.column_stack(parts[:2]),
            body_moment_Nm=parts[2],
        )


def _flat(
    bodies: Sequence[Outline],
) -> tuple[Float[np.ndarray, "m 2"], Int[np.ndarray, "b1"], Float[np.ndarray, "b"]]:
    """All vertices in one array, in the kernel's format."""
    starts = np.cumsum([0, *(len(body.vertices_m) for body in bodies)]).astype(np.int64)
    vertices = [np.asarray(body.vertices_m, dtype=np.float64) for body in bodies]
    flat = np.ascontiguousarray(np.concatenate(vertices)) if bodies else np.zeros((0, 2))
    return flat, starts, np.array([float(body.radius_m) for body in bodies])
