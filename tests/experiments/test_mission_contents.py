"""What is outside of an object that is seen through, and what a firm squeeze says of its contents."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.experiments.mission.bottle import STATES, contained, table_bottle
from visuohaptic.experiments.mission.contents import FORCES_N, ContentsModel
from visuohaptic.tasks.squeeze import SqueezeCurve


def felt(
    model: ContentsModel, state: str, scale: float, rng: np.random.Generator, place: int
) -> SqueezeCurve:
    """A squeeze of a bottle whose wall is stiffer by a factor than the model's, with the finger's noise."""
    where = model.places()[place]
    thing = model.things[state]
    d = np.linspace(0.0, 0.007, 400)
    lid = np.array([model.things["open"].force_at(where.height_m, float(x)) for x in d])
    force = np.array([thing.force_at(where.height_m, float(x)) for x in d]) + (scale - 1.0) * lid
    levels = np.array([level for level in FORCES_N if level <= force[-1]])
    depth = np.interp(levels, force, d)
    count = len(levels)
    read = levels + 0.025 * rng.standard_normal(count)
    return SqueezeCurve(where, read, depth + 1.5e-5 * rng.standard_normal(count), np.full(count, 1e-5), 0.03)


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("scale", [0.75, 1.0, 1.3])
def test_the_state_is_told_whatever_the_wall(state: str, scale: float) -> None:
    """The likelihood leaves the linear part open, so a wall that is off by a quarter changes no answer."""
    rng = np.random.default_rng(3)
    bottle = table_bottle(np.random.default_rng(20))
    model = ContentsModel(bottle.outline_m, bottle.wall_m)
    curves = [felt(model, state, scale, rng, place) for place in range(2)]
    told = model.probabilities(curves)
    assert sum(told.values()) == pytest.approx(1.0)
    assert max(told, key=lambda name: told[name]) == state
    assert told[state] > 0.9


def test_what_no_state_feels_like_is_not_told() -> None:
    """A wall that gives way under load: the force falls off where every state would rise."""
    bottle = table_bottle(np.random.default_rng(20))
    model = ContentsModel(bottle.outline_m, bottle.wall_m)
    where = model.places()[0]
    d = np.linspace(5e-4, 0.007, 10)
    curve = SqueezeCurve(where, 12.0 * np.sqrt(d / d[-1]), d, np.full(10, 1e-5), 0.03)
    assert model.probabilities([curve]) == {}
    assert model.probabilities([]) == {}


def test_places_are_where_the_states_differ_most_and_apart() -> None:
    bottle = table_bottle(np.random.default_rng(21))
    model = ContentsModel(bottle.outline_m, bottle.wall_m)
    places = model.places()
    first = [place.height_m for place in places if place.angle_rad == 0.0]
    assert len(places) == 2 * len(first) >= 4
    gaps = np.diff(np.sort(first))
    assert gaps.min() > 1.5 * model.height_m / 16
    # The soft waist allows the deepest squeeze; the firmest place allows the least.
    soft, firm = (model.things["open"].force_at(z, 1e-3) for z in (first[0], first[-1]))
    assert soft < firm


def test_the_model_is_the_bottle_on_the_table() -> None:
    bottle = table_bottle(np.random.default_rng(22))
    model = ContentsModel(bottle.outline_m, bottle.wall_m)
    z = 0.4 * bottle.height_m
    true = contained(bottle.outline_m, bottle.wall_m, bottle.state)
    assert model.things[bottle.state].force_at(z, 0.003) == pytest.approx(true.force_at(z, 0.003))
