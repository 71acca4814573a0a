"""Force that an image alone does not prove: of a contact that is too new, and beside a dent in one.

What hangs before the foam and comes in as slowly as a push, from one contact to the next or to the end
of the strip, looks like a wide body; what is as grey as foam and lies over a contact looks like a
dent in the body. Neither can be distinguished from a real contact in one frame. So their force is
no reason to refuse the frame, but it carries an uncertainty until later frames agree.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ....core.errors import InputError
from ....core.measurement import ErrorBudget
from ..material.foam_material import FoamMaterial
from ..profile import FoamReading

__all__ = ["NewContact", "unverified_force", "with_unverified", "without_dents"]

#: Standard deviation of the unverified force, by itself: all of it may be wrong, which then is four sigmas.
_OF_FORCE = 0.25
#: A contact is new for so long [s]: three frames of a usual camera ...
_NEW_S = 0.1
#: ... after foam that was deflected by less than this [m], as for a jump.
_FREE_M = 5e-4
#: Dents that are shallower than this and than this part of the depth are texture, kinks and noise.
_SHALLOW_M, _SHALLOW = 5e-5, 0.03
#: A dent lies between points that reach this part of the contact's depth.
_BESIDE = 0.5
#: Longest decay length of free foam by its width: what lies well beyond it in a dent is pressed or covered.
_DECAY_PER_WIDTH = 0.4


class NewContact:
    """Remembers for each point of the strip how it was while it was still free.

    Parameters
    ----------
    points
        K, points along the strip.
    """

    def __init__(self, points: int) -> None:
        self._past: deque[tuple[float, Float[np.ndarray, "K"]]] = deque()
        self._points = points

    def before(self, t_s: float, delta_m: Float[np.ndarray, "K"]) -> Float[np.ndarray, "K"]:
        """What each point had before its contact was new; ``delta_m`` itself where it is not new [m].

        Call it once per frame; NaN in ``delta_m`` are points that were not seen.

        Parameters
        ----------
        t_s
            Time of the frame [s].
        delta_m
            Deflection of each point [m].
        """
        while self._past and t_s - self._past[0][0] > _NEW_S + 1e-6:
            self._past.popleft()
        free = np.full(self._points, np.inf)
        for _, past in self._past:
            free = np.fmin(free, past)
        self._past.append((t_s, delta_m))
        with np.errstate(invalid="ignore"):
            new = (free < _FREE_M) & (delta_m > free)
        result: Float[np.ndarray, "K"] = np.where(new, np.maximum(free, 0.0), delta_m)
        return result


def without_dents(
    s_m: Float[np.ndarray, "n"],
    delta_m: Float[np.ndarray, "n"],
    sigma_m: Float[np.ndarray, "n"],
    width_m: float,
) -> Float[np.ndarray, "n"]:
    """Deflection of one contact if its dents were as deep as what lies beside them [m].

    The concave hull between the outermost points that reach half of the contact's depth, where
    it lies clearly above the points and most of these are deeper than free foam between two bodies.

    Parameters
    ----------
    s_m, delta_m, sigma_m
        Points of the contact, their deflection and its standard deviation, finite.
    width_m
        Width of the strip at rest.
    """
    if sigma_m.min(initial=0.0) < 0:
        raise InputError("without_dents", "found a negative standard deviation", field="sigma_m")
    result = delta_m.copy()
    core = np.flatnonzero(delta_m > _BESIDE * delta_m.max(initial=0.0))
    if len(core) < 3:
        return result
    part = slice(int(core[0]), int(core[-1]) + 1)
    s, delta = s_m[part], delta_m[part]
    hull: list[int] = []
    x, y = s.tolist(), delta.tolist()  # plain numbers: three times as fast in a loop
    for i in range(len(x)):
        while len(hull) >= 2:
            p, q = hull[-2], hull[-1]
            if (y[q] - y[p]) * (x[i] - x[p]) > (y[i] - y[p]) * (x[q] - x[p]):
                break
            hull.pop()
        hull.append(i)
    level = np.interp(s, s[hull], delta[hull])
    dent = level - delta > _SHALLOW_M + _SHALLOW * level + 3.0 * sigma_m[part]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], dent.astype(np.int8), [0]])))
    for first, stop in zip(edges[::2], edges[1::2], strict=True):
        # Free foam between two bodies is no dent: it decays from both. (The hull's ends are no dents.)
        a, b = first - 1, stop
        inner, decay = slice(first, stop), _DECAY_PER_WIDTH * width_m
        free = delta[a] * np.exp((s[a] - s[inner]) / decay) + delta[b] * np.exp((s[inner] - s[b]) / decay)
        if np.median(delta[inner] - free) > _FREE_M:
            result[part][inner] = level[inner]
    return result


def unverified_force(
    material: FoamMaterial,
    s_m: Float[np.ndarray, "n"],
    before_m: Float[np.ndarray, "n"],
    delta_m: Float[np.ndarray, "n"],
    sigma_m: Float[np.ndarray, "n"],
) -> float:
    """Standard deviation of a contact's force by what is new in it and by its dents [N].

    By the pressure that each deflection has by itself.

    Parameters
    ----------
    material
        Calibrated foam.
    s_m, delta_m, sigma_m
        Points of the contact, their deflection and its standard deviation; NaN where not seen [m].
    before_m
        From :meth:`NewContact.before`.
    """
    finite = np.isfinite(delta_m)
    s, before, delta, sigma = s_m[finite], before_m[finite], delta_m[finite], sigma_m[finite]
    if len(s) < 2:
        return 0.0
    depths = np.stack([before, delta, without_dents(s, delta, sigma, material.width_m)])
    pressure = material.stress(np.maximum(depths, 0.0) / material.width_m)
    old, seen, filled = material.height_m * pressure @ np.gradient(s)
    return _OF_FORCE * float(abs(seen - old) + abs(filled - seen))


def with_unverified(
    reading: FoamReading,
    s_m: Float[np.ndarray, "K"],
    before_m: Float[np.ndarray, "K"],
    delta_m: Float[np.ndarray, "K"],
    sigma_m: Float[np.ndarray, "K"],
    material: FoamMaterial,
) -> FoamReading:
    """The reading with :func:`unverified_force` in the budget of each contact, and their sum in the whole.

    Their sum, as one hand may reach over all of them.

    Parameters
    ----------
    reading
        Contacts of the frame.
    s_m
        Position of the points along the strip [m].
    before_m
        From :meth:`NewContact.before` [m].
    delta_m, sigma_m
        Deflection and its standard deviation [m].
    material
        Calibrated foam.
    """
    contacts, whole = [], 0.0
    for contact in reading.contacts:
        part = slice(contact.first, contact.last + 1)
        uncertainty = unverified_force(material, s_m[part], before_m[part], delta_m[part], sigma_m[part])
        contacts.append(replace(contact, budget=_with_model(contact.budget, uncertainty)))
        whole += uncertainty
    return replace(reading, contacts=tuple(contacts), budget=_with_model(reading.budget, whole))


def _with_model(budget: ErrorBudget, uncertainty_N: float) -> ErrorBudget:
    return replace(budget, model_N=float(np.hypot(budget.model_N, uncertainty_N)))
