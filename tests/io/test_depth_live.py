"""Depth cameras of two manufacturers, with stand-ins for their drivers."""

from __future__ import annotations

import sys
from types import SimpleNamespace as Box

import numpy as np
import pytest

from visuohaptic.cli.main import main
from visuohaptic.core import DeviceError, FrameSource, InputError, MissingExtraError
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.io.depth import OrbbecSource, RealSenseSource
from visuohaptic.io.frames import open_source

RAW = np.arange(12, dtype=np.uint16).reshape(3, 4)  # the first pixel is 0: not measured
BGR = np.arange(36, dtype=np.uint8).reshape(3, 4, 3)


class Driver:
    """What both makers' pipelines share; ``silent`` delivers nothing, ``lost`` raises."""

    def __init__(self):
        self.silent = self.lost = False
        self.stopped = 0
        self.chosen = []  # serial numbers that were asked for
        self.number = 6

    def stop(self):
        self.stopped += 1

    def _check(self):
        if self.lost:
            raise RuntimeError("device disconnected")
        self.number += 1


def realsense():
    driver = Driver()

    def wait(_timeout_ms):
        driver._check()
        depth = Box(
            get_data=lambda: RAW, get_timestamp=lambda: 1500.0, get_frame_number=lambda: driver.number
        )
        color = Box(get_data=lambda: BGR)
        return Box(
            get_depth_frame=lambda: None if driver.silent else depth,
            get_color_frame=lambda: None if driver.silent else color,
        )

    lens = Box(width=4, height=3, fx=5.0, fy=6.0, ppx=1.5, ppy=1.0)
    profile = Box(
        get_device=lambda: Box(first_depth_sensor=lambda: Box(get_depth_scale=lambda: 0.001)),
        get_stream=lambda _: Box(as_video_stream_profile=lambda: Box(get_intrinsics=lambda: lens)),
    )
    driver.wait_for_frames, driver.start = wait, lambda _config: profile
    module = Box(
        pipeline=lambda: driver,
        config=lambda: Box(enable_stream=lambda *_: None, enable_device=driver.chosen.append),
        camera_info=Box(name="name", serial_number="serial"),
        context=lambda: Box(
            query_devices=lambda: [Box(get_info={"name": "D435", "serial": "0123"}.__getitem__)]
        ),
        stream=Box(depth=1, color=2),
        format=Box(z16=1, bgr8=2),
        align=lambda _: Box(process=lambda frames: frames),
    )
    return driver, "pyrealsense2", module, RealSenseSource


def orbbec():
    driver = Driver()

    def wait(_timeout_ms):
        driver._check()
        if driver.silent:
            return None
        size = {"get_height": lambda: 3, "get_width": lambda: 4}
        depth = Box(
            **size,
            get_data=RAW.tobytes,
            get_depth_scale=lambda: 1.0,
            get_timestamp=lambda: 0,
            get_system_timestamp=lambda: 1500,
        )
        color = Box(**size, get_data=BGR[..., ::-1].tobytes)
        frames = Box(get_depth_frame=lambda: depth, get_color_frame=lambda: color)
        frames.as_frame_set = lambda: frames
        return frames

    lens = Box(width=4, height=3, fx=5.0, fy=6.0, cx=1.5, cy=1.0)
    driver.wait_for_frames, driver.start = wait, lambda _config: None
    driver.get_stream_profile_list = lambda _: Box(get_video_stream_profile=lambda *_: None)
    driver.enable_frame_sync = lambda: None
    driver.get_camera_param = lambda: Box(rgb_intrinsic=lens)
    module = Box(
        Pipeline=lambda *_: driver,
        Context=lambda: Box(
            query_devices=lambda: Box(
                get_count=lambda: 1,
                get_device_by_serial_number=driver.chosen.append,
                get_device_name_by_index=["Femto Bolt"].__getitem__,
                get_device_serial_number_by_index=["CL8"].__getitem__,
            )
        ),
        Config=lambda: Box(enable_stream=lambda _: None, set_frame_aggregate_output_mode=lambda _: None),
        OBSensorType=Box(DEPTH_SENSOR=1, COLOR_SENSOR=2),
        OBFormat=Box(Y16=1, RGB=2),
        OBStreamType=Box(COLOR_STREAM=1),
        OBFrameAggregateOutputMode=Box(FULL_FRAME_REQUIRE=1),
        AlignFilter=lambda align_to_stream: Box(process=lambda frames: frames),
    )
    return driver, "pyorbbecsdk", module, OrbbecSource


