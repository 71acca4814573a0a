"""Contact, motion and release on deflections with known truth."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import Contact, ErrorBudget, Event, EventKind, ForceProfile, InputError, Reason
from visuohaptic.sensing.push import ContactEvents, DeflectionEvents, events

SIGMA = 2e-5
FRAME = 1 / 30


def _push(rng: np.random.Generator, drop: float = 0.0) -> list[tuple[float, EventKind]]:
    """Touch at 0.5 s, motion at 5 mm, contact lost when the robot backs off from 3 s on; 20 mm/s."""
    machine, raised = DeflectionEvents(), []
    for i in range(150):
        t = i * FRAME
        travel = 0.02 * min(t, 3.0) - 0.02 * max(t - 3.0, 0.0)
        deflection = float(np.clip(travel - 0.01, 0, 0.005))
        if t > 3.0:
            deflection = max(0.005 - 0.02 * (t - 3.0), 0.0)
        if rng.random() < drop:
            continue
        noisy = deflection + SIGMA * rng.standard_normal()
        raised += [(t, e.t_s, e.kind) for e in machine.update(t, noisy, SIGMA, travel)]
    return raised


@pytest.mark.parametrize("drop", [0.0, 0.3])
def test_a_push_raises_its_three_events_in_order_and_in_time(drop: float) -> None:
    for seed in range(20):
        raised = _push(np.random.default_rng(seed), drop)
        assert [kind for _, _, kind in raised] == [EventKind.CONTACT, EventKind.MOTION, EventKind.RELEASE]
        late = 2 + round(8 * drop)  # frames; a gap of g frames delays by g
        for (decided, stamp, _), truth in zip(raised, (0.5, 0.75, 3.25), strict=True):
            assert abs(stamp - truth) <= (late + 0.5) * FRAME
            # Motion is decided after 2 mm of travel, 3 frames at this speed, and four frames.
            assert decided - truth <= (late + 5) * FRAME


def test_noise_alone_raises_nothing() -> None:
    rng = np.random.default_rng(0)
    machine = DeflectionEvents()
    # Five sigma twice in a row: 1e-13 a frame.
    assert not any(machine.update(i * FRAME, SIGMA * rng.standard_normal(), SIGMA, 0.0) for i in range(20000))


def test_a_fixed_object_never_moves() -> None:
    rng = np.random.default_rng(0)
    machine, kinds = DeflectionEvents(), []
    for i in range(100):
        travel = 0.0007 * i
        value = 0.6 * max(travel - 0.01, 0) + SIGMA * rng.standard_normal()
        kinds += [event.kind for event in machine.update(i * FRAME, value, SIGMA, travel)]
    assert kinds == [EventKind.CONTACT]


def test_a_contact_that_lasts_holds_no_more_memory_and_still_tells_motion() -> None:
    """The platform stands and presses for ten minutes, drives on, and the object moves."""
    rng = np.random.default_rng(0)
    machine, raised = DeflectionEvents(), []
    still = 18_000
    for i in range(still + 300):
        driven = min(0.001 * i, 0.004) + 0.001 * max(i - still, 0)
        deflection = min(driven, 0.006) + SIGMA * rng.standard_normal()
        raised += machine.update(i * FRAME, deflection, SIGMA, driven)
        assert len(machine._window) <= events._MAX_WINDOW
        assert len(machine._deeper) < 50  # records of independent noise grow as the logarithm of their number
    assert [event.kind for event in raised] == [EventKind.CONTACT, EventKind.MOTION]
    assert abs(raised[1].t_s - (still + 2) * FRAME) < 3 * FRAME
    assert len(machine._window) == 1  # an object that moves already needs no more of them


def test_an_object_that_runs_ahead_has_moved() -> None:
    """An open door: a short touch, then the foam is free again although the platform goes on."""
    machine, kinds = DeflectionEvents(), []
    for i, value in enumerate([0, 0, 3e-4, 4e-4, 2e-4, 0, 0, 0]):
        kinds += [event.kind for event in machine.update(i * FRAME, value, SIGMA, 0.0007 * i)]
    assert kinds == [EventKind.CONTACT, EventKind.MOTION, EventKind.RELEASE]


def test_without_odometry_the_first_rise_stands_in_for_the_speed() -> None:
    machine, kinds = DeflectionEvents(), []
    for i in range(60):
        value = min(max(0.0007 * (i - 10), 0), 0.005)
        kinds += [event.kind for event in machine.update(i * FRAME, value, SIGMA)]
    assert kinds == [EventKind.CONTACT, EventKind.MOTION]


def test_late_and_repeated_frames_change_nothing() -> None:
    machine = DeflectionEvents()
    assert machine.update(1.0, 0.002, SIGMA, 0.0) == ()
    assert machine.update(1.0, 0.002, SIGMA, 0.0) == ()
    assert machine.update(0.9, 0.002, SIGMA, 0.0) == ()
    assert [e.kind for e in machine.update(1.1, 0.002, SIGMA, 0.0)] == [EventKind.CONTACT]


def _profile(
    t_s: float, depths: dict[float, float], reason: Reason = Reason.OK, *, force_N: float = 1.0
) -> ForceProfile:
    """A strip of 25 cm with contacts of 4 cm at the given places; their forces are off by 10 mN."""
    s = np.linspace(0, 0.25, 85)
    delta, found = np.zeros(85), []
    for centre, depth in depths.items():
        inside = np.abs(s - centre) < 0.02
        delta[inside] = depth
        if depth > 1e-4:
            points = np.column_stack([0.02 - delta[inside], s[inside]])
            sigma = np.full(inside.sum(), SIGMA)
            found.append(
                Contact(
                    s_start_m=centre - 0.02, s_end_m=centre + 0.02, force_N=force_N, budget=ErrorBudget(0.01),
                    valid=True, reason=reason, points_foam_m=points, point_sigma_m=sigma,
                    delta_m=delta[inside],
                )
            )  # fmt: skip
    return ForceProfile(
        t_s=t_s, valid=reason == Reason.OK, reason=reason, force_N=1.0, budget=ErrorBudget(0.01), s_m=s,
        delta_m=delta, delta_sigma_m=np.full(85, SIGMA), pressure_Pa=np.zeros(85),
        pressure_sigma_Pa=np.zeros(85), point_valid=np.ones(85, dtype=bool), contacts=tuple(found),
    )  # fmt: skip


def test_every_region_has_its_own_events() -> None:
    events, raised = ContactEvents(), []
    for i in range(40):
        first = 0.001 if i >= 5 else 0.0
        second = 0.001 if 15 <= i < 25 else 0.0
        raised += events.update(_profile(i * FRAME, {0.05: first, 0.18: second}), travel_m=0.0)
    assert [(e.kind, round(e.s_m, 2)) for e in raised] == [
        (EventKind.CONTACT, 0.05), (EventKind.CONTACT, 0.18), (EventKind.RELEASE, 0.18),
    ]  # fmt: skip
    assert events.in_contact
    assert not events.moving


def test_a_ripple_beside_what_presses_does_not_take_its_region() -> None:
    """Something fixed is pressed ever deeper; once, its contact is narrower and a ripple comes up 2.5 cm beside it."""
    events, raised = ContactEvents(), []
    for i in range(30):
        travel = 1e-3 * i
        depths = {0.07: travel - 0.005, 0.10: travel - 0.005}
        if i == 15:
            depths = {0.025: 2e-4, 0.10: travel - 0.005}
        if i > 15:
            depths = {0.10: travel - 0.005}
        raised += events.update(_profile(i * FRAME, depths), travel_m=travel)
    assert [e.kind for e in raised] == [EventKind.CONTACT]


@pytest.mark.parametrize(("force_N", "felt"), [(0.04, False), (0.06, True)])
def test_points_that_are_off_together_are_no_contact(force_N: float, felt: bool) -> None:
    """A shade lifts a whole region by ten deviations of a point for four frames: nothing was there to run ahead."""
    events, raised = ContactEvents(), []
    for i in range(20):
        depth = 2e-4 if 5 <= i < 9 else 0.0
        raised += events.update(_profile(i * FRAME, {0.1: depth}, force_N=force_N), travel_m=0.0007 * i)
    kinds = [EventKind.CONTACT, EventKind.MOTION, EventKind.RELEASE] if felt else []
    assert [e.kind for e in raised] == kinds


def test_frames_without_a_contour_are_passed_over() -> None:
    events, raised = ContactEvents(), []
    for i in range(20):
        occluded = 8 <= i < 14
        depth = 0.0 if occluded or i < 3 else 0.001
        reason = Reason.OCCLUDED if occluded else Reason.OK
        raised += events.update(_profile(i * FRAME, {0.1: depth}, reason), speed_m_s=0.0)
    assert [e.kind for e in raised] == [EventKind.CONTACT]


def test_falls_are_passed_through_and_others_refused() -> None:
    events = ContactEvents()
    fall = Event(EventKind.FALL, 0.1)
    assert events.update(_profile(0.1, {}), external=[fall]) == (fall,)
    with pytest.raises(InputError, match="found event 'contact', expected fall or slip"):
        events.update(_profile(0.2, {}), external=[Event(EventKind.CONTACT, 0.1)])
