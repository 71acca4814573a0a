"""Hysteresis of the foam: stress of a point on any path of loading and unloading.

The unloading stress of a foam is lower than the loading stress (Alt 2016, Sec. 3.2 and Fig. 3.2). The
dissertation measures only while the force increases. Here every point has J stop
operators (Maxwell slip elements, Prandtl): xi_j follows the strain with slope
1 / e_j and slips at +1 and -1. At rest all are +1, which is the loading curve m; every
element that has moved from +1 reduces the stress by its part,

    stress = m(eps) - sum_j (r_j m(eps) + a_j) (1 - xi_j).

Large and small loops, reloading and ringing are all paths of the same law; it is
continuous everywhere, and reloading returns to the loading curve where it left it.
A single loop does not determine whether its loss increases with the stress (r_j) or not (a_j):
both are identified together, and where the data are ambiguous the ridge distributes
the loss between them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from ....core.errors import InputError
from .stress_curve import StressCurve

#: A point below this strain is released, and its history is reset.
RELEASE_STRAIN = 0.005
#: Unloading is flagged when the strain is below its peak by this much, relative to the peak.
RELATIVE_DROP = 0.02
#: ... or by this many standard deviations of the difference, whichever is larger.
DROP_SIGMAS = 4.0
#: Neighbours to either side whose mean change a point follows, so that noise alone does not reverse it.
NEIGHBOURS = 5
#: A point follows the mean change of its neighbourhood immediately, and its own deviation from it slowly:
#: by this fraction per frame where noise explains it, and fully above the upper number of sigmas.
OWN_GAIN, OWN_SIGMAS = 0.1, (3.0, 5.0)
#: Half width of the dead band of the elements, in standard deviations of the remaining noise.
PLAY_SIGMAS = 4.0
#: Number of elements, and the smallest yield strain.
ELEMENTS, SHORTEST_STRAIN = 10, 1e-3
#: Weight of the ridge relative to the rms of the design matrix.
RIDGE = 0.12
#: Relative error of the stress reduction on paths that the calibration does not contain: rms over
#: smaller and partial loops of Maxwell, dry-friction, pseudo-elastic and stop-operator foams.
FOREIGN_PATHS = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class HysteresisLaw:
    """J stop operators of one foam."""

    yield_strain: Float[np.ndarray, "J"]  #: e_j, increasing; an element slips again 2 e_j after a reversal
    fraction: Float[np.ndarray, "J"]  #: r_j, fraction of the loading stress
    stress_Pa: Float[np.ndarray, "J"]  #: a_j, part that does not depend on the strain
    relative_sigma: float = FOREIGN_PATHS  #: relative error of the stress reduction

    def __post_init__(self) -> None:
        e, r, a = self.yield_strain, self.fraction, self.stress_Pa
        problems = []
        if not (e.ndim == 1 and len(e) >= 1 and e.shape == r.shape == a.shape):
            problems.append(f"found shapes {e.shape}, {r.shape}, {a.shape}, expected three equal ones")
        elif not (np.isfinite(e).all() and e[0] > 0 and bool(np.all(np.diff(e) > 0))):
            problems.append("yield_strain must be positive and rise")
        if not (np.isfinite(r).all() and np.isfinite(a).all() and min(r.min(), a.min()) >= 0):
            problems.append("fraction and stress_Pa must be >= 0")
        if not 0 <= self.relative_sigma <= 1:
            problems.append(f"relative_sigma is {self.relative_sigma}, expected 0 to 1")
        if problems:
            raise InputError("HysteresisLaw", "; ".join(problems), remedy="calibrate again")

    def reduction(
        self, loading_Pa: Float[np.ndarray, "K"], xi: Float[np.ndarray, "K J"]
    ) -> tuple[Float[np.ndarray, "K"], Float[np.ndarray, "K"]]:
        """Reduction of the loading stress at every point, and its standard deviation [Pa].

        The first element represents all that are faster than the steps of the
        calibration: when it has moved half way, these may be anywhere between
        half way and the end.

        Parameters
        ----------
        loading_Pa
            Stress of the loading curve at the strain of each point [Pa].
        xi
            States of the elements, -1 to 1.
        """
        turned = 1.0 - xi
        part = np.minimum(loading_Pa * (turned @ self.fraction) + turned @ self.stress_Pa, loading_Pa)
        fastest = 2.0 * (loading_Pa * self.fraction[0] + self.stress_Pa[0])
        way = 0.5 * turned[:, 0]
        unresolved = fastest * 4.0 * way * (1.0 - way) * 0.5 / np.sqrt(12.0)
        return part, np.hypot(self.relative_sigma * part, unresolved)


@dataclass(slots=True, eq=False)
class HysteresisState:
    """Strain history of every point of one strip since its last release; changed by ``update``."""

    peak_strain: Float[np.ndarray, "K"]  #: largest strain
    peak_sigma: Float[np.ndarray, "K"] = field(init=False)  #: its standard deviation
    smooth: Float[np.ndarray, "K"] = field(init=False)  #: strain without most of its noise
    followed: Float[np.ndarray, "K"] = field(init=False)  #: strain that moves the elements
    xi: Float[np.ndarray, "K J"] | None = field(default=None, init=False)  #: elements, with a law

    def __post_init__(self) -> None:
        self.peak_sigma = np.zeros(len(self.peak_strain))
        self.smooth = self.peak_strain.copy()
        self.followed = self.peak_strain.copy()

    @classmethod
    def at_rest(cls, points: int) -> HysteresisState:
        """State of an untouched strip of K points.

        Parameters
        ----------
        points
            K, number of points along the strip.
        """
        return cls(np.zeros(points))

    def update(
        self,
        strain: Float[np.ndarray, "K"],
        strain_sigma: Float[np.ndarray, "K"],
        valid: Bool[np.ndarray, "K"],
        law: HysteresisLaw | None = None,
        *,
        noise_sigma: Float[np.ndarray, "K"] | None = None,
    ) -> Bool[np.ndarray, "K"]:
        """Process one frame; the state of invalid points does not change.

        ``noise_sigma`` is the part of ``strain_sigma`` that varies from frame to frame, by default all of it: the
        elements follow changes, to which a constant error does not contribute.

        The peak of a noisy signal increases by a few sigma during a static contact;
        the margin below the peak is wider than that. For the same reason the
        elements follow the mean change of the neighbourhood of a point, which a body
        moves as a whole, and only slowly the deviation of the point itself: alternating noise
        does not let a static contact creep down its unloading branch.

        Parameters
        ----------
        strain, strain_sigma
            Strain of each point and its standard deviation.
        valid
            Points that were observed.
        law
            Elements of the foam; None: only the peak is updated.
        noise_sigma
            Part of ``strain_sigma`` that varies from frame to frame; None: all of it.

        Returns
        -------
        ndarray of bool, shape (K,)
            Points that are unloading.
        """
        if strain.shape != self.peak_strain.shape:
            raise InputError(
                "memory",
                f"has {len(self.peak_strain)} points, the contour has {len(strain)}",
                remedy="start a new HysteresisState with the strip",
            )
        released = valid & (strain < np.maximum(RELEASE_STRAIN, 3 * strain_sigma))
        self.peak_strain[released], self.peak_sigma[released] = 0.0, 0.0
        # An uncertain strain is not a peak, so that a single frame with a wrong edge has no lasting effect.
        sure = self.peak_strain - DROP_SIGMAS * self.peak_sigma
        rising = valid & ~released & (strain - DROP_SIGMAS * strain_sigma > sure)
        self.peak_strain[rising], self.peak_sigma[rising] = strain[rising], strain_sigma[rising]
        if law is not None:
            self._move(strain, strain_sigma if noise_sigma is None else noise_sigma, valid, released, law)
        margin = np.maximum(
            RELATIVE_DROP * self.peak_strain, DROP_SIGMAS * np.hypot(self.peak_sigma, strain_sigma)
        )
        unloading: Bool[np.ndarray, "K"] = valid & ~released & (strain < self.peak_strain - margin)
        return unloading

    def _move(
        self,
        strain: Float[np.ndarray, "K"],
        sigma: Float[np.ndarray, "K"],
        valid: Bool[np.ndarray, "K"],
        released: Bool[np.ndarray, "K"],
        law: HysteresisLaw,
    ) -> None:
        if self.xi is None or self.xi.shape[1] != len(law.yield_strain):
            self.xi = np.ones((len(strain), len(law.yield_strain)))
            self.smooth = np.zeros(len(strain))
            self.followed = np.zeros(len(strain))
        change = np.where(valid, strain - self.smooth, 0.0)
        pressed = valid & ~released
        weight = np.where(pressed, 1.0 / np.maximum(sigma, 1e-9) ** 2, 0.0)
        # A triangular window: with a box, differences of some wavelengths would grow.
        window = NEIGHBOURS + 1.0 - np.abs(np.arange(-NEIGHBOURS, NEIGHBOURS + 1))

        def around(values: Float[np.ndarray, "K"], power: int = 1) -> Float[np.ndarray, "K"]:
            return np.convolve(values, window**power)[NEIGHBOURS:-NEIGHBOURS]

        whole = np.maximum(around(weight), 1e-100)
        common = around(weight * change) / whole
        low, high = OWN_SIGMAS
        unlike = np.abs(change - common) / np.maximum(sigma, 1e-12)
        own = np.minimum(sigma**2, around(pressed.astype(np.float64)) / whole)
        # The larger the uncertainty of a point, as at a kink, the more slowly it follows its own deviation (outliers).
        slow = OWN_GAIN * np.sqrt(own) / np.maximum(sigma, 1e-12)
        gain = slow + (1.0 - slow) * np.clip((unlike - low) / (high - low), 0.0, 1.0)
        step = common + gain * (change - common)
        self.smooth = self.smooth + np.where(pressed, step, change)
        # Remaining noise of the mean and of the slow filter; that of an uncertain point is limited to that of its neighbours.
        left = around(weight, 2) / whole**2 + OWN_GAIN / (2.0 - OWN_GAIN) * own
        play = PLAY_SIGMAS * np.minimum(np.sqrt(left), sigma)
        ahead = self.smooth - self.followed
        move = np.where(pressed, np.sign(ahead) * np.maximum(np.abs(ahead) - play, 0.0), ahead)
        self.xi = np.clip(self.xi + move[:, None] / law.yield_strain, -1.0, 1.0)
        self.xi[released] = 1.0
        self.followed = self.followed + move


def stop_path(
    strain: Float[np.ndarray, "n"], yield_strain: Float[np.ndarray, "J"]
) -> Float[np.ndarray, "n J"]:
    """States xi_j along a path that begins at rest; they are reset when the foam is released.

    Parameters
    ----------
    strain
        Strains of the path, in order.
    yield_strain
        e_j of the elements.

    Returns
    -------
    ndarray, shape (n, J)
        xi_j after each step.
    """
    xi, state, before = np.ones((len(strain), len(yield_strain))), np.ones(len(yield_strain)), 0.0
    for i, now in enumerate(strain):
        state = np.clip(state + (now - before) / yield_strain, -1.0, 1.0)
        if now < RELEASE_STRAIN:
            state = np.ones(len(yield_strain))
        xi[i], before = state, now
    return xi


def identify_hysteresis(
    strain: Float[np.ndarray, "n"],
    stress_Pa: Float[np.ndarray, "n"],
    direction: Int[np.ndarray, "n"],
    loading: StressCurve,
) -> HysteresisLaw:
    """Fit the elements to press records of any path: full loops, smaller ones, reloading.

    Non-negative least squares with a ridge on the excess of the loading curve,
    over elements from half the first step after the reversal to the largest strain.

    Parameters
    ----------
    strain, stress_Pa
        Points in the order of measurement.
    direction
        +1 loading, -1 unloading; -1 must occur.
    loading
        Fitted loading curve.
    """
    from scipy.optimize import nnls

    path, stress = _as_run(strain, stress_Pa, direction)
    peak = float(path.max())
    turns = np.flatnonzero(np.diff(path, prepend=0.0) < 0)
    first = turns[np.diff(turns, prepend=-2) > 1]
    steps = [float(path[i - 1] - path[i]) for i in first if i > 0 and path[i] > RELEASE_STRAIN]
    shortest = max(0.5 * float(np.median(steps)), SHORTEST_STRAIN) if steps else SHORTEST_STRAIN
    yields = np.geomspace(min(shortest, 0.1 * peak), peak, ELEMENTS)
    turned = 1.0 - stop_path(path, yields)
    m, top = loading.stress(path), float(loading.stress(np.array(peak)))
    turned_far = (turned.max(axis=1) > 0) & (path > 0.02)
    design = np.hstack([turned * m[:, None], turned * top])[turned_far]
    missing = (m - stress)[turned_far]
    # Compromise between absolute and relative errors: the low part of the branch matters, but does not dominate.
    weight = 1.0 / (0.1 * top + m[turned_far])
    weighted = design * weight[:, None]
    ridge = RIDGE * float(np.sqrt(np.mean(weighted**2) * len(missing)))
    size = design.shape[1]
    found, _ = nnls(
        np.vstack([weighted, ridge * np.eye(size)]), np.concatenate([missing * weight, np.zeros(size)])
    )
    part = design @ found
    left = float(np.sqrt(np.mean((part - missing) ** 2)))
    relative = left / max(float(np.sqrt(np.mean(part**2))), 1e-9)
    return HysteresisLaw(
        yields, found[:ELEMENTS], found[ELEMENTS:] * top, min(float(np.hypot(FOREIGN_PATHS, relative)), 1.0)
    )


def _as_run(
    strain: Float[np.ndarray, "n"], stress: Float[np.ndarray, "n"], direction: Int[np.ndarray, "n"]
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """The record as a path; tables sorted by strain are reordered: loading upwards, then unloading downwards."""
    step = np.diff(strain)
    turned = direction[1:] != direction[:-1]
    against = (step * direction[1:] < 0) & ~turned
    # A change of direction may also start a new run: down after loading, up after unloading.
    if np.count_nonzero(against | (turned & (np.abs(step) < 1e-9))) <= 0.1 * len(step):
        return strain, stress
    up, down = np.flatnonzero(direction > 0), np.flatnonzero(direction < 0)
    order = np.concatenate(
        [up[np.argsort(strain[up], kind="stable")], down[np.argsort(-strain[down], kind="stable")]]
    )
    return strain[order], stress[order]
