"""The push world against Newton and Coulomb."""

from __future__ import annotations

import math

import numpy as np
import pytest

from visuohaptic.core import EventKind, FrameSource, InputError, MobileBase
from visuohaptic.core.measurement import GRAVITY_M_S2
from visuohaptic.simulation.foam import FoamStripGeometry
from visuohaptic.simulation.mobile import (
    FoamPushWorld,
    PlatformConfig,
    PushTruth,
    SimulatedObstacle,
    SimulatedSensorCamera,
    box,
    cylinder,
    door,
    table,
    wall,
)
from visuohaptic.simulation.rendering import FoamScene

#: Front of the foam of the default platform at rest (m).
FRONT_M = 0.17 + 0.02


def drive(world: FoamPushWorld, speed_m_s: float, seconds: float, dt_s: float = 1 / 30) -> list[PushTruth]:
    world.base.drive(speed_m_s, 0.0)
    return [world.step(dt_s) for _ in range(round(seconds / dt_s))]


def drive_until(
    world: FoamPushWorld, speed_m_s: float, *, load_N: float = 20.0, strain: float = 0.5
) -> list[PushTruth]:
    """Drive on until the true load or strain is reached, at most 10 s, and tell the base to stop."""
    world.base.drive(speed_m_s, 0.0)
    truth = [world.truth]
    deepest_m = strain * world.config.strip.width_m
    while truth[-1].load_N < load_N and truth[-1].strip.delta_m.max() < deepest_m and world.t_s < 10.0:
        truth.append(world.step(1 / 30))
    world.base.stop()
    return truth


def events(world: FoamPushWorld) -> dict[EventKind, float]:
    return {event.kind: event.t_s for _, event in world.events}


@pytest.mark.parametrize(
    "obstacle",
    [
        box("box", FRONT_M + 0.11, 0.0, (0.2, 0.15, 0.3), mass_kg=0.6, friction=0.4),
        box("heavy", FRONT_M + 0.11, 0.0, (0.2, 0.2, 0.3), mass_kg=2.0, friction=0.35),
        cylinder("bin", FRONT_M + 0.09, 0.0, 0.08, mass_kg=0.8, friction=0.5),
    ],
)
def test_steady_push_is_mu_m_g(obstacle: SimulatedObstacle) -> None:
    world = FoamPushWorld([obstacle])
    truth = drive(world, 0.05, 3.0)
    load = np.array([x.load_N for x in truth[-60:]])
    # Owed: 2 %. Measured 0.1 %.
    assert load.mean() == pytest.approx(obstacle.friction * obstacle.mass_kg * GRAVITY_M_S2, rel=0.005)
    assert obstacle.dynamic_friction_N == pytest.approx(obstacle.friction * obstacle.mass_kg * GRAVITY_M_S2)
    # The load rings by a few percent; over two seconds the obstacle keeps up with the platform.
    way = truth[-1].body(obstacle.name).x_m - truth[-61].body(obstacle.name).x_m
    assert way == pytest.approx(0.1, abs=1e-3)
    assert truth[-1].body(obstacle.name).tilt_rad < 2e-3
    assert list(events(world)) == [EventKind.CONTACT, EventKind.MOTION]


def test_momentum_balance() -> None:
    """Impulse of the foam minus that of friction is the change of momentum, from contact on."""
    obstacle = box("box", FRONT_M + 0.102, 0.0, (0.2, 0.15, 0.3), mass_kg=1.0, friction=0.3, static_ratio=1.0)
    world = FoamPushWorld([obstacle])
    truth = drive(world, 0.08, 2.0, 0.002)
    force = np.array([x.force_foam_N[0] for x in truth])
    speed = np.array([x.body("box").velocity_m_s[0] for x in truth])
    moving = np.flatnonzero(speed > 0.02)
    a, b = moving[0], moving[-1]
    assert (speed[a:b] > 1e-3).all(), "it slides all the time, so that friction is mu m g"
    impulse = float(np.sum(force[a:b] - 0.3 * 1.0 * GRAVITY_M_S2) * 0.002)
    # Friction acts on feet that bob by micrometres; 10 mNs is 0.3 % of what friction takes.
    assert impulse == pytest.approx(speed[b] - speed[a], abs=0.01)


