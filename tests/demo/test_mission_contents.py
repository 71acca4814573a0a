"""Contents estimated from a firm squeeze of the mission's own bottle."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from visuohaptic.demo import TableBottle, filled_container, table_bottle
from visuohaptic.recognition.touch import FORCES_N, ContentsModel, SqueezeSamples
from visuohaptic.simulation.tabletop import KitchenTable
from visuohaptic.tasks.manipulation import Hand, contents_task, identify_contents


def model_of(bottle: TableBottle) -> ContentsModel:
    return ContentsModel(bottle.outline_m, bottle.wall_m)


def felt(
    bottle: TableBottle, closed: bool, fill: float, scale: float, rng: np.random.Generator, height_m: float
) -> SqueezeSamples:
    """A squeeze of a bottle whose wall is stiffer by a factor than the model's, with the finger's noise."""
    d = np.linspace(0.0, 0.007, 400)
    wall, whole = (
        np.array([one.force_at(height_m, float(x)) for x in d])
        for one in (
            filled_container(bottle.outline_m, bottle.wall_m, closed=False),
            filled_container(bottle.outline_m, bottle.wall_m, closed=closed, fill=fill),
        )
    )
    force = whole + (scale - 1.0) * wall
    levels = np.array([level for level in FORCES_N if level <= force[-1]])
    count = len(levels)
    read = levels + 0.025 * rng.standard_normal(count)
    return SqueezeSamples(height_m, np.interp(levels, force, d) + 1.5e-5 * rng.standard_normal(count), read)


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("fill", [0.0, 0.5])
@pytest.mark.parametrize("scale", [0.75, 1.3])
def test_the_contents_are_told_whatever_the_wall(closed: bool, fill: float, scale: float) -> None:
    """The likelihood leaves the linear part open, so a wall that is off by a quarter changes no answer."""
    rng = np.random.default_rng(3)
    bottle = table_bottle(np.random.default_rng(20))
    model = model_of(bottle)
    curves = [felt(bottle, closed, fill, scale, rng, z) for z in model.heights_m()[:2]]
    mass = filled_container(bottle.outline_m, bottle.wall_m, closed=closed, fill=fill).mass_kg
    told = model.posterior(curves, (mass, 0.002))
    assert told.belief()["closed" if closed else "open"] > 0.9
    mean, sigma = told.fill_of()
    assert abs(mean - fill) < min(3.0 * sigma, 0.1)


def test_places_are_where_the_states_differ_most_and_apart() -> None:
    model = model_of(table_bottle(np.random.default_rng(21)))
    heights = list(dict.fromkeys(model.heights_m()))
    assert len(heights) >= 2
    # Each again from the side, later than the first time.
    assert sorted(model.heights_m()) == sorted(2 * heights)
    assert np.diff(np.sort(heights)).min() > 1.5 * model.height_m / 16
    # The soft waist allows the deepest squeeze; the firmest place allows the least.
    soft, firm = (model.force_N(z, np.array([1e-3]), closed=False)[0] for z in (heights[0], heights[-1]))
    assert soft < firm


def test_the_model_feels_like_the_bottle_on_the_table() -> None:
    """Two ways to the same physics: the table's curves between 25 depths, the robot's formula; 1 % is theirs."""
    bottle = table_bottle(np.random.default_rng(22))
    model = model_of(bottle)
    z = 0.6 * bottle.height_m
    fill = 0.3
    true = filled_container(bottle.outline_m, bottle.wall_m, closed=True, fill=fill)
    # Below the level the model adds the liquid's pressure, which the table leaves out.
    assert z > fill * bottle.height_m
    force = model.force_N(z, np.array([0.003]), closed=True, fill=fill)[0]
    assert force == pytest.approx(true.force_at(z, 0.003), rel=0.01)
    assert model.mass_kg(fill)[0] == pytest.approx(true.mass_kg, rel=0.01)


def test_what_slips_at_the_first_place_is_weighed_at_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fingers slip in the first lift only; without a load sensor it is squeezed once and nothing is claimed."""
    bottle = table_bottle(np.random.default_rng(20))
    model, lift, lifts = model_of(bottle), contents_task.weigh, []

    def weigh(*given: Any) -> tuple[float, float] | None:
        mass = lift(*given)
        lifts.append(mass)
        return mass if len(lifts) > 1 else None

    monkeypatch.setattr(contents_task, "weigh", weigh)
    table = KitchenTable(bottle.container, np.random.default_rng(0))
    hand = Hand(table.arm, table, table, table.feel, table.weigh)
    found = identify_contents(hand, model, (*table.place_m, 0.0))
    assert found.mass_kg is not None
    assert abs(found.mass_kg[0] - bottle.container.mass_kg) < 4.0 * found.mass_kg[1]
    assert len(lifts) == 2
    assert len({curve.place for curve in found.curves}) == len(found.curves) >= 2
    blind = identify_contents(replace(hand, weigh=None), model, (*table.place_m, 0.0))
    assert blind.mass_kg is None
    assert len(blind.curves) == 1
