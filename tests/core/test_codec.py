"""Dataclasses as plain data: round trips, one strict reader, and equal results for a haptic tag in every format."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from jaxtyping import Float, Int

from visuohaptic.core import (
    Estimate,
    HapticTag,
    InputError,
    Primitive,
    PrimitiveKind,
    VisuohapticError,
    decode,
    from_dict,
    to_dict,
)
from visuohaptic.core.codec import encode_record
from visuohaptic.core.ranges import POSITIVE, check_ranges
from visuohaptic.database import import_object
from visuohaptic.navigation.problem import load_objects


class Gear(Enum):
    LOW = 1
    HIGH = 2


@dataclass(frozen=True)
class Wheel:
    radius_m: float = field(metadata=POSITIVE)
    name: str = ""

    __post_init__ = check_ranges


@dataclass(frozen=True, eq=False)
class Cart:
    wheels: tuple[Wheel, ...]
    corners_m: Float[np.ndarray, "n 2"]
    order: Int[np.ndarray, " n"] | None = None
    gear: Gear = Gear.LOW
    load: str | float = "none"
    named: Mapping[str, tuple[float, int]] = field(default_factory=dict)
    note: Any = None
    checked: bool | None = True
    driven: Literal["front", "all"] = "front"


CART = {"wheels": [{"radius_m": 0.1}], "corners_m": [[0, 0], [1, 0.5]]}


def test_a_record_goes_round_through_json() -> None:
    cart = Cart(
        (Wheel(0.1, "left"), Wheel(0.2)),
        np.array([[0.0, math.nan], [math.inf, 1e-300]]),
        np.array([2, 1]),
        Gear.HIGH,
        math.nan,
        {"b": (1.5, 2), "a": (0.0, 3)},
        {"any": [1, None]},
        None,
        driven="all",
    )
    text = json.dumps(to_dict(cart), allow_nan=False)
    again = from_dict(Cart, json.loads(text))
    np.testing.assert_array_equal(again.corners_m, cart.corners_m)
    np.testing.assert_array_equal(again.order, cart.order)
    assert again.order is not None
    assert again.order.dtype == np.int64
    assert (again.wheels, again.gear, again.driven) == (cart.wheels, Gear.HIGH, "all")
    assert (again.note, again.checked) == (cart.note, None)
    assert dict(again.named) == dict(cart.named)
    assert json.dumps(to_dict(again), allow_nan=False) == text


def test_what_is_left_out_or_null_has_its_default() -> None:
    for extra in ({}, {"order": None, "gear": None, "named": None, "load": None}):
        cart = from_dict(Cart, CART | extra)
        assert (cart.order, cart.gear, cart.load, cart.checked) == (None, Gear.LOW, "none", True)
        assert cart.named == {}


@dataclass(frozen=True)
class Cover:
    sides: tuple[int, ...] | None = None
    names: tuple[str, ...] = ("top",)
    holes: tuple[int, ...] = ()


@pytest.mark.parametrize("cover", [Cover(), Cover((), (), ()), Cover(None, ()), Cover((), ("top",), (2,))])
def test_an_empty_list_is_not_taken_for_another_default(cover: Cover) -> None:
    """A card leaves out what is a default; an empty list in a field whose default is another one is knowledge."""
    assert from_dict(Cover, encode_record(cover, {}), where="card") == cover


def test_numbers_as_yaml_reads_them() -> None:
    cart = from_dict(Cart, CART | {"wheels": [{"radius_m": "1e-3"}], "named": {"a": ["-.5", 2.0]}, "load": 3})
    assert cart.wheels[0].radius_m == pytest.approx(1e-3)
    assert dict(cart.named) == {"a": (-0.5, 2)}
    assert isinstance(cart.named["a"][1], int)
    assert cart.load == 3.0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"wheel": 1}, "file: wheel: is unknown, expected one of wheels, corners_m, "),
        ({"wheels": None}, "file: wheels: is missing"),
        ({"wheels": {}}, "file: wheels: found {}, expected a list of entries"),
        ({"wheels": [{}]}, "file: wheels[0].radius_m: is missing"),
        ({"wheels": [3]}, "file: wheels[0]: found 3, expected a mapping of fields"),
        ({"wheels": [{"radius_m": -1}]}, "file: wheels[0].radius_m: found -1.0, expected more than 0"),
        ({"wheels": [{"radius_m": True}]}, "file: wheels[0].radius_m: found True, expected a finite number"),
        (
            {"wheels": [{"radius_m": math.nan}]},
            "file: wheels[0].radius_m: found nan, expected a finite number",
        ),
        ({"wheels": [{"radius_m": 10**400}]}, "expected a finite number"),
        ({"wheels": [{"radius_m": 1, "name": 3}]}, "file: wheels[0].name: found 3, expected a text"),
        ({"corners_m": [[0, 0], [1]]}, "file: corners_m: found [[0, 0], [1]], expected an array of numbers"),
        ({"corners_m": [[0, 0, 0]]}, "float64 with shape (1, 3), expected float with shape (n 2)"),
        ({"corners_m": [[0, "x"]]}, "file: corners_m: found 'x', expected a finite number"),
        ({"corners_m": {"array": "a"}}, "file: corners_m: the array 'a' is missing"),
        ({"order": [0, 1.5]}, "file: order: found 1.5, expected a whole number"),
        ({"order": [2**70]}, "file: order: found"),
        ({"gear": 3}, "file: gear: found 3, expected one of 1, 2"),
        ({"driven": "rear"}, "file: driven: found 'rear', expected one of front, all"),
        ({"named": {"a": [1]}}, "file: named.a: found [1], expected a list of 2"),
        ({"named": {"a": [1, math.inf]}}, "file: named.a[1]: found inf, expected a whole number"),
        ({"checked": "yes"}, "file: checked: found 'yes', expected true or false"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(change: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as error:
        from_dict(Cart, CART | change, where="file")
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_what_cannot_be_written() -> None:
    with pytest.raises(InputError, match="note: found set, expected numbers, texts"):
        to_dict(Cart((), np.zeros((0, 2)), note={1, 2}))
    with pytest.raises(InputError, match="corners_m: found an array of object"):
        to_dict(Cart((), np.array([["a", None]], dtype=object)))


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@given(PLAIN, st.sampled_from(["wheels", "corners_m", "order", "gear", "load", "named", "checked", "driven"]))
def test_any_data_are_read_or_refused(value: Any, name: str) -> None:
    try:
        cart = from_dict(Cart, CART | {name: value})
    except InputError:
        return
    again = from_dict(Cart, json.loads(json.dumps(to_dict(cart), allow_nan=False)))
    assert to_dict(again) == to_dict(cart)


TAG = HapticTag(
    static_friction_N=Estimate(8.1, 0.1, 0.5, 2),
    primitive=Primitive(PrimitiveKind.CIRCLE, np.array([0.1, 0.0, 0.05]), 1e-8 * np.eye(3), 0.97),
    deformation_shape_m=np.array([[0.018, -0.01], [0.016, 0.0]]),
    min_static_friction_N=7.0,
    fixed=False,
    explored=2,
)
#: A tag as text, and what it says: ``None`` when it is refused.
TAGS: list[tuple[str, dict[str, Any] | None]] = [
    ("{}", {}),
    ("{drift: 0.03}", {"drift": Estimate(0.03)}),
    ("{deformability: 1e-3}", {"deformability": Estimate(1e-3)}),
    ("{drift: {value: 0.03}}", {"drift": Estimate(0.03)}),
    (
        "{drift: {value: 7.5, sigma: 0.2, spread: 1.1, samples: 3.0}, explored: 1.0}",
        {"drift": Estimate(7.5, 0.2, 1.1, 3), "explored": 1},
    ),
    ("{drift: null, explored: null, fixed: null}", {}),
    ("{drift: {value: -0.1, sigma: 0.01}}", {"drift": Estimate(-0.1, 0.01)}),
    ("{static_friction_N: {value: -0.1, sigma: 0.1}}", {"static_friction_N": Estimate(-0.1, 0.1)}),
    ("{static_friction_N: -0.1}", None),
    ("{static_friction_N: {value: -1, sigma: 0.1}}", None),
    ("{stiffness_N_per_m: {value: 800, sigma: 50}}", {"stiffness_N_per_m": Estimate(800.0, 50.0)}),
    ("{drift: {sigma: 1}}", None),
    ("{drift: {value: null}}", None),
    ("{drift: much}", None),
    ("{drift: true}", None),
    ("{drift: .nan}", None),
    ("{drift: nan}", None),
    ("{drift: {value: 1, sigma: -1}}", None),
    ("{drift: {value: 1, sigma: 0, samples: 1.5}}", None),
    ("{drift: {value: 1, sigma: 0, samples: 0}}", None),
    ("{drift: {value: 1, sigma: 0, unit: N}}", None),
    ("{min_static_friction_N: inf}", None),
    ("{fixed: 'no'}", None),
    ("{explored: -1}", None),
    ("{failed: true}", None),
    ("{friction: 3}", None),
    ("{deformation_shape_m: [[0.1, 0.2], [0.3, 0.4]]}", {"deformation_shape_m": [[0.1, 0.2], [0.3, 0.4]]}),
    ("{deformation_shape_m: [[0.1, 0.2, 0.3]]}", None),
    ("{deformation_shape_m: [[1.0e+9, 0.2]]}", None),
    ("{primitive: {kind: star, parameters: [1], covariance: [[1]], score: 1}}", None),
    ("{primitive: {kind: circle, parameters: [0, 0], covariance: [[1, 0], [0, 1]], score: 1}}", None),
    ("{primitive: {kind: circle, parameters: [0, 0, 1], score: 1}}", None),
    ("3", None),
    ("[]", None),
]


def doors(text: str, folder: Path) -> dict[str, HapticTag | None]:
    """What each reader of the house makes of a tag; ``None`` when it refuses."""
    found: dict[str, HapticTag | None] = {}
    objects = folder / "objects.yaml"
    objects.write_text(f"objects: [{{id: a, footprint_m: [[0, 0], [1, 0], [0, 1]], haptic_tag: {text}}}]")
    card = folder / "card.yaml"
    card.write_text(
        f"{{format: visuohaptic object, version: 1, licence: CC0-1.0, object: {{id: a, tag: {text}}}}}"
    )
    readers = {
        "plain": lambda: from_dict(HapticTag, yaml.safe_load(text)),
        "objects.yaml": lambda: load_objects(objects)[0].tag,
        "card.yaml": lambda: import_object(card).tag,
        "database": lambda: decode({"id": "a", "tag": yaml.safe_load(text)}, {}).tag,
    }
    for name, read in readers.items():
        try:
            found[name] = read()
        except VisuohapticError:
            found[name] = None
    return found


@pytest.mark.parametrize(("text", "expected"), TAGS)
def test_a_tag_means_the_same_at_every_door(
    text: str, expected: dict[str, Any] | None, tmp_path: Path
) -> None:
    found = doors(text, tmp_path)
    plain = None if expected is None else to_dict(HapticTag()) | to_dict(expected)
    assert {name: None if tag is None else to_dict(tag) for name, tag in found.items()} == dict.fromkeys(
        found, plain
    )


def test_a_whole_tag_goes_round_at_every_door(tmp_path: Path) -> None:
    text = yaml.safe_dump(to_dict(TAG), default_flow_style=True, width=1e9).strip()
    for name, tag in doors(text, tmp_path).items():
        assert tag is not None, name
        assert to_dict(tag) == to_dict(TAG), name


def test_the_place_of_a_wrong_tag_is_named() -> None:
    with pytest.raises(InputError, match=r"^a\.yaml: tag\.static_friction_N: found -1, expected >= 0"):
        from_dict(HapticTag, {"static_friction_N": -1}, where="a.yaml", place="tag")
    bad = {"kind": "circle", "parameters": [0, 0], "covariance": [[1, 0], [0, 1]], "score": 1}
    with pytest.raises(
        InputError, match=r"^HapticTag: primitive: found 2 parameters .* expected 3 of a circle"
    ):
        from_dict(HapticTag, {"primitive": bad})


def test_a_force_profile_comes_back_with_its_truth_values():
    """Arrays of true and false were refused as whole numbers."""
    from visuohaptic.core import ErrorBudget, ForceProfile, Reason

    value = np.array([0.0, np.nan, 2.0])
    seen = np.array([True, False, True])
    budget = ErrorBudget(0.1, 0.2, 0.3, 0.4)
    profile = ForceProfile(
        1.0, True, Reason.OK, 3.0, budget, np.arange(3.0), value, value, value, value, seen
    )
    again = from_dict(ForceProfile, to_dict(profile))
    assert again.point_valid.dtype == bool
    np.testing.assert_array_equal(again.point_valid, seen)
    np.testing.assert_array_equal(again.delta_m, value)
