"""The virtual gripper: protocols, motion, equilibrium of foam and spring, its images and their truth."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import FrameSource, Gripper, InputError
from visuohaptic.simulation.foam import FoamStrip, Outline, SensorRig
from visuohaptic.simulation.rendering import CameraEffects, _finger_tag
from visuohaptic.simulation.rendering._finger_tag import FingerTag
from visuohaptic.simulation.tabletop import (
    GRIPPER_RIG,
    ROD,
    RUBBER_FOAM,
    FingerView,
    GraspObject,
    GripperDrive,
    VirtualGripper,
)

DISC = Outline.disc((0.065, 0.0), 0.035)


def gripper(*objects: GraspObject, **more) -> VirtualGripper:
    return VirtualGripper(objects, rng=np.random.default_rng(0), **more)


def test_it_is_what_a_robot_offers() -> None:
    device = gripper(duration_s=0.1)
    assert isinstance(device, Gripper)
    assert isinstance(device, FrameSource)
    assert device.frame_count == 3
    with device as source:
        assert [frame.index for frame in source] == [0, 1, 2]


def test_drive_reaches_its_opening_within_its_limits() -> None:
    device = gripper(drive=GripperDrive(open_m=0.1, acceleration_m_s2=0.5))
    device.move(0.06, 0.05)
    device.advance_to(2.0)
    assert device.state().opening_m == pytest.approx(0.06, abs=1e-6)
    assert device.state().speed_m_s == 0.0
    truths = device._truths
    speed = np.array([t.speed_m_s for t in truths])
    time = np.array([t.t_s for t in truths])
    assert speed.max() <= 0.025 + 1e-12
    rise = np.diff(speed) / np.diff(time)
    assert rise.max() <= 0.5 + 1e-6
    # Positions are the integral of the speeds.
    assert truths[-1].position_m == pytest.approx(float(speed[1:] @ np.diff(time)), abs=5e-5)
    with pytest.raises(InputError, match=r"opening_m: found 0.2, expected 0 to 0.1"):
        device.move(0.2, 0.1)


def test_stop_holds_and_the_force_limit_too() -> None:
    device = gripper(GraspObject(DISC), drive=GripperDrive(max_force_N=30.0))
    device.move(0.0, 0.05)
    device.advance_to(0.3)
    device.stop()
    held = device.state().opening_m
    device.advance_to(0.5)
    assert device.state().opening_m == held
    device.move(0.0, 0.05)
    device.advance_to(3.0)
    # One step of 0.1 mm of a bottle's contact is 0.6 N.
    assert device.truth().force_N == pytest.approx(30.0, abs=1.0)


def test_rigid_object_gives_the_force_of_the_foam_alone() -> None:
    """The same outline pressed by the strip's own law, without gripper."""
    device = gripper(GraspObject(DISC))
    device.move(0.06, 0.05)
    device.advance_to(2.0)
    strip = FoamStrip(ROD, RUBBER_FOAM)
    for depth in np.arange(0.0, 0.00501, 1e-4):
        state = strip.press([DISC.moved(-0.015 - depth, 0.0)])
    assert device.truth().position_m == pytest.approx(0.020, abs=1e-6)
    # The way there has other steps; the lag of the hysteresis elements over one step is what differs.
    assert device.truth().force_N == pytest.approx(float(state.force_N[0]), rel=0.005)


def test_foam_and_spring_are_in_balance_and_load_only() -> None:
    soft = GraspObject(DISC, stiffness_N_per_m=1.5e4)
    device = gripper(soft)
    device.move(0.04, 0.05)
    device.advance_to(2.0)
    truths = [t for t in device._truths if t.force_N > 2.0]
    assert truths[-1].force_N > 40
    for truth in truths:
        # What a step leaves goes into the next one; a step is 0.5 N, its tangent a bound and not the slope.
        assert truth.force_N == pytest.approx(1.5e4 * truth.shift_m[0], rel=0.01, abs=0.3)
    assert device.truth().force_N == pytest.approx(1.5e4 * device.truth().shift_m[0], rel=0.002)
    # Foam that is let go in between would remember it: its deflection never falls while closing.
    deflection = np.array([ROD.width_m - t.front_m[:, 0].min() for t in truths])
    assert np.diff(deflection).min() > -1e-7


