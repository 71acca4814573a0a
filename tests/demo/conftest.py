"""A hand without pictures, for tests of what the chapters decide."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from visuohaptic.core import Frame
from visuohaptic.demo import Mission, hand_chapters, served
from visuohaptic.simulation.tabletop import KitchenTable
from visuohaptic.tasks.framework import SafetyLimits, Supervisor
from visuohaptic.tasks.manipulation import Hand


@dataclass
class PlainHand(KitchenTable):
    """The world of the mission's hand, whose force and load are numbers with noise instead of views of foam and beam."""

    wrist: Any = None  # the beam of a hand with pictures
    wrist_camera: ClassVar = SimpleNamespace(virtual=SimpleNamespace(camera=None))

    def wrist_frame(self) -> Frame:
        return Frame(self.image(self.arm.t_s), self.arm.t_s, 0)


#: Foam of a finger: 6 N/mm before a flat wall.
_FOAM = SimpleNamespace(slope=lambda strain: np.full(len(strain), 1e5), height_m=0.015, width_m=0.015)
FINGER = SimpleNamespace(
    setup=SimpleNamespace(material=_FOAM, geometry=SimpleNamespace(s_m=np.linspace(0.0, 0.06, 61)))
)


@pytest.fixture
def plain_hand(monkeypatch: pytest.MonkeyPatch) -> type[PlainHand]:
    """Missions have this hand, under the same supervisor; nothing is rendered."""

    def hand_of_mission(mission: Mission) -> tuple[Any, Hand]:
        if mission.hand is None:
            mission.known.finger, mission.known.wrist = FINGER, object()  # zeroed: no file, no image at rest
            mission.hand = mission.opened.enter_context(served.robot_at_table(mission, "hand"))
        robot, table = mission.hand, mission.kitchen
        guard = Supervisor(
            SafetyLimits(max_force_N=hand_chapters.MAX_GRIP_N), clock=lambda: robot.arm.pose()[0]
        )
        arm, gripper, frames = guard.arm(robot.arm), guard.gripper(robot.gripper), guard.frames(robot.camera)
        return robot, Hand(arm, gripper, frames, guard.force(table.feel), table.weigh)

    monkeypatch.setattr(served, "VirtualHand", PlainHand)
    monkeypatch.setattr(hand_chapters, "hand_of_mission", hand_of_mission)
    return PlainHand
