"""Merging is commutative, associative and idempotent."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visuohaptic.core import (
    Estimate,
    Evidence,
    FeatureVector,
    InputError,
    Material,
    ObjectPart,
    Provenance,
    Sighting,
    VisuoHapticObject,
    cards,
)
from visuohaptic.database import add_evidence, combine, merge_objects


def _text(obj: VisuoHapticObject) -> str:
    card, arrays = cards.encode(obj)
    return cards.card_text(card) + cards.arrays_digest(arrays)


def test_measurement_refines_simulation() -> None:
    both = combine([Estimate(1000.0, 200.0), Estimate(1100.0, 20.0)])
    # By hand: weights 1/200^2 and 1/20^2.
    assert both.value == pytest.approx((1000 / 4e4 + 1100 / 400) / (1 / 4e4 + 1 / 400))
    assert both.sigma == pytest.approx((1 / 4e4 + 1 / 400) ** -0.5)
    assert both.samples == 2
    assert both.spread == 0


def test_contradiction_is_less_certain() -> None:
    both = combine([Estimate(5.0, 0.1), Estimate(7.0, 0.1)])
    assert both.value == pytest.approx(6.0)
    assert both.sigma == pytest.approx(1.0)  # the standard error of two values 2 apart
    assert both.spread == pytest.approx(np.sqrt(2 * (1 - 0.01)))  # their scatter less the noise


def test_a_vague_estimate_says_little_of_the_scatter() -> None:
    """Bessel's factor is that of the estimates that carry weight, at most 2: nearly all weight is on one here."""
    both = combine([Estimate(5.0, 0.1), Estimate(9.0, 1.0)])
    weights = np.array([1 / 0.01, 1 / 1.0]) / (1 / 0.01 + 1 / 1.0)
    off2 = (np.array([5.0, 9.0]) - weights @ [5.0, 9.0]) ** 2
    assert both.spread == pytest.approx(np.sqrt(2 * (weights @ np.maximum(off2 - [0.01, 1.0], 0.0))))


def test_exact_values_that_differ_have_the_error_of_their_mean() -> None:
    for values in ([5.0, 7.0], [5.0, 7.0, 12.0]):
        both = combine([Estimate(value, 0.0) for value in values])
        assert both.value == pytest.approx(np.mean(values))
        assert both.sigma == pytest.approx(np.sqrt(np.var(values) / (len(values) - 1)))


def _constant_fit(values: np.ndarray, sigmas: np.ndarray) -> tuple[float, float]:
    """Weighted mean and its error by NumPy's least squares of a constant, scaled by chi squared where that widens it."""
    flat = np.zeros(len(values))
    fit, scaled = np.polyfit(flat, values, 0, w=1 / sigmas, cov=True)
    _, plain = np.polyfit(flat, values, 0, w=1 / sigmas, cov="unscaled")
    return float(fit[0]), float(np.sqrt(max(scaled[0, 0], plain[0, 0])))


def test_versions_of_a_part_whose_name_has_a_dot_are_merged() -> None:
    def cup(value: float) -> VisuoHapticObject:
        wall = Material(wall_thickness_m=Estimate(value, 1e-4))
        return VisuoHapticObject("cup", parts={"lid 1.5": ObjectPart(material=wall)})

    merged = merge_objects(cup(1e-3), cup(2e-3)).parts["lid 1.5"].material
    assert merged is not None
    assert merged.wall_thickness_m is not None
    assert merged.wall_thickness_m.value == pytest.approx(1.5e-3)


@pytest.mark.parametrize("count", [3, 5, 9])
@pytest.mark.parametrize("disagreement", [0.1, 1.0, 8.0])
def test_many_are_combined_as_by_least_squares(count: int, disagreement: float) -> None:
    rng = np.random.default_rng(count)
    sigmas, spreads = rng.uniform(0.5, 3.0, count), rng.uniform(0.0, 2.0, count)
    values = 7.0 + disagreement * rng.normal(size=count)
    both = combine(Estimate(v, s, spread, 2) for v, s, spread in zip(values, sigmas, spreads, strict=True))
    assert (both.value, both.sigma) == pytest.approx(_constant_fit(values, sigmas), rel=1e-9)
    assert both.samples == 2 * count
    same = combine(Estimate(7.0, s, spread) for s, spread in zip(sigmas, spreads, strict=True))
    # Values that agree differ by their contacts alone.
    assert same.spread**2 == pytest.approx(np.average(spreads**2, weights=sigmas**-2.0), rel=1e-9)
    assert both.spread >= 0.99 * np.sqrt(np.average(spreads**2, weights=sigmas**-2.0))