def test_rubber_foam_has_the_range_of_the_dissertation() -> None:
    """Up to 100 N on a bottle (Sec. 3.6.4), stress rising throughout."""
    strain = np.linspace(0, 0.6, 61)
    assert (np.diff(RUBBER_FOAM.uniaxial(strain)) > 0).all()
    device = gripper(GraspObject(DISC), drive=GripperDrive(max_force_N=200.0))
    device.move(0.0, 0.1)
    device.advance_to(0.6)
    assert device.truth().force_N > 100.0


@pytest.mark.parametrize("row_delay_s", [0.0, 33e-6])
def test_tag_is_where_the_finger_is(row_delay_s: float) -> None:
    """Corners by the detector, against the position when their rows were exposed."""
    import cv2

    rig = SensorRig(look_ahead_m=GRIPPER_RIG.look_ahead_m, row_delay_s=row_delay_s)
    device = gripper(view=FingerView(rig=rig, effects=CameraEffects(0.8, 1.0)))
    device.move(0.0, 0.1)
    device.skip_to(0.4)
    frame = device.frame()
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    corners, ids, _ = detector.detectMarkers(frame.grey)
    assert ids.ravel().tolist() == [0]
    tag = FingerTag()
    half = tag.size_m / 2
    model = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
    for found, corner in zip(corners[0].reshape(4, 2), model, strict=True):
        t_s = frame.t_s + row_delay_s * float(found[1])
        place = tag.T_foam_tag.apply(corner[None])[0] + [device.truth(t_s).position_m, 0.0, 0.0]
        # The detector without refinement is good to a pixel.
        assert rig.camera.project(rig.T_camera_foam.apply(place[None]))[0] == pytest.approx(found, abs=1.0)


@pytest.mark.parametrize("moved_m", [0.0, 0.0037])
def test_the_tag_does_not_depend_on_the_window_it_is_drawn_in(moved_m: float, monkeypatch) -> None:
    camera, pose = GRIPPER_RIG.camera, GRIPPER_RIG.T_camera_foam
    drawn = []
    for block_px in (1, 32, 100):
        monkeypatch.setattr(_finger_tag, "BLOCK_PX", block_px)
        image = np.full((camera.height, camera.width, 1), 100, np.float32)
        rows_m = moved_m + np.linspace(0.0, 3e-4, camera.height)
        _finger_tag.paint_tag(image, camera, pose, FingerTag(), rows_m, 1.0)
        drawn.append(image)
    assert np.ptp(drawn[0]) > 150  # black and white
    np.testing.assert_array_equal(drawn[1], drawn[0])
    np.testing.assert_array_equal(drawn[2], drawn[0])


def test_same_seed_same_picture_and_colours_where_they_belong() -> None:
    first, second = gripper(GraspObject(DISC)).frame(), gripper(GraspObject(DISC)).frame()
    assert np.array_equal(first.image, second.image)
    rig = GRIPPER_RIG

    def colour(x: float, y: float) -> np.ndarray:
        u, v = rig.camera.project(rig.T_camera_foam.apply(np.array([[x, y, 0.0]])))[0]
        return first.image[int(v) - 1 : int(v) + 2, int(u) - 1 : int(u) + 2].reshape(-1, 3).mean(axis=0)

    assert colour(0.006, 0.02).max() < 60, "black foam"
    blue, green, red = colour(0.0135, 0.02)
    assert green > 1.8 * max(blue, red), "green stripe"
    assert np.ptp(colour(-0.005, 0.03)) < 25, "bare metal"


def test_stripe_is_compressed_with_the_foam() -> None:
    """Under a plate over the whole rod all columns are alike: inner edge at 4/5 of the present width."""
    plate = GraspObject(Outline.box((0.065, 0.0), (0.07, 0.3)))
    device = gripper(plate)
    device.move(0.064, 0.05)
    device.advance_to(2.0)
    truth = device.truth()
    width = truth.front_m[50, 0]
    assert width == pytest.approx(0.012, abs=1e-5)
    assert truth.stripe_m[50, 0] == pytest.approx(0.8 * width, rel=0.01)


def test_object_needs_a_stiffness() -> None:
    with pytest.raises(InputError, match="stiffness_N_per_m"):
        GraspObject(DISC, 0.0)
