"""Orienteering: the order of visits with the greatest benefit within a budget of time.

Benefits are compared by the number of openings first and by the time saved second, because an opening is an infinite
benefit (Alt 2016, Eq. (4.2)); equal benefits by the duration. Times are integers [us] and benefits integers (1e-9 openings
and us), so that sums do not depend on their order.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Int64

#: Up to this number of objects the search covers every order: its 2**n n states take up to three seconds.
EXACT_OBJECTS = 12
#: Limit of the work with more objects: visits that are tried, about as many as for ``EXACT_OBJECTS``.
TRIED = 1_000_000

Value = tuple[int, int]  #: openings [1e-9], time saved [us]


@dataclass(frozen=True, slots=True, eq=False)
class Orienteering:
    """Objects with the times between them, and benefits that may depend on those visited before."""

    #: time from the start (row 0) or from object ``k`` (row ``k + 1``) to each object, with its visit [us]; -1: no way
    visit_us: Int64[np.ndarray, "n1 n"]
    finish_us: Int64[np.ndarray, "n1"]  #: time from there to the end of the tour [us]; -1: no way
    budget_us: int
    #: openings and time saved by set visited before (bit ``k``: object ``k``) and object; one row: independent of it
    values: Int64[np.ndarray, "sets n 2"]

    def value(self, visited: int, last: int) -> Value:
        """Benefit of one visit.

        Parameters
        ----------
        visited
            Set of the objects visited before, as bits.
        last
            Index of the object.
        """
        opens, saved = self.values[visited % len(self.values), last].tolist()
        return opens, saved

    def tour(self, order: tuple[int, ...]) -> tuple[Value, int] | None:
        """Benefit and duration [us] of an order of visits; ``None`` if it exceeds the budget or has no way.

        Parameters
        ----------
        order
            Indices of the objects.
        """
        at = visited = opens = saved = time = 0
        for index in order:
            leg = int(self.visit_us[at, index])
            if leg < 0:
                return None
            one = self.value(visited, index)
            opens, saved, time = opens + one[0], saved + one[1], time + leg
            at, visited = index + 1, visited | 1 << index
        home = int(self.finish_us[at])
        return ((opens, saved), time + home) if home >= 0 and time + home <= self.budget_us else None


class _Label(NamedTuple):
    """A way to visit a set."""

    time: int
    opens: int
    saved: int
    order: tuple[int, ...]


def best_order(problem: Orienteering) -> tuple[int, ...]:
    """The order of visits with the greatest benefit, exact up to ``EXACT_OBJECTS`` objects.

    Ways are extended by one visit at a time. Of those that visit the same set and end at the same object, only those are kept
    that no other one precedes in time and exceeds in benefit; beyond ``EXACT_OBJECTS`` objects, only sets with the greatest
    benefit per time.

    Parameters
    ----------
    problem
        Times, benefits and budget. More than ``EXACT_OBJECTS`` objects need benefits that are independent of the set.
    """
    ways, homes = problem.visit_us.tolist(), problem.finish_us.tolist()
    count = problem.visit_us.shape[1]
    best: tuple[int, ...] = ()
    best_key = (0, 0, -homes[0])
    states: dict[tuple[int, int], list[_Label]] = {(0, -1): [_Label(0, 0, 0, ())]}
    while states:
        following: dict[tuple[int, int], list[_Label]] = {}
        for (visited, last), labels in states.items():
            for index in range(count):
                leg = ways[last + 1][index]
                if visited >> index & 1 or leg < 0:
                    continue
                opens, saved = problem.value(visited, index)
                longer = [
                    _Label(one.time + leg, one.opens + opens, one.saved + saved, (*one.order, index))
                    for one in labels
                    if one.time + leg <= problem.budget_us
                ]
                if longer:
                    following.setdefault((visited | 1 << index, index), []).extend(longer)
        states = {state: _undominated(labels) for state, labels in following.items()}
        if count > EXACT_OBJECTS:
            kept = sorted(states, key=lambda state: _rate(states[state]), reverse=True)[: TRIED // count**2]
            states = {state: states[state] for state in kept}
        for (_, last), labels in states.items():
            home = homes[last + 1]
            for one in labels:
                key = (one.opens, one.saved, -one.time - home)
                if home >= 0 and one.time + home <= problem.budget_us and key > best_key:
                    best, best_key = one.order, key
    return best


def upper_bound(problem: Orienteering) -> Value:
    """No tour within the budget has more openings or saves more time, for benefits independent of the order.

    The fractional knapsack with the shortest way into each object as its weight, for each of the two.

    Parameters
    ----------
    problem
        Times, benefits and budget; benefits are those of its first row.
    """
    ways = np.where(problem.visit_us < 0, np.iinfo(np.int64).max, problem.visit_us).min(axis=0)
    opens, saved = (
        _knapsack(ways.tolist(), problem.values[0, :, part].tolist(), problem.budget_us) for part in (0, 1)
    )
    return opens, saved


def _knapsack(weights: list[int], values: list[int], room: int) -> int:
    total = 0
    for weight, value in sorted(zip(weights, values, strict=True), key=lambda one: -one[1] / max(one[0], 1)):
        if weight > room:
            return total + value * room // weight + 1
        room, total = room - weight, total + value
    return total


def _undominated(labels: list[_Label]) -> list[_Label]:
    kept: list[_Label] = []
    for one in sorted(labels, key=lambda one: (one.time, -one.opens, -one.saved)):
        if not kept or (one.opens, one.saved) > (kept[-1].opens, kept[-1].saved):
            kept.append(one)
    return kept


def _rate(labels: list[_Label]) -> tuple[float, float]:
    """Greatest benefit per time of some ways."""
    return max((one.opens / max(one.time, 1), one.saved / max(one.time, 1)) for one in labels)
