"""Memory of the foam: what a point that has turned round still presses with, on any path.

A foam gives back less than it took (Alt 2016, Sec. 3.2 and Fig. 3.2). The
dissertation measures only while the force rises. Here every point carries J stop
operators (Maxwell slip elements, Prandtl): xi_j follows the strain with slope
1 / e_j and slips at +1 and -1. From rest all are +1, the loading curve m; every
element that has turned takes its part away,

    stress = m(eps) - sum_j (r_j m(eps) + a_j) (1 - xi_j).

Large and small loops, reloading and ringing are all paths of the same law; it is
continuous everywhere, and a reloading meets the loading curve where it left it.
One loop cannot show whether its loss grows with the stress (r_j) or not (a_j):
both are identified together, and where the data do not decide the ridge shares
the loss out between them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from ....core.errors import InputError
from .stress_curve import StressCurve

__all__ = ["HysteresisLaw", "HysteresisState", "identify_hysteresis", "stop_path"]

#: A point below this strain has been released and forgets.
RELEASE_STRAIN = 0.005
#: Unloading is flagged when the strain is below its peak by this much, relative to the peak.
RELATIVE_DROP = 0.02
#: ... or by this many standard deviations of the difference, whichever is more.
DROP_SIGMAS = 4.0
#: Neighbours to both sides whose mean change a point takes part in: noise alone must not turn it.
NEIGHBOURS = 5
#: A point follows the mean change of its neighbourhood at once, and its own difference from it slowly:
#: by this part per frame where noise explains it, and wholly from the upper number of sigmas on.
OWN_GAIN, OWN_SIGMAS = 0.1, (3.0, 5.0)
#: The elements follow outside of a band of this many standard deviations of what is left of the noise.
PLAY_SIGMAS = 4.0
#: Number of elements, and the shortest of them.
ELEMENTS, SHORTEST_STRAIN = 10, 1e-3
#: Weight of the ridge against the rms of the design matrix.
RIDGE = 0.12
#: Error of the part taken away on paths that the calibration did not run, by that part: rms over
#: smaller and partial loops of Maxwell, dry-friction, pseudo-elastic and stop-operator foams.
FOREIGN_PATHS = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class HysteresisLaw:
    """J stop operators of one foam."""

    yield_strain: Float[np.ndarray, "J"]  #: e_j, rising; 2 e_j after a turn an element slips again
    fraction: Float[np.ndarray, "J"]  #: r_j, part of the loading stress
    stress_Pa: Float[np.ndarray, "J"]  #: a_j, part that does not depend on the strain
    relative_sigma: float = FOREIGN_PATHS  #: error of the part taken away, by that part

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
        """Part of the loading stress that is missing at every point, and its standard deviation [Pa].

        The first element stands for all that are faster than the steps of the
        calibration: half way through its turn they may be anywhere between
        half way and done.

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
    """What every point of one strip has been through since its last release; changed by ``update``."""

    peak_strain: Float[np.ndarray, "K"]  #: largest strain
    peak_sigma: Float[np.ndarray, "K"] = field(init=False)  #: standard deviation of that
    smooth: Float[np.ndarray, "K"] = field(init=False)  #: strain without most of its noise
    followed: Float[np.ndarray, "K"] = field(init=False)  #: strain that moves the elements
    xi: Float[np.ndarray, "K J"] | None = field(default=None, init=False)  #: elements, with a law

    def __post_init__(self) -> None:
        self.peak_sigma = np.zeros(len(self.peak_strain))
        self.smooth = self.peak_strain.copy()
        self.followed = self.peak_strain.copy()

    @classmethod
    def at_rest(cls, points: int) -> HysteresisState:
        """Memory of a strip of K points that nothing has touched yet.

        Parameters
        ----------
        points
            K, points along the strip.
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
        """Take one frame in; invalid points keep their memory.

        ``noise_sigma`` is the part of ``strain_sigma`` that changes from frame to frame, default all of it: the
        elements follow changes, and what is wrong by the same in every frame is none.

        The peak of a noisy signal creeps up by a few sigma while a contact rests;
        the margin below the peak is wider than that. For the same reason the
        elements move with the mean change of a point's neighbourhood, as a body
        moves it, and slowly with the point's own: a held contact must not creep
        down its branch by noise that goes to and fro.

        Parameters
        ----------
        strain, strain_sigma
            Strain of each point and its standard deviation.
        valid
            Points that were seen.
        law
            Elements of the foam; None: only the peak is followed.
        noise_sigma
            Part of ``strain_sigma`` that changes from frame to frame; all of it without.

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
        # What is hardly known is no peak: one frame of an edge that is none of the foam must not stay.
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
        # A triangle: a box lets differences of some wavelengths grow.
        window = NEIGHBOURS + 1.0 - np.abs(np.arange(-NEIGHBOURS, NEIGHBOURS + 1))

        def around(values: Float[np.ndarray, "K"], power: int = 1) -> Float[np.ndarray, "K"]:
            return np.convolve(values, window**power)[NEIGHBOURS:-NEIGHBOURS]

        whole = np.maximum(around(weight), 1e-100)
        common = around(weight * change) / whole
        low, high = OWN_SIGMAS
        unlike = np.abs(change - common) / np.maximum(sigma, 1e-12)
        own = np.minimum(sigma**2, around(pressed.astype(np.float64)) / whole)
        # A point of large uncertainty, at a kink, follows its own difference the more slowly: one outlier must not turn it.
        slow = OWN_GAIN * np.sqrt(own) / np.maximum(sigma, 1e-12)
        gain = slow + (1.0 - slow) * np.clip((unlike - low) / (high - low), 0.0, 1.0)
        step = common + gain * (change - common)
        self.smooth = self.smooth + np.where(pressed, step, change)
        # Noise that is left: of the mean, and of the slow filter; a point of large uncertainty is as calm as its neighbours.
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
    """States xi_j along a path that begins at rest; a released foam forgets.

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
    """Fit the elements to press records, whatever path they ran: full loops, smaller ones, reloading.

    Non-negative least squares with a ridge on what the loading curve has too much,
    over elements from half the first step after the turn to the largest strain.

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
    # Between absolute and relative errors: the low part of the branch counts, but not for everything.
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
    """The record as a path. Tables sorted by strain are none: loading up, then unloading down."""
    step = np.diff(strain)
    turned = direction[1:] != direction[:-1]
    against = (step * direction[1:] < 0) & ~turned
    # A new run begins anew: down after loading, up after unloading.
    if np.count_nonzero(against | (turned & (np.abs(step) < 1e-9))) <= 0.1 * len(step):
        return strain, stress
    up, down = np.flatnonzero(direction > 0), np.flatnonzero(direction < 0)
    order = np.concatenate(
        [up[np.argsort(strain[up], kind="stable")], down[np.argsort(-strain[down], kind="stable")]]
    )
    return strain[order], stress[order]
