"""A correct robot passes, and for each of thirty faulty ones the violated rule is reported."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests.tasks import example_robot as right

from visuohaptic.cli.main import main
from visuohaptic.core import InputError
from visuohaptic.core.camera import Frame
from visuohaptic.simulation.mobile import SimulatedBase
from visuohaptic.simulation.tabletop import SimulatedArm
from visuohaptic.tasks.framework import RobotParts, assert_robot, check_robot


def broken(rules):
    return [(rule.part, rule.rule) for rule in rules if rule.problem]


def told(**changes):
    """A base whose state says something else."""

    class Base(right.Base):
        def state(self):
            true = super().state()
            return replace(true, **{name: change(true) for name, change in changes.items()})

    return Base()


def driven(change):
    """A base whose wheels do something else."""

    class Base(right.Base):
        def drive(self, speed_m_s, turn_rate_rad_s):
            super().drive(*change(speed_m_s, turn_rate_rad_s))

    return Base()


class Deaf(right.Base):
    def drive(self, speed_m_s, turn_rate_rad_s):
        if math.isfinite(speed_m_s):
            super().drive(speed_m_s, turn_rate_rad_s)


class Forgetful(right.Base):
    """A command holds for a tenth of a second only."""

    def wait(self, duration_s):
        super().wait(0.1)
        self.velocity[:] = 0.0
        super().wait(duration_s - 0.1)


class Late(right.Base):
    """Commands act after a delay."""

    def __init__(self, delay_s):
        super().__init__()
        self.delay_s, self.given = delay_s, []

    def drive(self, speed_m_s, turn_rate_rad_s):
        old = self.velocity
        super().drive(speed_m_s, turn_rate_rad_s)
        self.given.append((self.t_s + self.delay_s, self.velocity))
        self.velocity = old

    def wait(self, duration_s):
        for _ in range(round(duration_s / 0.01)):
            while self.given and self.given[0][0] <= self.t_s + 1e-9:
                self.velocity = self.given.pop(0)[1]
            super().wait(0.01)


class Slipping(right.Base):
    """Its pose moves by a fraction of what its speed says."""

    def __init__(self, ratio):
        super().__init__()
        self.ratio = ratio

    def state(self):
        true = super().state()
        return replace(true, speed_m_s=true.speed_m_s / self.ratio)


def ahead(distance_m):
    """A base that reports the pose of a point ahead of the one about which it turns."""
    return told(
        x_m=lambda s: s.x_m + distance_m * math.cos(s.heading_rad),
        y_m=lambda s: s.y_m + distance_m * math.sin(s.heading_rad),
    )


class Creeping(right.Base):
    """It rolls on slowly when it should stand."""

    def wait(self, duration_s):
        super().wait(duration_s)
        if not self.velocity.any():
            self.pose[0] += 0.005 * duration_s


class Runaway(right.Base):
    def stop(self):
        pass


class NoStop:
    def drive(self, speed_m_s, turn_rate_rad_s): ...
    def state(self): ...
    def wait(self, duration_s): ...


class OtherArguments(right.Base):
    def drive(self, twist): ...


class Raising(right.Base):
    def drive(self, speed_m_s, turn_rate_rad_s):
        raise RuntimeError("no route to host")


class Tuple(right.Base):
    def state(self):
        return (self.t_s, *self.pose)


BASES = {
    "millimetres": (told(x_m=lambda s: 1e3 * s.x_m, y_m=lambda s: 1e3 * s.y_m), "a positive speed drives metres"),
    "degrees": (told(heading_rad=lambda s: math.degrees(s.heading_rad)), "a positive turn rate turns"),
    "clockwise": (told(heading_rad=lambda s: -s.heading_rad), "a positive turn rate turns"),
    "y to the right": (told(y_m=lambda s: -s.y_m), "it drives where its heading points"),
    "x and y swapped": (told(x_m=lambda s: s.y_m, y_m=lambda s: s.x_m), "it drives where its heading points"),
    "milliseconds": (told(t_s=lambda s: 1e3 * s.t_s), "time advances"),
    "frozen clock": (told(t_s=lambda s: 0.0), "time advances"),
    "not a number": (told(x_m=lambda s: math.nan), "its numbers are finite"),
    "speed in cm/s": (told(speed_m_s=lambda s: 100 * s.speed_m_s), "speed_m_s is what it drives"),
    "no speed": (told(speed_m_s=lambda s: 0.0), "speed_m_s is what it drives"),
    "frozen odometry": (told(x_m=lambda s: 0.0, y_m=lambda s: 0.0, heading_rad=lambda s: 0.0), "a positive turn"),
    "wheels in degrees": (driven(lambda v, w: (v, math.radians(w))), "a positive turn rate turns"),
    "wheels in mm/s": (driven(lambda v, w: (1e-3 * v, w)), "a positive speed drives metres"),
    "arguments swapped": (driven(lambda v, w: (w, v)), "a positive turn rate turns"),
    "forgets its command": (Forgetful(), "a positive turn rate turns"),
    "does not stop": (Runaway(), "a command acts in time"),
    "creeps": (Creeping(), "it stands a second after stop()"),
    "acts late": (Late(0.25), "a command acts in time"),
    "slips": (Slipping(0.88), "its speed and its path agree"),
    "a point ahead": (ahead(0.045), "x_m and y_m are those of the point about which it turns"),
    "takes nonsense": (Deaf(), "a speed that is not a number is refused"),
    "no stop": (NoStop(), "it is a MobileBase"),
    "other arguments": (OtherArguments(), "it is a MobileBase"),
    "raises": (Raising(), "its methods work"),
    "a tuple": (Tuple(), "state() is a BaseState"),
}  # fmt: skip


class OpeningInMillimetres(right.Fingers):
    def state(self):
        true = super().state()
        return replace(true, opening_m=1e3 * true.opening_m)


class Closing(right.Fingers):
    """Its opening is counted from open to closed."""

    def state(self):
        true = super().state()
        return replace(true, opening_m=0.1 - true.opening_m)


class Slamming(right.Fingers):
    def move(self, opening_m, speed_m_s):
        super().move(opening_m, 10 * speed_m_s)


class Wandering(right.Fingers):
    def stop(self):
        pass


class ArmInMillimetres(right.Arm):
    def reach_m(self):
        return np.array([100.0, 800.0])


class Unlimited(right.Arm):
    def move_linear(self, T_base_tip, speed_m_s):
        self.goal, self.speed = T_base_tip.translation_m, speed_m_s


class Sideways(right.Arm):
    def pose(self):
        t_s, pose = super().pose()
        return t_s, type(pose)(pose.rotation, pose.translation_m[[2, 0, 1]])


class Repeating(right.Pictures):
    def __iter__(self):
        return (Frame(np.zeros((4, 6), np.uint8), 0.5, 3) for _ in range(9))


class Arrays(right.Pictures):
    def __iter__(self):
        return (np.zeros((4, 6), np.uint8) for _ in range(9))


class MapInMillimetres(right.MapFrame):
    def locate(self):
        true = super().locate()
        return replace(true, x_m=1e3 * true.x_m, y_m=1e3 * true.y_m)


class MapMirrored(right.MapFrame):
    def locate(self):
        true = super().locate()
        return replace(true, heading_rad=-true.heading_rad)


class MapOnce(right.MapFrame):
    """Told anew every half second only."""

    def locate(self):
        true = super().locate()
        return replace(true, t_s=0.5 * math.floor(2.0 * true.t_s))


class Slow(right.Base):
    """Its odometry comes every 0.4 s."""

    told = None

    def state(self):
        if self.told is None or self.t_s - self.told.t_s >= 0.4:
            self.told = super().state()
        return self.told


class DepthInMillimetres(right.Depth):
    def read(self):
        image = super().read()
        image.depth_m = 1e3 * image.depth_m
        return image


class DepthZeros(right.Depth):
    """0 where nothing was measured."""

    def read(self):
        image = super().read()
        image.depth_m[0] = 0.0
        return image


class DepthTurned(right.Depth):
    def read(self):
        image = super().read()
        image.depth_m = image.depth_m.T
        return image


def felt(**values):
    return lambda frame: SimpleNamespace(**({"valid": True, "force_N": 0.0, "surface_m": math.nan} | values))


BASE = right.Base()
SENSORS = {
    "map in mm": ({"base": BASE, "localizer": MapInMillimetres(BASE)}, "it moves with the base"),
    "map mirrored": ({"base": BASE, "localizer": MapMirrored(BASE)}, "it turns with the base"),
    "map that is old": ({"base": BASE, "localizer": MapOnce(BASE)}, "it is measured again within 0.2 s"),
    "no localizer": ({"localizer": object()}, "it is a Localizer"),
    "slow odometry": ({"base": Slow()}, "it is measured again within 0.2 s"),
    "depth in mm": ({"depth": DepthInMillimetres()}, "its depths are in metres"),
    "depth with zeros": ({"depth": DepthZeros()}, "its depths are in metres"),
    "depth turned": ({"depth": DepthTurned()}, "its images are of the camera's size"),
    "no read": ({"depth": right.Pictures()}, "it is a DepthSource"),
    "finger in grams": ({"feel": felt(force_N=250.0)}, "it feels no force there"),
    "finger that is never valid": ({"feel": felt(valid=False)}, "it is valid on a finger"),
    "finger in mm": ({"feel": felt(surface_m=35.0)}, "its surface is in metres"),
    "a float": ({"feel": lambda frame: 0.1}, "what it feels has valid"),
    "no arguments": ({"feel": lambda: None}, "its methods work"),
}  # fmt: skip


OTHERS = {
    "gripper in mm": ({"gripper": OpeningInMillimetres()}, "its opening is in metres"),
    "gripper from the other end": ({"gripper": Closing()}, "it moves at the commanded speed"),
    "fast gripper": ({"gripper": Slamming()}, "it moves at the commanded speed"),
    "gripper that goes on": ({"gripper": Wandering()}, "it holds after stop()"),
    "arm in mm": ({"arm": ArmInMillimetres()}, "reach_m() is two ascending distances"),
    "arm without limits": ({"arm": Unlimited()}, "a pose out of reach is refused"),
    "arm with other axes": ({"arm": Sideways()}, "it moves"),
    "one frame again and again": ({"camera": Repeating()}, "their times ascend"),
    "arrays for frames": ({"camera": Arrays()}, "they are of type Frame"),
}


def test_the_example_keeps_every_rule():
    rules = check_robot(right.connect())
    assert not broken(rules)
    assert {rule.part for rule in rules} == {"base", "arm", "gripper", "camera", "localizer", "depth", "feel"}
    assert len(rules) > 30


@pytest.mark.parametrize("name", BASES)
def test_a_wrong_base_is_told_its_fault(name):
    base, rule = BASES[name]
    found = broken(check_robot({"base": base, "wait": base.wait}))
    assert {part for part, _ in found} == {"base"}
    assert found[0][1].startswith(rule)


@pytest.mark.parametrize("name", OTHERS)
def test_another_wrong_part_is_told_its_fault(name):
    part, rule = OTHERS[name]
    found = broken(check_robot(right.connect(**part)))
    assert {one for one, _ in found} == set(part)
    assert found[0][1].startswith(rule)


def test_all_broken_readings_of_a_part_are_told_and_it_is_not_moved_after_one():
    driven = []

    class Frozen(type(BASES["frozen clock"][0])):
        def drive(self, speed_m_s, turn_rate_rad_s):
            driven.append((speed_m_s, turn_rate_rad_s))

    base = Frozen()
    found = broken(check_robot({"base": base, "wait": base.wait}))
    assert [rule for _, rule in found] == [
        "time advances, in seconds",
        "it is measured again within 0.2 s",
    ]
    assert not np.any(driven)


def test_what_follows_from_a_broken_rule_is_no_other_finding():
    """A state of another type has no fields to read: one rule, not the error of reading them as well."""
    base = SimpleNamespace(drive=lambda v, w: None, stop=lambda: None, state=lambda: "here")
    found = broken(check_robot({"base": base, "wait": lambda s: None}))
    assert [rule for _, rule in found] == ["state() is a BaseState"]


@pytest.mark.parametrize("name", SENSORS)
def test_a_wrong_sensor_is_told_its_fault(name):
    parts, rule = SENSORS[name]
    found = broken(check_robot(right.connect(**parts)))
    assert any(one.startswith(rule) for _, one in found), found


def test_a_test_of_ones_own_says_every_rule_that_is_broken():
    assert_robot(right.connect())
    with pytest.raises(AssertionError, match=r"depth: its depths are in metres.*found 1500"):
        assert_robot(right.connect(depth=DepthInMillimetres()))
    with pytest.raises(InputError, match=r"found a robot for contract 2\.0, expected 1\."):
        check_robot({**right.connect(), "contract": "2.0"})


def test_a_robot_that_must_not_move_does_not():
    base = right.Base()
    base.drive = lambda *_: pytest.fail("it was moved")
    base.stop = lambda: None
    assert not broken(check_robot({"base": base, "wait": base.wait}, motion=False))


def test_the_simulated_parts_keep_the_contract():
    class Floor:
        """Only what the simulated drive needs of its world."""

        def __init__(self):
            from visuohaptic.simulation.mobile import PlatformConfig

            self.config, self.t_s, self.at, self.now = PlatformConfig(), 0.0, np.zeros(3), (0.0, 0.0)

        def platform_pose(self):
            return tuple(float(v) for v in self.at)

        def platform_velocity(self):
            return self.now[0], 0.0, self.now[1]

        def step(self, duration_s):
            for _ in range(round(duration_s / 0.01)):
                self.now = base.ramp(0.01)
                c, s = math.cos(self.at[2]), math.sin(self.at[2])
                self.at += 0.01 * np.array([self.now[0] * c, self.now[0] * s, self.now[1]])
                self.t_s += 0.01

    floor = Floor()
    base = SimulatedBase(floor)
    arm = SimulatedArm(right.Arm().pose()[1])

    def wait(duration_s):
        floor.step(duration_s)
        for _ in range(round(duration_s / 0.01)):
            arm.advance(0.01)

    assert not broken(check_robot(RobotParts(base=base, arm=arm, wait=wait)))


def test_a_robot_without_parts_is_refused():
    with pytest.raises(InputError, match="has no parts"):
        check_robot({})
    with pytest.raises(InputError, match="found part 'wheels'"):
        check_robot({"wheels": right.Base()})


def test_the_doctor_tries_a_robot(capsys, tmp_path, monkeypatch):
    (tmp_path / "a_robot_of_this_test.py").write_text(
        "from tests.tasks import example_robot, test_robot_contract as wrong\n"
        "connect = example_robot.connect\n"
        "def run_away():\n"
        "    base = wrong.Runaway()\n"
        "    return {'base': base, 'wait': base.wait}\n"
        "def switched_off():\n"
        "    import socket\n"
        "    socket.create_connection(('127.0.0.1', port))\n"
        "def leaves():\n"
        "    raise SystemExit(0)\n"
    )
    (tmp_path / "unfinished_robot.py").write_text("def connect(:\n")
    monkeypatch.chdir(tmp_path)
    assert main(["doctor", "--robot", "a_robot_of_this_test:connect"]) == 0
    assert "kept" in capsys.readouterr().out
    assert main(["doctor", "--robot", "a_robot_of_this_test:run_away"]) == 2
    assert "a command acts in time" in capsys.readouterr().err
    (tmp_path / "broken_robot.py").write_text("1 / 0\n")
    for name in ("no_such_module", "unfinished_robot", "broken_robot"):
        assert main(["doctor", "--robot", f"{name}:connect"]) == 2
        assert "cannot be imported" in capsys.readouterr().err
    assert main(["doctor", "--robot", "a_robot_of_this_test:switched_off"]) == 2
    said = capsys.readouterr().err
    assert "switched_off failed: NameError: name 'port' is not defined" in said
    assert "a_robot_of_this_test.py, line 8)" in said
    assert main(["doctor", "--robot", "a_robot_of_this_test:leaves"]) == 2
    assert "leaves failed: SystemExit: 0" in capsys.readouterr().err


def test_the_doctor_reaches_a_robot_in_a_process_of_its_own(capsys):
    assert main(["doctor", "--robot", "visuohaptic.simulation.served:kitchen", "--apart", "--still"]) == 0
    kept = capsys.readouterr().out
    assert "feel     kept    it feels no force there, in newtons" in kept
    assert "gripper  kept    it is measured again within 0.2 s" in kept


def test_the_motions_are_those_of_the_guide():
    """docs/howto/your_robot.md: 10 cm and half a radian, the tip by 2 cm, the fingers by 1 cm."""
    base, arm, gripper = right.Base(), right.Arm(), right.Fingers()
    goals_m, openings_m, told = [], [], {"move": gripper.move, "line": arm.move_linear}
    turned_and_driven = np.zeros(2)

    def wait(duration_s):
        turned_and_driven[:] += duration_s * np.abs(base.velocity[::-1])
        for part in (base, arm, gripper):
            part.wait(duration_s)

    def move(opening_m, speed_m_s):
        told["move"](opening_m, speed_m_s)
        openings_m.append(opening_m)

    def line(T_base_tip, speed_m_s):
        told["line"](T_base_tip, speed_m_s)
        goals_m.append(T_base_tip.translation_m[2])

    gripper.move, arm.move_linear = move, line
    assert not broken(check_robot({"base": base, "arm": arm, "gripper": gripper, "wait": wait}))
    assert turned_and_driven == pytest.approx([0.5, 0.1])
    assert max(goals_m) - min(goals_m) == pytest.approx(0.02)
    assert max(openings_m) - min(openings_m) == pytest.approx(0.01)


class Drifting(right.Base):
    """It creeps on after a stop."""

    def __init__(self, speed_m_s, turn_rad_s):
        super().__init__()
        self.creep = speed_m_s, turn_rad_s

    def stop(self):
        self.drive(*self.creep)


class Inexact(right.Fingers):
    def __init__(self, error_m):
        super().__init__()
        self.error_m = error_m

    def wait(self, duration_s):
        super().wait(duration_s)
        if duration_s > 1.0:  # at the end of a motion
            self.opening_m = self.target_m + self.error_m


class InexactArm(right.Arm):
    error_m = 0.0

    def pose(self):
        t_s, pose = super().pose()
        there = self.goal is not None and np.allclose(self.at, self.goal)
        return t_s, replace(
            pose, translation_m=pose.translation_m + np.array([self.error_m * there, 0.0, 0.0])
        )


def far(depth_m):
    depth = right.Depth()
    depth.read = lambda: replaced(right.Depth.read(depth), depth_m)
    return depth


def replaced(image, depth_m):
    image.depth_m[0, 0] = depth_m
    return image


def inexact_arm(error_m):
    arm = InexactArm()
    arm.error_m = error_m
    return arm


#: A fault in units of the limit of its rule: kept at 0.9, broken at 1.1.
LIMITS = {
    "slow clock": lambda f: {"base": told(t_s=lambda s: 0.5 / f * s.t_s)},
    "fast clock": lambda f: {"base": told(t_s=lambda s: 1.5 * f * s.t_s)},
    "ahead": lambda f: {"base": ahead(0.04 * f)},
    "late": lambda f: {"base": Late(0.2 * f)},
    "slips": lambda f: {"base": Slipping(1.0 - 0.1 * f)},
    "creeps": lambda f: {"base": Drifting(0.004 * f, 0.0)},
    "turns": lambda f: {"base": Drifting(0.0, 0.02 * f)},
    "opening": lambda f: {"gripper": Inexact(0.002 * f)},
    "tip": lambda f: {"arm": inexact_arm(0.002 * f)},
    "depth": lambda f: {"depth": far(50.0 * f)},
    "force": lambda f: {"feel": felt(force_N=2.0 * f)},
    "surface": lambda f: {"feel": felt(surface_m=0.5 * f)},
}  # fmt: skip


@pytest.mark.parametrize("name", LIMITS)
def test_the_limits_of_the_rules(name):
    motion = "clock" not in name  # the speed of a base with another clock contradicts its path
    assert not broken(check_robot(right.connect(**LIMITS[name](0.9)), motion=motion))
    assert len(broken(check_robot(right.connect(**LIMITS[name](1.1)), motion=motion))) == 1


@pytest.mark.parametrize(("period_s", "kept"), [(0.19, True), (0.23, False)])
def test_a_measurement_is_at_most_a_fifth_of_a_second_old(period_s, kept):
    base = right.Base()

    class Map(right.MapFrame):
        def locate(self):
            true = super().locate()
            return replace(true, t_s=period_s * math.floor(true.t_s / period_s + 1e-9))

    parts = {"base": base, "localizer": Map(base), "wait": base.wait}
    assert (not broken(check_robot(parts, motion=False))) == kept


def test_five_images_are_read():
    class Counting(right.Pictures):
        read = 0

        def __iter__(self):
            for frame in super().__iter__():
                self.read += 1
                yield frame

    camera, felt_in = Counting(), []

    def feel(frame):
        felt_in.append(frame.index)
        return right.feel(frame)

    assert not broken(check_robot({"camera": camera}))
    assert camera.read == 5
    assert not broken(check_robot({"camera": camera, "feel": feel}))
    assert felt_in == [0, 1, 2, 3, 4]
