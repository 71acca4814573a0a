"""Steering holds what turns away, and learns the centre of friction."""

from __future__ import annotations

import numpy as np
import pytest
from tests.navigation.plan_scenes import box, rooms

from visuohaptic.core import InputError
from visuohaptic.navigation.pushing import PushModel
from visuohaptic.simulation.floor import FloorObject, FloorWorld
from visuohaptic.tasks.mobile import PushEnd, PushSettings, SteeredPush

pytest.importorskip("mujoco")


def push(offset, *, seen=True, mass=3.0, length_m=0.8, contact_friction=0.3, max_force_N=20.0):
    outline = box(2.0, 1.5, 0.3)
    item = FloorObject(
        "box", outline, mass, 0.3, contact_friction=contact_friction, centre_offset_m=(0.0, offset)
    )
    world = FloorWorld(rooms(5, 3, []), [item], (1.63, 1.5, 0.0))
    lever = PushModel.patch(outline - outline.mean(axis=0)).lever_m
    run = SteeredPush(
        np.array([1.63, 1.5]), 0.0, length_m,
        object_m=world.item_pose_m("box") if seen else None, lever_m=lever,
        settings=PushSettings(max_force_N=max_force_N),
    )  # fmt: skip
    while run.end is None:
        touch = world.touch
        force, point = (touch.force_N, touch.point_m) if touch else (0.0, None)
        look = world.item_pose_m("box") if seen else None
        world.base.drive(*run.command(world.t_s, world.pose_m(), force, point, look))
        world.step(0.02)
    return run, world


@pytest.mark.parametrize("offset", [-0.04, 0.02, 0.04])
def test_it_turns_less_than_a_straight_push(offset):
    steered, world = push(offset)
    straight, other = push(offset, seen=False)
    assert steered.end is PushEnd.DONE
    assert abs(world.item_pose_m("box")[2]) < 0.5 * abs(other.item_pose_m("box")[2])
    # Of the sign, and at least a third of the truth: what sticks to the rim tells less.
    told = steered.centre_beside_m()
    assert told is not None
    assert 0.3 < told / offset < 1.3
    assert straight.centre_beside_m() is None


def test_force_is_friction():
    run, world = push(0.0)
    assert run.force_N[1] == pytest.approx(world.items[0].friction_N, rel=0.15)


def test_ends():
    # 44 N of friction: the wheels slip at 20 N, which a limit above never notices.
    assert push(0.0, mass=15.0, max_force_N=100.0)[0].end is PushEnd.STALLED
    assert push(0.0, mass=15.0)[0].end is PushEnd.TOO_HEAVY
    nothing = SteeredPush(np.zeros(2), 0.0, 0.5, settings=PushSettings(search_m=0.1))
    t = x = 0.0
    while nothing.end is None:
        speed, _ = nothing.command(t, np.array([x, 0.0, 0.0]), 0.0, None, None)
        t, x = t + 0.02, x + 0.02 * speed
    assert nothing.end is PushEnd.MISSED
    assert not nothing.touched
    assert np.isnan(nothing.force_N[0])
    with pytest.raises(InputError, match="expected more than 0"):
        PushSettings(speed_m_s=0.0)
