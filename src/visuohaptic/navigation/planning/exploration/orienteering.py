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
#: Number of successive visits that the heuristic replaces at once.
REMOVED = 3

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
        opens, saved = self.values[visited if len(self.values) > 1 else 0, last].tolist()
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


def best_order(problem: Orienteering) -> tuple[int, ...]:
    """The order of visits with the greatest benefit, exact up to ``EXACT_OBJECTS`` objects.

    Beyond, visits are inserted greedily by their benefit per time; the order is improved by reversals (2-opt), and by
    other visits in place of one to three successive ones.

    Parameters
    ----------
    problem
        Times, benefits and budget. More than ``EXACT_OBJECTS`` objects need benefits that are independent of the set.
    """
    return _all_orders(problem) if problem.visit_us.shape[1] <= EXACT_OBJECTS else _heuristic(problem)


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
            return total + value * max(room, 0) // weight + 1
        room, total = room - weight, total + value
    return total


class _Label(NamedTuple):
    """A way to visit a set."""

    time: int
    opens: int
    saved: int
    order: tuple[int, ...]


def _all_orders(problem: Orienteering) -> tuple[int, ...]:
    """Dynamic programming over (set, last object) with all ways that are not both longer and worse than another."""
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
        for (_, last), labels in states.items():
            home = homes[last + 1]
            for one in labels:
                key = (one.opens, one.saved, -one.time - home)
                if home >= 0 and one.time + home <= problem.budget_us and key > best_key:
                    best, best_key = one.order, key
    return best


def _undominated(labels: list[_Label]) -> list[_Label]:
    kept: list[_Label] = []
    for one in sorted(labels, key=lambda one: (one.time, -one.opens, -one.saved)):
        if not kept or (one.opens, one.saved) > (kept[-1].opens, kept[-1].saved):
            kept.append(one)
    return kept


def _heuristic(problem: Orienteering) -> tuple[int, ...]:
    """Greedy insertion, then parts of the order are removed and filled again as long as that improves it."""
    order = _filled(problem, ())
    best, improved = _key(problem, order), True
    while improved:
        improved = False
        for first in range(len(order)):
            for last in range(first + 1, min(first + REMOVED, len(order)) + 1):
                other = _filled(problem, (*order[:first], *order[last:]), order[first:last])
                key = _key(problem, other)
                if key > best:
                    order, best, improved = other, key, True
    return order


def _key(problem: Orienteering, order: tuple[int, ...]) -> tuple[int, int, int]:
    tour = problem.tour(order)
    return (-1, 0, 0) if tour is None else (*tour[0], -tour[1])


def _filled(problem: Orienteering, order: tuple[int, ...], without: tuple[int, ...] = ()) -> tuple[int, ...]:
    """Insert the visit with the greatest benefit per additional time and shorten the order, as long as one fits."""
    now = problem.tour(order)
    free = set(range(problem.visit_us.shape[1])) - {*order, *without}
    while now is not None:
        inserted = []
        for index in free:
            value = problem.value(0, index)
            for at in range(len(order) + 1) if any(value) else ():
                longer = (*order[:at], index, *order[at:])
                if (tour := problem.tour(longer)) is not None:
                    more = max(tour[1] - now[1], 1)
                    inserted.append(((value[0] / more, value[1] / more), longer))
        if not inserted:
            break
        order = _reversed(problem, max(inserted)[1])
        now, free = problem.tour(order), free - set(order)
    return order


def _reversed(problem: Orienteering, order: tuple[int, ...]) -> tuple[int, ...]:
    """2-opt: reverse parts of the order as long as that shortens it."""
    shortest = problem.tour(order)
    improved = True
    while improved and shortest is not None:
        improved = False
        for first in range(len(order) - 1):
            for last in range(first + 2, len(order) + 1):
                other = (*order[:first], *order[first:last][::-1], *order[last:])
                tour = problem.tour(other)
                if tour is not None and tour[1] < shortest[1]:
                    order, shortest, improved = other, tour, True
    return order
