"""Two robots and what they share, driven at random: no acknowledged observation and no deletion is lost.

The model is a list of what was acknowledged, with a clock that counts. It knows nothing of how versions are merged, only
what was promised: whoever acted last on an object is right in the end, and an observation is kept until its object
is deleted. What is added without a time by a robot that has not heard of a deletion is neither before nor after it.
"""

from __future__ import annotations

import shutil
import tempfile
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

pytest.importorskip("sqlalchemy")
pytest.importorskip("pyarrow")

from visuohaptic.core import (
    DatabaseError,
    Estimate,
    Evidence,
    HapticTag,
    Provenance,
    VisuoHapticObject,
    cards,
)
from visuohaptic.database import (
    Connections,
    ObjectDatabase,
    Synchronised,
    add_evidence,
    open_database,
    synchronise,
)

ROBOTS, IDS = st.sampled_from(["one", "two"]), st.sampled_from(["cup", "jar"])


class Robots(RuleBasedStateMachine):
    """Databases of two robots beside one that they share."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp())
        self.open: dict[str, ObjectDatabase] = {}
        for name in ("one", "two", "shared"):
            self.open[name] = open_database(self.folder / name)
        self.clock = 0.0
        self.last: dict[str, bool] = {}  #: by object: whether the last act was to add it
        self.here: dict[
            tuple[str, str], set[str]
        ] = {}  #: by robot and object: keys felt here since a deletion here
        self.felt: dict[str, set[str]] = {}  #: by object: all that was felt since the last deletion anywhere
        self.heard: dict[str, set[str]] = {}  #: by object: databases that have heard of its last deletion

    def teardown(self) -> None:
        for _ in range(2):
            for robot in ("one", "two"):
                synchronise(self.open[robot], self.open["shared"])
        for object_id, alive in self.last.items():
            for name, db in self.open.items():
                assert (object_id in db) == alive, f"{object_id} in {name}"
                if alive:
                    kept = {one.key for one in db.get(object_id).evidence}
                    assert self.felt[object_id] <= kept, f"{object_id} in {name}"
            if alive:
                texts = {cards.card_text(cards.encode(db.get(object_id))[0]) for db in self.open.values()}
                assert len(texts) == 1
        assert all(db.check().problems == () for db in self.open.values())
        for db in self.open.values():
            db.close()
        shutil.rmtree(self.folder)

    @rule(robot=ROBOTS, object_id=IDS)
    def feel(self, robot: str, object_id: str) -> None:
        self.clock += 1.0
        key = f"contact {self.clock}"
        evidence = Evidence(
            "tag.stiffness_N_per_m", Estimate(100.0 + self.clock, 5.0), Provenance("felt", self.clock), key
        )
        self.open[robot].add(add_evidence(VisuoHapticObject(object_id), evidence))
        self._added(robot, object_id, key)

    @rule(robot=ROBOTS, object_id=IDS, fixed=st.booleans())
    def add_without_a_time(self, robot: str, object_id: str, fixed: bool) -> None:
        self.clock += 1.0
        self.open[robot].add(VisuoHapticObject(object_id, tag=HapticTag(fixed=fixed)))
        if robot in self.heard.get(object_id, {robot}) or self.last.get(object_id):
            self._added(robot, object_id, None)
        else:
            self.last.pop(object_id, None)

    def _added(self, robot: str, object_id: str, key: str | None) -> None:
        self.last[object_id] = True
        for known in (
            self.here.setdefault((robot, object_id), set()),
            self.felt.setdefault(object_id, set()),
        ):
            known |= {key} - {None}

    @rule(robot=ROBOTS, object_id=IDS)
    def remove(self, robot: str, object_id: str) -> None:
        self.clock += 1.0
        db = self.open[robot]
        if object_id in db:
            db.remove(object_id, t_s=self.clock)
            assert object_id not in db
            self.last[object_id] = False
            self.heard[object_id] = {robot}
            self.here[robot, object_id] = set()
            self.felt[object_id] = set()

    @rule(robot=ROBOTS)
    def meet(self, robot: str) -> None:
        synchronise(self.open[robot], self.open["shared"])
        for heard in self.heard.values():
            heard |= {robot, "shared"} if heard & {robot, "shared"} else set()
        # Another one's deletion may have come with it: what is left is looked at in the end.
        self.here = {pair: set() for pair in self.here}
        again = synchronise(self.open[robot], self.open["shared"])
        assert again.received == 0

    @rule(name=st.sampled_from(["one", "two", "shared"]))
    def reopen(self, name: str) -> None:
        self.open[name].close()
        self.open[name] = open_database(self.folder / name)

    @rule()
    def back_up(self) -> None:
        self.open["shared"].close()
        shutil.rmtree(self.folder / "backup", ignore_errors=True)
        shutil.copytree(self.folder / "shared", self.folder / "backup")
        self.open["shared"] = open_database(self.folder / "shared")

    @precondition(lambda self: (self.folder / "backup").exists())
    @rule()
    def restore(self) -> None:
        """What the robots hold comes back with them."""
        self.open["shared"].close()
        shutil.rmtree(self.folder / "shared")
        shutil.copytree(self.folder / "backup", self.folder / "shared")
        self.open["shared"] = open_database(self.folder / "shared")
        for heard in self.heard.values():
            heard.discard("shared")  # it may be that it still has

    @invariant()
    def what_was_acknowledged_is_there(self) -> None:
        for (robot, object_id), keys in self.here.items():
            if keys:
                assert keys <= {one.key for one in self.open[robot].get(object_id).evidence}


Robots.TestCase.settings = settings(
    max_examples=12, stateful_step_count=14, deadline=None, suppress_health_check=list(HealthCheck)
)
TestRobots = Robots.TestCase


def test_what_is_added_after_a_deletion_stays_when_robots_meet(tmp_path: Path) -> None:
    """Also when nothing of it has a time: somebody has added it, and knew what he did."""
    with open_database(tmp_path / "one") as one, open_database(tmp_path / "shared") as shared:
        one.add(VisuoHapticObject("cup", tag=HapticTag(fixed=True)))
        synchronise(one, shared)
        one.remove("cup")
        synchronise(one, shared)
        assert "cup" not in shared
        one.add(VisuoHapticObject("cup", tag=HapticTag(fixed=False)))
        synchronise(one, shared)
        assert "cup" in one
        assert "cup" in shared
        one.remove("cup")
        synchronise(one, shared)
        assert "cup" not in one
        assert "cup" not in shared


def test_a_shared_database_restored_from_a_backup_gets_everything_again(tmp_path: Path) -> None:
    """Its numbers of changes are given a second time: what was sent is not there, and what is new has numbers that are known."""
    with open_database(tmp_path / "one") as one, open_database(tmp_path / "two") as two:
        with open_database(tmp_path / "shared") as shared:
            for robot, name in ((one, "cup"), (two, "jar")):
                robot.add(VisuoHapticObject(name))
                synchronise(robot, shared)
        shutil.copytree(tmp_path / "shared", tmp_path / "backup")
        with open_database(tmp_path / "shared") as shared:
            one.add(VisuoHapticObject("lost"))
            synchronise(one, shared)
        shutil.rmtree(tmp_path / "shared")
        with open_database(tmp_path / "backup") as shared:
            for name in ("bowl", "pan"):  # as many changes as were lost, and one more
                two.add(VisuoHapticObject(name))
                synchronise(two, shared)
            for robot in (one, two):
                synchronise(robot, shared)
            names = {"cup", "jar", "lost", "bowl", "pan"}
            assert [{found.id for found in db.summaries()} for db in (one, two, shared)] == [names] * 3
            assert synchronise(one, shared) == Synchronised(0, 0)


def test_a_synchronisation_that_stops_at_any_write_is_simply_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writing = Connections.writing
    for stop in range(20):
        left = [stop]

        def until(self: Connections, left: list[int] = left) -> AbstractContextManager[Any]:
            left[0] -= 1
            if left[0] == -1:
                raise DatabaseError("the power fails")
            return writing(self)

        with (
            open_database(tmp_path / f"one{stop}") as one,
            open_database(tmp_path / f"shared{stop}") as shared,
        ):
            one.add(VisuoHapticObject("cup"))
            synchronise(one, shared)
            one.add(VisuoHapticObject("jar"))
            shared.add(VisuoHapticObject("pan"))
            with monkeypatch.context() as patch, suppress(DatabaseError):
                patch.setattr(Connections, "writing", until)
                synchronise(one, shared)
            synchronise(one, shared)
            assert [{found.id for found in db.summaries()} for db in (one, shared)] == [
                {"cup", "jar", "pan"}
            ] * 2
            assert synchronise(one, shared) == Synchronised(0, 0)
        if left[0] >= 0:  # it had fewer writes
            break
    assert 3 < stop < 19


def test_an_object_felt_by_a_fast_clock_can_be_deleted(tmp_path: Path) -> None:
    with open_database(tmp_path / "one") as one:
        later = Provenance("felt", 4e9)  # the year 2096
        evidence = Evidence("tag.stiffness_N_per_m", Estimate(100.0, 5.0), later)
        one.add(add_evidence(VisuoHapticObject("cup"), evidence))
        one.remove("cup")
        assert "cup" not in one