def test_obstacle_rests_below_its_static_friction() -> None:
    """No creep: a box held by a standing platform does not move."""
    world = FoamPushWorld([box("box", FRONT_M + 0.102, 0.0, (0.2, 0.2, 0.3), mass_kg=3.0, friction=0.6)])
    reached = drive_until(world, 0.03, load_N=8.0)[-1].load_N
    drive(world, 0.0, 0.5)
    before = world.truth.body("box").x_m
    drive(world, 0.0, 2.0)
    assert reached >= 8.0
    assert world.truth.load_N > 7.0
    # 10 um/s would be 20 um.
    assert abs(world.truth.body("box").x_m - before) < 5e-6


@pytest.mark.parametrize("kinematic", [True, False])
def test_wall_and_drive(kinematic: bool) -> None:
    world = FoamPushWorld(
        [wall("wall", FRONT_M + 0.06, 0.0, yaw_rad=math.pi / 2)], PlatformConfig(kinematic=kinematic)
    )
    pushed = drive_until(world, 0.04)
    assert world.t_s < 10.0, "a wall stops the push"
    drive(world, 0.0, 0.5)
    deepest = world.truth.strip.delta_m.max()
    assert deepest >= pushed[-1].strip.delta_m.max()
    drive(world, -0.04, 2.0)
    assert world.truth.load_N == 0.0
    kinds = events(world)
    assert EventKind.MOTION not in kinds
    assert kinds[EventKind.CONTACT] < kinds[EventKind.RELEASE]
    # First touch: 0.01 m at 0.04 m/s, plus half the 0.08 s of acceleration.
    assert kinds[EventKind.CONTACT] == pytest.approx(0.01 / 0.04 + 0.04, abs=0.01)


def test_drive_force_is_limited_and_hull_stops_a_blind_robot() -> None:
    world = FoamPushWorld(
        [wall("wall", FRONT_M + 0.06, 0.0, yaw_rad=math.pi / 2)], PlatformConfig(max_force_N=15.0)
    )
    truth = drive(world, 0.05, 4.0)
    assert truth[-1].load_N == pytest.approx(15.0, rel=0.02)
    assert max(x.drive_N for x in truth) <= 15.0


def test_tall_thing_falls() -> None:
    world = FoamPushWorld([box("tall", FRONT_M + 0.02, 0.0, (0.03, 0.2, 0.5), mass_kg=0.3, friction=0.7)])
    drive(world, 0.03, 5.0)
    kinds = events(world)
    assert kinds[EventKind.FALL] > kinds[EventKind.CONTACT]
    assert world.truth.body("tall").tilt_rad > 1.4
    assert isinstance(world.scene(), FoamScene)


def test_door_turns_goes_on_and_lets_go() -> None:
    wing = door("door", FRONT_M + 0.04, -0.5, yaw_rad=math.pi / 2, hinge_friction_Nm=0.2)
    world = FoamPushWorld([wing])
    drive(world, 0.15, 1.5)
    world.base.stop()
    world.step(0.5)
    turned = world.truth.body("door").yaw_rad
    assert turned < math.pi / 2 - 0.1
    assert world.truth.load_N == 0.0, "the wing goes on after the platform has stopped"
    assert EventKind.RELEASE in events(world)


def test_off_centre_push_turns_the_box() -> None:
    world = FoamPushWorld([box("box", FRONT_M + 0.11, 0.15, (0.2, 0.3, 0.3), mass_kg=1.0)])
    drive(world, 0.05, 4.0)
    # The contact lies right of its centre: it turns counter-clockwise.
    assert world.truth.body("box").yaw_rad > 0.05