def test_what_is_all_but_exact_leaves_nothing_to_what_is_vague() -> None:
    one = combine([Estimate(3.0, 0.0), Estimate(9.0, 1.0)])
    assert (one.value, one.sigma, one.samples) == (3.0, 0.0, 2)
    # The other's weight of 1e-18 is lost beside 1.
    one = combine([Estimate(3.0, 1e-9), Estimate(4.0, 1.0)])
    assert (one.value, one.spread) == pytest.approx((3.0, 0.0), abs=1e-9)


def test_declared_sigma_is_true() -> None:
    rng = np.random.default_rng(3)
    off = []
    for _ in range(400):
        sigmas = rng.uniform(0.5, 2.0, 6)
        both = combine(Estimate(float(rng.normal(3, s)), float(s)) for s in sigmas)
        off.append((both.value - 3) / both.sigma)
    # At most 1 (the Birge factor only widens), and 4 standard errors of a deviation over 400 draws.
    assert 0.7 < np.std(off) < 1 + 4 / np.sqrt(800)


_versions = st.builds(
    lambda name, t, lid, wall, fill, seen: VisuoHapticObject(
        "cup",
        name=name,
        material=None if wall is None else Material(name or "x", wall_thickness_m=Estimate(wall, 1e-4)),
        parts={} if lid is None else {"lid": ObjectPart(material=Material(lid))},
        state={} if fill is None else {"fill": fill},
        features={"f": FeatureVector(np.full(3, t))},
        provenance={"name": Provenance("a", t), "parts": Provenance(lid or "b", t)},
        seen=None if seen is None else Sighting((seen, 0.0, 0.0), 0.1, t),
    ),
    st.sampled_from(["", "a", "b"]),
    st.sampled_from([1.0, 2.0, float("nan")]),
    st.sampled_from([None, "pet", "steel"]),
    st.sampled_from([None, 1e-3, 2e-3]),
    st.sampled_from([None, 0.0, "half"]),
    st.sampled_from([None, 1.0, 2.0]),
)


@settings(max_examples=60, deadline=None)
@given(_versions, _versions, _versions)
def test_any_order_any_number(a: VisuoHapticObject, b: VisuoHapticObject, c: VisuoHapticObject) -> None:
    results = {_text(merge_objects(merge_objects(x, y), z)) for x, y, z in itertools.permutations((a, b, c))}
    once = merge_objects(merge_objects(a, b), c)
    results |= {_text(merge_objects(a, merge_objects(b, c))), _text(merge_objects(once, b))}
    assert len(results) == 1


def test_evidence_counts_once_and_makes_its_place() -> None:
    one = Evidence("parts.lid.tag.stiffness_N_per_m", Estimate(10.0, 1.0))
    cup = add_evidence(add_evidence(VisuoHapticObject("cup"), one), one)
    assert cup.parts["lid"].tag is not None
    assert cup.parts["lid"].tag.stiffness_N_per_m == Estimate(10.0, 1.0)
    for place in ("tag", "tag.fixed", "colour", "material.name", "parts.lid", "tag.drift.value"):
        with pytest.raises(InputError):
            add_evidence(cup, Evidence(place, Estimate(1.0, 1.0)))


@pytest.mark.parametrize("place", ["state", "state.fill", "name", "visual_class"])
@pytest.mark.parametrize("newer", [0, 1])
def test_a_field_comes_from_the_version_that_is_newer_there(place: str, newer: int) -> None:
    """By the provenance of an entry, or of the whole field; the other fields by their contents, in a fixed order."""
    field = place.partition(".")[0]
    versions = [
        VisuoHapticObject(
            "cup",
            **{field: {"fill": float(number)} if field == "state" else f"{field} {number}"},
            provenance={place: Provenance(f"robot {number}", 10.0 + (number == newer))},
        )
        for number in (0, 1)
    ]
    for pair in (versions, versions[::-1]):
        both = merge_objects(*pair)
        assert getattr(both, field) == getattr(versions[newer], field)
        assert both.provenance[place] == versions[newer].provenance[place]


def test_what_only_an_older_version_knows_is_kept() -> None:
    old = VisuoHapticObject("cup", name="cup", state={"lid": "on"}, provenance={"name": Provenance("a", 1.0)})
    new = VisuoHapticObject("cup", state={"fill": 0.5}, provenance={"state": Provenance("b", 2.0)})
    for both in (merge_objects(old, new), merge_objects(new, old)):
        assert (both.name, dict(both.state)) == ("cup", {"lid": "on", "fill": 0.5})
        assert both.provenance["name"] == old.provenance["name"]


def test_an_estimate_without_weight_changes_nothing() -> None:
    """A sigma of 1 nm beside one of 10 km: the weight of the second is below the resolution of a number."""
    found = combine([Estimate(1.0, 1e-9), Estimate(2.0, 1e4)])
    assert found.value == pytest.approx(1.0)
    assert found.sigma == pytest.approx(1e-9)
    assert found.spread == pytest.approx(0.0, abs=1e-9)