@pytest.fixture(params=[realsense, orbbec])
def maker(request, monkeypatch):
    driver, name, module, source = request.param()
    monkeypatch.setitem(sys.modules, name, module)
    return driver, source


def test_pictures_are_metres_with_the_model_of_the_colour_camera(maker):
    driver, make = maker
    with make(width=4, height=3) as source:
        assert isinstance(source, FrameSource)
        np.testing.assert_array_equal(source.camera.matrix, [[5, 0, 1.5], [0, 6, 1], [0, 0, 1]])
        first, second = source.read(), source.read()
        assert np.isnan(first.depth_m[0, 0])
        np.testing.assert_allclose(first.depth_m.ravel()[1:], 0.001 * np.arange(1, 12), rtol=1e-6)
        np.testing.assert_array_equal(first.color, BGR)
        assert first.t_s == pytest.approx(1.5)
        assert second.index == first.index + 1
        view = first.posed(Pose.identity(), source.camera)
        assert view.depth_m.shape == (3, 4)
        frame = next(iter(source))
        np.testing.assert_array_equal(frame.image, BGR)
    source.close()
    assert driver.stopped == 1


def test_a_silent_or_lost_camera_says_so(maker):
    driver, make = maker
    source = make(width=4, height=3, timeout_s=0.1)
    driver.silent = True
    with pytest.raises(DeviceError, match="no frame for 100 ms"):
        source.read()
    driver.lost = True
    with pytest.raises(DeviceError, match="lost the connection to the camera"):
        source.read()
    source.close()
    with pytest.raises(DeviceError, match="closed"):
        source.read()


def test_a_camera_that_is_not_there_is_a_device_error(maker):
    driver, make = maker

    def start(_config):
        raise RuntimeError("No device connected")

    driver.start = start
    with pytest.raises(DeviceError, match="cannot be started"):
        make()
    # One that begins and then fails is let go: it would be busy when it is looked for again.
    assert driver.stopped == 1


@pytest.mark.parametrize(("make", "extra"), [(RealSenseSource, "realsense"), (OrbbecSource, "orbbec")])
def test_a_missing_package_names_its_extra(make, extra, monkeypatch):
    monkeypatch.setitem(sys.modules, make.module, None)
    with pytest.raises(MissingExtraError, match=rf"visuohaptic\[{extra}\]"):
        make()


def test_impossible_sizes_are_refused():
    with pytest.raises(InputError, match="expected numbers > 0"):
        RealSenseSource(width=0)


def test_every_source_takes_a_depth_camera_by_its_maker(maker):
    driver, make = maker
    name = "realsense" if make is RealSenseSource else "orbbec"
    with open_source(f"{name}:0123", camera=Camera.simple(4, 3, 5.0), grey=True) as source:
        frame = next(iter(source))
        assert frame.image.shape == (3, 4)
        first_s = frame.t_s
    assert driver.chosen == ["0123"]
    assert first_s > 1e9  # seconds since the epoch; the stand-in's own clock says 1.5
    with open_source(name) as source:  # the model is the maker's
        assert source.camera.matrix[0, 0] == 5.0
        np.testing.assert_array_equal(next(iter(source)).image, BGR)
    assert driver.chosen == ["0123"]
    assert driver.stopped == 2


def test_connected_depth_cameras_are_listed_by_the_command_line(monkeypatch, capsys):
    for make in (realsense, orbbec):
        _, name, module, _ = make()
        monkeypatch.setitem(sys.modules, name, module)
    assert main(["cameras"]) == 0
    listed = [line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines()]
    assert ["realsense:0123", "D435"] in listed
    assert ["orbbec:CL8", "Femto Bolt"] in listed


@pytest.mark.parametrize("source", ["realsense:", "realsense", "realsense:0123", "orbbec:", "orbbec"])
@pytest.mark.parametrize(
    "verb",
    ["sense foam --config none.yaml", "sense beam --config none.yaml", "sense scene --config none.yaml",
     "track --templates none --camera none.yaml", "start"],
)  # fmt: skip
def test_a_verb_names_the_makers_package_before_it_reads_anything(verb, source, monkeypatch, capsys):
    monkeypatch.setattr("visuohaptic.cli._extras._is_there", lambda module: False)
    assert main([*verb.split(), "--source", source]) == 2
    assert f"visuohaptic[{source.partition(':')[0]}]" in capsys.readouterr().err
