"""The state machine of all tasks: order, time-outs, endings, and traces that can be replayed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import ClassVar

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from visuohaptic.core import InputError, from_dict, to_dict
from visuohaptic.tasks.framework import Ending, Machine, Rule, Step, Trace, replay


class State(StrEnum):
    WAIT = "wait"
    PUSH = "push"
    BACK = "back"


class Look(StrEnum):
    CLEAR = "clear"
    BLIND = "blind"


@dataclass(frozen=True, slots=True)
class Seen:
    t_s: float
    force_N: float
    look: Look = Look.CLEAR
    place_m: tuple[float, float] = (0.0, 0.0)
    path_m: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Told:
    speed_m_s: float


class Push(Machine[State, Seen, Told]):
    """Waits for a touch, pushes until 2 N, backs off for a second; may jump wrongly when told so."""

    task = "push"
    rules: ClassVar = {
        State.WAIT: Rule((State.PUSH,), 5.0),
        State.PUSH: Rule((State.BACK,), 1.0),
        State.BACK: Rule(),
    }

    def __init__(self, limit_N: float = 2.0, jump: bool = False) -> None:
        super().__init__({"limit_N": limit_N})
        self.limit_N, self.jump = limit_N, jump

    def decide(self, seen: Seen) -> Told:
        if self.jump:
            self.go(State.BACK, "by mistake")
        if seen.look is Look.BLIND:
            self.end(False, "blind", "nothing seen")
        elif self.state is State.WAIT and seen.force_N > 0:
            self.go(State.PUSH, "touched")
        elif self.state is State.PUSH and seen.force_N > self.limit_N:
            self.go(State.BACK, f"{seen.force_N:g} N")
        elif self.state is State.BACK and self.since_s(seen.t_s) >= 1.0:
            self.end(True, "pushed", "backed off")
        return Told({State.WAIT: 0.1, State.PUSH: 0.05, State.BACK: -0.1}[self.state])

    def halt(self) -> Told:
        return Told(0.0)


def run(machine: Push, forces_N: list[float], dt_s: float = 0.5) -> list[float]:
    return [machine.step(Seen(k * dt_s, force)).speed_m_s for k, force in enumerate(forces_N)]


def test_states_follow_and_the_end_stands_still() -> None:
    machine = Push()
    assert run(machine, [0, 1, 3, 0, 0]) == pytest.approx([0.1, 0.05, -0.1, -0.1, 0.0])
    assert machine.trace().states() == ("wait", "push", "back")
    assert machine.ending == Ending(True, "pushed", "backed off")
    assert machine.trace().story()[0].endswith("wait -> push: touched")
    with pytest.raises(InputError, match=r"has ended \(pushed\)"):
        machine.step(Seen(9.0, 0.0))


def test_a_state_that_takes_too_long_ends_with_the_robot_at_rest() -> None:
    machine = Push()
    assert run(machine, [0, 1, 1, 1, 1])[-1] == 0.0
    assert machine.ending == Ending(False, "timed_out", "push took longer than 1 s")


def test_a_failure_leads_where_the_rule_says_and_as_often() -> None:
    class Retry(Machine[State, Seen, Told]):
        task = "retry"
        rules: ClassVar = {
            State.WAIT: Rule((State.PUSH,)),
            State.PUSH: Rule((State.WAIT,), 1.0, State.WAIT, 2),
        }

        def decide(self, seen: Seen) -> Told:
            if self.state is State.WAIT:
                self.go(State.PUSH, "now")
            elif seen.force_N < 1.0:
                self.fail("missed", f"{seen.force_N} N")
            return Told(0.1)

        def halt(self) -> Told:
            return Told(0.0)

    task = Retry()
    for t_s in (0.0, 1.0, 2.0, 3.0, 4.0, 5.0):
        assert not task.ended
        task.step(Seen(t_s, 0.0))
    assert task.ending == Ending(False, "missed", "0.0 N")
    assert task.trace().states() == ("wait", "push", "wait", "push", "wait", "push")
    late = Retry()
    for t_s in (0.0, 5.0, 6.0):  # a time-out is a failure, too
        late.step(Seen(t_s, 0.0))
    assert not late.ended
    assert "timed_out: push took longer than 1 s; another attempt" in late.trace().story()[1]


def test_a_change_that_no_rule_allows_is_an_error_of_the_task() -> None:
    with pytest.raises(InputError, match=r"from wait to back, expected one of \['push'\]"):
        Push(jump=True).step(Seen(0.0, 0.0))


@pytest.mark.parametrize("t_s", [0.5, 0.4, math.nan])
def test_late_and_repeated_observations_change_nothing(t_s: float) -> None:
    machine = Push()
    run(machine, [0.0, 0.0])
    assert machine.step(Seen(t_s, 5.0)) == Told(0.0)
    assert machine.state is State.WAIT
    assert len(machine.trace().steps) == 2


# On a loaded machine drawing inputs alone may take longer than hypothesis likes.
@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(
        st.tuples(
            st.floats(0.001, 2.0), st.floats(allow_nan=True, allow_infinity=True), st.sampled_from(list(Look))
        ),
        max_size=30,
    ),
    st.floats(0.1, 10.0),
)
def test_every_trace_reads_back_and_replays(
    observed: list[tuple[float, float, Look]], limit_N: float
) -> None:
    machine, t_s = Push(limit_N), 0.0
    for wait_s, force, look in observed:
        t_s += wait_s
        machine.step(Seen(t_s, force, look, (force, t_s), ((t_s, -force),)))
        if machine.ending is not None:
            break
    trace = Trace.from_lines(machine.trace().lines())
    assert trace == machine.trace()
    fresh = Push(limit_N)
    assert replay(trace, fresh, Seen) == machine.ending
    assert fresh.trace() == trace


def test_a_replay_that_differs_says_where(tmp_path: Path) -> None:
    machine = Push(2.0)
    run(machine, [0, 1, 3])
    machine.trace().save(tmp_path / "push.jsonl")
    with pytest.raises(InputError, match=r"step 2 at 1.000 s: found .* state push, expected .* and back"):
        replay(Trace.load(tmp_path / "push.jsonl"), Push(4.0), Seen)
    with pytest.raises(InputError, match="found a trace of 'other', expected one of 'push'"):
        replay(Trace("other", {}, (), None), Push(), Seen)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([], "line 1: expected a head"),
        (["{"], "line 1: is not JSON"),
        (["[1]"], "line 1: found list, expected an object"),
        (['{"task": "push"}'], "line 1: expected a head"),
        (['{"task": "push", "settings": {}}', "{}"], "line 2: t_s: is missing"),
        (['{"task": "p", "settings": {}}', '{"ending": 3}'], "ending: found 3, expected a mapping"),
        (
            ['{"task": "p", "settings": {}}',
             '{"t_s": "x", "state": "", "observation": {}, "command": {}, "next_state": "", "why": ""}'],
            "line 2: t_s: found 'x', expected a finite number",
        ),
    ],
)  # fmt: skip
def test_what_is_no_trace_is_refused(lines: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Trace.from_lines(lines)


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bad.jsonl").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"is not UTF-8 text \(byte 0\)"):
        Trace.load(tmp_path / "bad.jsonl")


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("look", "dark", "expected one of"),
        ("place_m", [1.0], r"found \[1.0\], expected a list of 2"),
        ("force_N", True, "True"),
    ],
)
def test_wrong_values_are_refused(field: str, value: object, message: str) -> None:
    row = dict(to_dict(Seen(0.0, 1.0))) | {field: value}
    with pytest.raises(InputError, match=message):
        from_dict(Seen, row)


def test_only_plain_values_are_written() -> None:
    with pytest.raises(InputError, match="found set"):
        to_dict({"a": {1, 2}})
    assert to_dict(Step(math.inf, "a", {}, {}, "b", ""))["t_s"] == "inf"
