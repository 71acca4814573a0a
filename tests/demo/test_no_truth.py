"""What the robot decides rests on its measurements: the physical truth is read by worlds and judges only."""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

import visuohaptic.demo
from visuohaptic.demo import Mission, place_bottle
from visuohaptic.demo.floor_chapters import default_door, default_map
from visuohaptic.demo.touch_chapters import choose_objects

pytest.importorskip("mujoco")

#: Physical properties that true objects have, and what the robot measured of them.
PROPERTIES = {
    "mass_kg", "friction", "static_ratio", "static_friction_N", "dynamic_friction_N", "movable", "fixed", "fill",
    "closed", "wall_m", "stiffness_N_per_m",
}  # fmt: skip
MEASURED = {"known", "remembered", "belief", "contents", "curve", "tag", "felt", "surface", "axes"}
#: Calls that compare with the truth, and functions that make a world or judge one.
COMPARED, APART = {"Claim", "Measure"}, {"_world", "tag_claims", "_against_truth", "default_tags"}


def reads(node: ast.AST, function: str = "") -> Iterator[str]:
    """Reads of a property of what was not measured."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Call) and isinstance(child.func, ast.Name) and child.func.id in COMPARED:
            continue
        if isinstance(child, ast.FunctionDef) and child.name in APART:
            continue
        inside = child.name if isinstance(child, ast.FunctionDef) else function
        if isinstance(child, ast.Attribute) and child.attr in PROPERTIES:
            owner = ast.unparse(child.value).split(".")[-1]
            if owner not in MEASURED:
                yield f"{inside}: {ast.unparse(child)}"
        yield from reads(child, inside)


def test_chapters_decide_without_the_truth() -> None:
    folder = Path(visuohaptic.demo.__file__).parent
    found = {
        path.name: list(reads(ast.parse(path.read_text(encoding="utf-8"))))
        for path in folder.glob("*_chapters.py")
    }
    assert len(found) == 5
    # The judge's own values, gathered before its claims.
    allowed = {"hand_chapters.py": ["_contents_claims: bottle.closed"]}
    assert {name: one for name, one in found.items() if one} == allowed


def test_a_choice_by_true_mass_would_be_found() -> None:
    leak = "def order(paths):\n    return sorted(paths, key=lambda one: one.obstacle.mass_kg)\n"
    assert list(reads(ast.parse(leak))) == ["order: one.obstacle.mass_kg"]


def test_the_object_to_touch_does_not_depend_on_its_mass(tmp_path: Path) -> None:
    """The only one that is touched is one that the plan would explore, whatever the objects weigh."""
    chosen = []
    for heavier in (1.0, 100.0):
        mission = Mission(1, tmp_path, obstacles=1)
        default_map(mission)
        default_door(mission)
        first, *others = mission.house.obstacles
        moved = (replace(first, mass_kg=heavier * first.mass_kg), *others)
        mission.house = replace(mission.house, obstacles=moved)
        chosen.append(choose_objects(mission, [one for one, _ in mission.known.obstacles])[0])
    assert chosen[0] == chosen[1]
    assert len(chosen[0]) == 1


def test_objects_are_touched_in_the_order_of_their_benefit(tmp_path: Path) -> None:
    """Of the three in the office's door, one alone opens no passage: it comes last, though it is the nearest."""
    mission = Mission(2, tmp_path, obstacles=3)
    default_map(mission)
    default_door(mission)
    unknown = [one for one, _ in mission.known.obstacles]
    order, tour = choose_objects(mission, unknown)
    assert sorted(order) == [0, 1, 2]
    names = [f"new {k + 1}" for k in order]
    assert names[: len(tour.steps)] == [step.object for step in tour.steps]
    assert names[len(tour.steps) :] == list(tour.left_out) == ["new 2"]
    away_m = [math.dist(mission.known.pose[:2], tuple(one.centre_m)) for one in unknown]
    assert away_m.index(min(away_m)) == order[-1]
    # Half of the unknown objects move; the second opens a passage only where the first has not.
    assert [step.opens for step in tour.steps] == pytest.approx(
        [0.5**k for k in range(1, len(tour.steps) + 1)]
    )


@pytest.mark.parametrize("place", [0, 1])
def test_what_stands_on_the_table_belongs_to_the_world_and_the_day(tmp_path: Path, place: int) -> None:
    """With contents by the robot's seed, every world of the demo had the same lid and filling, and a second attempt another one."""

    def contents(seed: int, world: int, visit: int = 0, attempt: int = 0) -> tuple[bool, float, float]:
        mission = Mission(seed, tmp_path, world=world, visit=visit).at(place)
        mission.attempt = attempt
        bottle = place_bottle(mission)
        return bottle.closed, bottle.fill, bottle.container.mass_kg

    assert contents(1, 612) == contents(2, 612) == contents(2, 612, attempt=1)
    assert len({contents(2, world) for world in (612, 618, 624)}) == 3
    assert len({contents(1, 612, visit) for visit in range(4)}) > 1
    assert contents(1, 612, visit=1) == contents(3, 612, visit=1)
