"""What is asked for, and the order of the steps towards it: as good as the best of all policies."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.tasks import ContainerBelief, FetchRequest, FetchStep, next_container

CLASSES = ("bottle", "cup-rim", "glass")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("every transparent bottle", FetchRequest(True, transparent=True, class_name="bottle")),
        ("All open empty bottles", FetchRequest(True, closed=False, filled=False, class_name="bottle")),
        ("an opaque container", FetchRequest(False, transparent=False)),
        ("one full glass", FetchRequest(False, filled=True, class_name="glass")),
        ("a vessel", FetchRequest(False)),
    ],
)
def test_requests_are_read(text: str, expected: FetchRequest) -> None:
    assert FetchRequest.parse(text, CLASSES) == expected


@pytest.mark.parametrize(
    "text",
    [
        "",
        "bottle",
        "bottles",
        "every",
        "every soup",
        "some bottle",
        "every red bottle",
        "an open closed bottle",
    ],
)
def test_other_requests_are_refused_with_the_words_that_are_known(text: str) -> None:
    with pytest.raises(InputError, match="expected"):
        FetchRequest.parse(text, CLASSES)


def test_the_probability_is_that_of_all_that_is_required() -> None:
    belief = ContainerBelief(0.9, 0.2, 0.7, {"bottle": 0.6, "cup-rim": 0.4})
    assert FetchRequest().probability(belief) == pytest.approx(1.0)
    whole = FetchRequest(True, False, False, True, "bottle")
    assert whole.probability(belief) == pytest.approx(0.1 * 0.8 * 0.7 * 0.6)
    assert whole.probability(belief, ("closed", "filled")) == pytest.approx(0.8 * 0.7)
    assert FetchRequest(class_name="glass").probability(belief) == pytest.approx(0.0)
    assert FetchRequest(class_name="glass").probability(ContainerBelief()) == pytest.approx(0.5)


Rule = Callable[[dict[int, list[FetchStep]]], int]


def expected_s(chains: list[list[FetchStep]], *, every: bool, rule: Rule | None) -> float:
    """Expected sum of the times until deliveries, or that until the first one: of a rule, or of the best policy.

    By dynamic programming over the number of steps that each container has passed; -1: it is excluded or delivered.
    """

    @cache
    def rest(state: tuple[int, ...]) -> float:
        left = {k: chains[k][done:] for k, done in enumerate(state) if done >= 0}
        if not left:
            return 0.0
        return min(after(state, k) for k in (left if rule is None else (rule(left),)))

    # Waiting costs as much as there are deliveries to come, which no order changes: for each container, its probability.
    @cache
    def to_come(state: tuple[int, ...]) -> float:
        if not every:
            return 1.0
        each = [np.prod([s.passes for s in chains[k][n:]]) for k, n in enumerate(state) if n >= 0]
        return float(sum(each))

    def after(state: tuple[int, ...], k: int) -> float:
        step, done = chains[k][state[k]], state[k] + 1
        last = done == len(chains[k])
        out = (*state[:k], -1, *state[k + 1 :])
        on = out if last else (*state[:k], done, *state[k + 1 :])
        passed = 0.0 if last and not every else rest(on)
        return step.duration_s * to_come(state) + step.passes * passed + (1.0 - step.passes) * rest(out)

    return rest((0,) * len(chains))


@pytest.mark.parametrize("every", [False, True])
def test_no_order_of_steps_delivers_earlier(every: bool) -> None:
    rng, lost = np.random.default_rng(5), 0.0
    for _ in range(60):
        chains = [
            [FetchStep(float(s), float(p)) for s, p in rng.uniform((1.0, 0.05), (60.0, 1.0), (n, 2))]
            for n in rng.integers(1, 5, 3)
        ]
        least = expected_s(chains, every=every, rule=None)
        assert expected_s(chains, every=every, rule=next_container) == pytest.approx(least, rel=1e-9)
        lost += expected_s(chains, every=every, rule=min) / least - 1.0
    assert lost / 60 > 0.05  # of the order in which they stand
