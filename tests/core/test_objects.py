"""Object files: round trip, digests that follow the contents, and rejection of invalid files."""

from __future__ import annotations

import json

import numpy as np
import pytest

from visuohaptic.core import (
    Estimate,
    HapticTag,
    InputError,
    Primitive,
    PrimitiveKind,
    Sighting,
    StiffnessMap,
    VisuoHapticObject,
    cards,
)

TRIANGLE = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])
FACE = np.array([[0, 1, 2]])
PRIMITIVE = Primitive(PrimitiveKind.CIRCLE, np.array([0.1, 0.2, 0.05]), 1e-6 * np.eye(3), 0.9)


def _cup(**tag) -> VisuoHapticObject:
    given = {"static_friction_N": Estimate(8.0, 0.3), "primitive": PRIMITIVE, "explored": 2} | tag
    return VisuoHapticObject(
        "cup-1",
        tag=HapticTag(**given),
        stiffness=StiffnessMap(TRIANGLE, FACE, np.array([100.0, np.nan, 300.0]), np.full(3, 10.0)),
        seen=Sighting((1.0, 2.0, 0.7), 0.05, 10.0, context=("kitchen", "sink")),
    )


def test_a_card_comes_back_and_its_digest_follows_the_contents():
    card, arrays = cards.encode(_cup())
    text = cards.card_text(card)
    read = cards.decode(json.loads(text), arrays)
    again, again_arrays = cards.encode(read)
    assert cards.card_text(again) == text
    digest = cards.digest_of(text, cards.arrays_digest(arrays))
    assert digest == cards.digest_of(text, cards.arrays_digest(again_arrays))
    assert read.tag is not None
    assert read.tag.primitive is not None
    assert read.tag.primitive.parameters == pytest.approx(PRIMITIVE.parameters)
    for other in (_cup(explored=3), _cup(primitive=None)):
        changed, changed_arrays = cards.encode(other)
        assert cards.digest_of(cards.card_text(changed), cards.arrays_digest(changed_arrays)) != digest


def test_the_fixed_order_looks_at_all_but_estimates():
    assert cards.order_of(_cup()) == cards.order_of(_cup(static_friction_N=Estimate(9.0, 0.1)))
    assert cards.order_of(_cup()) != cards.order_of(_cup(explored=3))
    assert cards.order_of({"a": _cup()}) != cards.order_of({"b": _cup()})


def _broken(change):
    card, arrays = cards.encode(
        _cup(falls=False, min_static_friction_N=5.0, deformation_shape_m=TRIANGLE[:, :2])
    )
    arrays = {name: array.copy() for name, array in arrays.items()}
    card = json.loads(cards.card_text(card))
    change(card, arrays)
    return card, arrays


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda c, a: c["tag"].update(explored=-1), "explored: found -1, expected at least 0"),
        (lambda c, a: c["tag"]["static_friction_N"].update(value=-9.0), "found -9, expected >= 0"),
        (lambda c, a: c["tag"].update(min_static_friction_N="inf"), "found inf, expected a finite number"),
        (lambda c, a: c["seen"].update(sigma_m=-1.0), "expected finite position_m, sigma_m >= 0 and t_s"),
        (lambda c, a: c["tag"]["primitive"].update(kind="line", parameters=[1.0, 2.0]), "found 2 parameters"),
        (
            lambda c, a: c["tag"]["primitive"].update(parameters=[1.0, 2.0, "nan"]),
            "is not finite|found 'nan'",
        ),
        (lambda c, a: c["stiffness"].update(faces=[[0, 1, 3]]), "faces refer to vertices outside 0..2"),
        (
            lambda c, a: c["stiffness"].update(stiffness_N_per_m=[1.0, 2.0]),
            "one stiffness and sigma for 3|shape",
        ),
        (lambda c, a: c["tag"].update(deformation_shape_m=[[0.0, 1e6]]), "expected -1000 to 1000"),
        (lambda c, a: c["tag"].update(colour=1), "colour"),
        (lambda c, a: [a.pop(name) for name in list(a)], "the array '.*' is missing"),
    ],
)
def test_what_no_file_may_hold_is_refused(change, said):
    card, arrays = _broken(change)
    with pytest.raises(InputError, match=said):
        cards.decode(card, arrays)


def test_a_magnitude_is_negative_by_noise_up_to_six_sigmas_and_a_contour_is_smaller_than_a_kilometre():
    def read(**tag):
        HapticTag(**tag).check_read()

    read(static_friction_N=Estimate(-5.5, 1.0), deformation_shape_m=np.array([[0.0, -900.0]]))
    with pytest.raises(InputError, match=r"found -6\.5, expected >= 0"):
        read(static_friction_N=Estimate(-6.5, 1.0))
    with pytest.raises(InputError, match="expected -1000 to 1000"):
        read(deformation_shape_m=np.array([[0.0, -1100.0]]))


@pytest.mark.parametrize(("kind", "count"), [("line", 3), ("segment", 4), ("corner", 4), ("circle", 3)])
def test_a_shape_has_the_parameters_of_its_kind(kind, count):
    Primitive(PrimitiveKind(kind), np.ones(count), np.eye(count), 1.0).check_read()
    for other in (count - 1, count + 1):
        with pytest.raises(InputError, match=f"found {other} parameters .*expected {count} of a {kind}"):
            Primitive(PrimitiveKind(kind), np.ones(other), np.eye(other), 1.0).check_read()


def test_friction_above_a_push_is_known_by_a_bound_or_a_measurement():
    assert HapticTag(min_static_friction_N=6.0).needs_more_than(6.0)
    assert not HapticTag(min_static_friction_N=6.0).needs_more_than(6.1)
    assert HapticTag(dynamic_friction_N=Estimate(7.0, 0.1)).needs_more_than(6.9)
    assert not HapticTag(dynamic_friction_N=Estimate(7.0, 0.1)).needs_more_than(7.0)
    assert not HapticTag().needs_more_than(0.0)
