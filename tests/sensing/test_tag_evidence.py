"""The pushes used as evidence for haptic tags, and a slice of their campaign."""

from __future__ import annotations

import numpy as np
import pytest
from tests.worlds import tag_pushes

from benchmarks import tag_evidence
from visuohaptic.core import Estimate
from visuohaptic.sensing.push import predictive_interval

COUNT = 10


@pytest.fixture(scope="module")
def felt() -> dict[tuple[str, int, int], tag_pushes.Push]:
    cases = [(setting, 2 * i, n) for setting in tag_pushes.SETTINGS for i in range(COUNT) for n in (0, 1)]
    return dict(zip(cases, tag_pushes.pushes(cases), strict=True))


@pytest.fixture(scope="module")
def rows(felt) -> list[dict]:
    return [
        {"setting": setting, **tag_evidence.measure(push, felt[setting, seed, 1])}
        for (setting, seed, number), push in felt.items()
        if number == 0
    ]


def test_the_floor_takes_what_the_foam_gives(felt) -> None:
    """Where the foam's force is steady before the platform brakes, half a second before the end, it is the friction."""
    steady = 0
    for (setting, _, _), push in felt.items():
        late = (push.t_s > push.t_s[-1] - 1.1) & (push.t_s < push.t_s[-1] - 0.55)
        force = push.force_N[late]
        if setting == "coulomb" and np.isfinite(force).all() and np.ptp(push.deflection_m[late]) < 5e-4:
            steady += 1
            # Three deviations of the scale.
            assert abs(force.mean() / push.dynamic_N - 1.0) < 3 * push.force_scale_sigma.max() + 0.01
    assert steady >= 4


def test_what_breaks_away_takes_more_than_what_slides(felt) -> None:
    for (setting, _, _), push in felt.items():
        assert push.slid_m > 0.01
        assert np.isfinite(push.static_N)
        if setting == "coulomb":
            assert push.static_N >= push.dynamic_N


@pytest.mark.parametrize("name", list(tag_evidence.FIELDS))
def test_the_intervals_of_a_push_hold(rows, name: str) -> None:
    value, sigma, _, _, true, _ = tag_evidence._cases(rows, name).T
    # Three deviations of a 90 % interval among so many.
    slack = 3 * np.sqrt(0.09 / len(value))
    assert len(value) >= (10 if name == "stiffness" else 30)
    assert np.mean(np.abs(value - true) < tag_evidence.NINETY * sigma) > 0.9 - slack
    # chi^2 of 10 and more: below 1.5 with a probability of 0.999.
    assert np.sqrt(np.mean(((value - true) / sigma) ** 2)) < 1.5
    # An interval that held by being wide would have a deviation far above the errors.
    assert np.median(sigma / true) < 0.2


@pytest.mark.parametrize("name", list(tag_evidence.FIELDS))
def test_the_next_push_falls_into_an_interval_that_says_something(rows, name: str) -> None:
    value, _, low, high, _, then = tag_evidence._cases(rows, name).T
    assert np.mean((low < then) & (then < high)) > 0.9 - 3 * np.sqrt(0.09 / len(value))
    # Less than nothing is what no friction is.
    assert np.mean(low > 0) > 0.9


def test_one_push_foretells_the_next_by_as_much_as_real_ones_spread() -> None:
    """Normal forces that spread by 0.23: Student's t of five degrees of freedom holds what 90 % of pairs differ by."""
    low, high = predictive_interval(Estimate(1.0, 0.0))
    # Differences of two spread by 0.23 sqrt(2): 0.54 at 90 %; the spread itself is known to a third.
    assert 0.54 < 0.5 * (high - low) < 0.75


def test_a_campaign_goes_on_where_it_was(tmp_path, monkeypatch, felt) -> None:
    monkeypatch.setattr(tag_pushes, "pushes", lambda cases: [felt[case] for case in cases])
    report = tmp_path / "tags.jsonl"
    rows = tag_evidence.campaign(count=2, report=report)
    assert len(rows) == 10
    monkeypatch.setattr(tag_pushes, "pushes", None)
    assert tag_evidence.campaign(count=2, report=report) == rows
    lines = tag_evidence.figures(rows)
    assert [line["name"].split(",")[0] for line in lines[::6]] == ["static", "dynamic", "stiffness"]