def test_table_leg_and_bent_strip() -> None:
    desk = table("desk", FRONT_M + 0.05 + 0.6 - 0.02, 0.35 - 0.02, round_legs=True)
    world = FoamPushWorld(
        [desk], PlatformConfig(round=True, strip=FoamStripGeometry(radius_m=0.17, spacing_m=0.001))
    )
    drive_until(world, 0.03, strain=0.4)
    state = world.truth.strip
    # The leg stands on the platform's axis; a 4 cm cylinder touches about +-1.5 cm of the arc.
    assert state.centre_m(int(state.body.max())) == pytest.approx(0.0, abs=1e-3)
    assert 0.015 < float(np.ptp(state.s_m[state.touching])) < 0.04
    assert world.truth.force_on.keys() == {"desk"}
    assert len(world.scene().objects) == 4


def test_scene_fits_the_truth() -> None:
    x, y, heading = 1.0, -2.0, 0.7
    start = PlatformConfig(x_m=x, y_m=y, heading_rad=heading)
    ahead = FRONT_M + 0.101
    place = (x + ahead * math.cos(heading), y + ahead * math.sin(heading))
    world = FoamPushWorld([box("box", *place, (0.2, 0.1, 0.3), yaw_rad=heading, mass_kg=2.0)], start)
    drive(world, 0.02, 0.4)
    scene = world.scene()
    assert scene.t_s == world.truth.t_s
    near = scene.objects[0].outline_foam_m
    touching = world.truth.strip.touching
    # Away from the box's rounded edges, 2 mm and a column wide.
    touching &= np.abs(world.truth.strip.s_m) < 0.047
    assert touching.any()
    # The foam lies on the box: both come from the same instant.
    assert scene.front_m[touching, 0] == pytest.approx(near[:, 0].min(), abs=1e-6)
    assert scene.objects[0].top_m == pytest.approx(0.25, abs=1e-3)
    corner = scene.T_world_foam.apply(np.array([0.0, 0.0, -0.05]))
    px, py, ph = world.truth.platform_pose
    assert corner == pytest.approx([px + 0.17 * math.cos(ph), py + 0.17 * math.sin(ph), 0.0])


def test_same_seed_same_world() -> None:
    def run(seed: int) -> list[float]:
        world = FoamPushWorld(
            [box("box", FRONT_M + 0.105, 0.01, (0.2, 0.2, 0.2))], seed=seed, friction_sigma=0.1
        )
        return [x.load_N for x in drive(world, 0.05, 0.7)]

    assert run(1) == run(1)
    assert run(1) != run(2)


class FlatRenderer:
    camera = None

    def render(self, scene: FoamScene, rng: np.random.Generator | None = None) -> np.ndarray:
        assert rng is not None
        return np.full((4, 6), round(float(scene.front_m[:, 0].max()) * 1e3), np.uint8)


def test_camera_and_base_are_what_a_robot_offers() -> None:
    world = FoamPushWorld([box("box", FRONT_M + 0.15, 0.0)])
    assert isinstance(world.base, MobileBase)
    with SimulatedSensorCamera(world, FlatRenderer(), duration_s=0.5) as source:
        assert isinstance(source, FrameSource)
        assert source.frame_count == 15
        world.base.drive(0.1, 0.0)
        frames = list(source)
    assert [frame.index for frame in frames] == list(range(15))
    assert np.diff([frame.t_s for frame in frames]) == pytest.approx(1 / 30)
    # 0.2 s of acceleration at 0.5 m/s^2, then 0.1 m/s.
    assert world.base.state().x_m == pytest.approx(0.01 + 0.03, abs=2e-3)
    world.place_platform(3.0, 0.0, 0.5)
    assert world.base.state().heading_rad == pytest.approx(0.5)
    assert world.step(0.1).platform_velocity[0] == 0.0


def test_bad_worlds_are_refused() -> None:
    with pytest.raises(InputError, match="different names"):
        FoamPushWorld([box("a", 1, 0), box("a", 2, 0)])
    with pytest.raises(InputError, match=r"mass_kg: found -1\.0, expected more than 0"):
        box("b", 0, 0, mass_kg=-1.0)
    with pytest.raises(InputError, match="at most 10"):
        FoamPushWorld([]).step(math.inf)
    with pytest.raises(InputError, match="expected finite numbers"):
        FoamPushWorld([]).base.drive(math.nan, 0.0)
