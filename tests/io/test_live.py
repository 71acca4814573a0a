"""Live cameras with a driver that fails on command."""

from __future__ import annotations

import queue
import time
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from tests.patience import PATIENCE_S
from visuohaptic.core import DeviceError, FrameSource, InputError, StaleFrameError
from visuohaptic.core.camera import Camera
from visuohaptic.io import time_s
from visuohaptic.io.frames import CameraSettings, FoundCamera, LiveSource, _camera_drivers
from visuohaptic.io.frames._camera_drivers import OpenCvBackend, UvcBackend


class FakeBackend:
    """Delivers what the test puts into its queue."""

    def __init__(self, missing: int = 0) -> None:
        self.queue: queue.Queue[Any] = queue.Queue()
        self.running = lambda: True
        self.opened = 0
        self.missing = missing  #: attempts that find no device after the first one

    def open(self) -> None:
        if self.opened and self.missing:
            self.missing -= 1
            raise DeviceError("not there")
        self.opened += 1

    def read(self) -> tuple[np.ndarray, float]:
        while True:
            try:
                item = self.queue.get(timeout=0.02)
                break
            except queue.Empty:
                if not self.running():
                    raise DeviceError("silent") from None
        if isinstance(item, Exception):
            raise item
        return np.full((4, 6), item, np.uint8), time_s()

    def close(self) -> None:
        pass


def live(backend: FakeBackend, **settings: Any) -> LiveSource:
    """A source whose backend waits for the test, however busy the machine is, until the source is closed."""
    source = LiveSource(backend, **settings)
    backend.running = lambda: source._running
    return source


def settled(source: LiveSource, index: int) -> None:
    until = time.monotonic() + PATIENCE_S
    while (source._frame is None or source._frame.index < index) and time.monotonic() < until:
        time.sleep(0.002)


def test_newest_frame_and_gaps() -> None:
    backend = FakeBackend()
    with live(backend) as source:
        assert isinstance(source, FrameSource)
        assert source.frame_count is None
        with pytest.raises(StaleFrameError, match="no frame yet"):
            source.read_latest()
        for value in range(5):
            backend.queue.put(value)
        settled(source, 4)
        assert source.read_latest(60_000.0).index == 4
        frame = source.read()
        assert (frame.index, frame.image[0, 0]) == (4, 4), "the newest, the four before are a gap"
        backend.queue.put(9)
        assert source.read().index == 5
        time.sleep(0.06)
        with pytest.raises(StaleFrameError, match=r"is \d+ ms old, the limit is 50 ms"):
            source.read_latest(50.0)
    with pytest.raises(DeviceError, match="is closed"):
        source.read()
    source.close()


def test_any_error_of_a_driver_that_is_opened_again_reaches_the_reader() -> None:
    """It would end the camera's thread without a word, and the reader would wait for frames."""

    class Broken(FakeBackend):
        def open(self) -> None:
            if self.opened:
                raise KeyError("the driver's own")
            super().open()

    backend = Broken()
    with live(backend, reconnect_s=5.0) as source:
        backend.queue.put(DeviceError("unplugged"))
        with pytest.raises(DeviceError, match="the driver's own"):
            source.read(PATIENCE_S)


def test_reconnects_and_leaves_a_gap() -> None:
    backend = FakeBackend(missing=2)
    with live(backend, reconnect_s=5.0) as source:
        backend.queue.put(1)
        assert source.read().index == 0
        backend.queue.put(DeviceError("cable pulled"))
        backend.queue.put(2)
        assert source.read().index == 2
        assert source.reconnections == 1
        assert backend.opened == 2


def test_gives_up_with_the_reason() -> None:
    backend = FakeBackend(missing=10**6)
    with live(backend, reconnect_s=0.1) as source:
        backend.queue.put(DeviceError("cable pulled"))
        with pytest.raises(DeviceError, match="not there"):
            source.read(5.0)
        with pytest.raises(DeviceError, match="not there"):
            source.read_latest()


def test_silence_is_an_error_in_time() -> None:
    """The reader does not wait for the next attempt to connect, which is minutes away."""
    backend = FakeBackend(missing=10**6)
    with live(backend, reconnect_s=2 * PATIENCE_S) as source:
        backend.queue.put(DeviceError("cable pulled"))
        deadline_s = time.monotonic() + PATIENCE_S
        with pytest.raises(DeviceError, match=r"no frame for 0.1 s"):
            source.read(0.1)
        assert time.monotonic() < deadline_s


def test_wrong_size_reaches_the_reader() -> None:
    backend = FakeBackend()
    with live(backend, camera=Camera.simple(640, 480, 500.0)) as source:
        backend.queue.put(1)
        with pytest.raises(DeviceError, match="found images of 6 x 4, expected 640 x 480") as caught:
            source.read()
        assert isinstance(caught.value.__cause__, InputError)


def test_iteration_ends_when_closed() -> None:
    backend = FakeBackend()
    source = live(backend)
    for value in range(3):
        backend.queue.put(value)
    for frame in source:
        if frame.index >= 2:
            source.close()
    assert frame.index == 2


class FakeUvc:
    """The part of pupil-labs-uvc that is used."""

    def __init__(self) -> None:
        names = ("Auto Exposure Mode", "Absolute Exposure Time", "Auto Focus", "Absolute Focus")
        self.controls = [SimpleNamespace(display_name=name, value=8) for name in names]
        self.available_modes = [
            SimpleNamespace(width=w, height=h, fps=f) for w, h, f in ((640, 480, 30), (640, 480, 60))
        ]
        self.frame_mode: Any = None
        self.frames = self.closed = 0

    def device_list(self) -> list[dict[str, str]]:
        return [{"name": "Wide Cam", "uid": "1:2"}]

    def Capture(self, uid: str) -> FakeUvc:
        assert uid == "1:2"
        return self

    def get_frame(self, timeout: float) -> Any:
        self.frames += 1
        if self.frames > 3:
            raise RuntimeError("stalled")
        stamp = 100.0 + 0.5 * self.frames
        return SimpleNamespace(
            gray=np.zeros((480, 640), np.uint8), bgr=np.ones((480, 640, 3)), timestamp=stamp
        )

    def close(self) -> None:
        self.closed += 1


def test_uvc_driver_fixes_focus_and_exposure() -> None:
    uvc = FakeUvc()
    settings = CameraSettings(640, 480, 60.0, exposure_s=0.005, focus=30, grey=True)
    backend = UvcBackend(uvc, "wide", settings)
    before_s = time_s()
    backend.open()
    assert {c.display_name: c.value for c in uvc.controls} == {
        "Auto Exposure Mode": 1,
        "Absolute Exposure Time": 50,
        "Auto Focus": 0,
        "Absolute Focus": 30,
    }
    assert uvc.frame_mode.fps == 60
    image, t_s = backend.read()
    assert image.shape == (480, 640)
    assert before_s <= t_s <= time_s()
    backend.close()
    with pytest.raises(DeviceError, match=r"no mode 320 x 240; it has 640 x 480 @ 30"):
        UvcBackend(uvc, "0", CameraSettings(320, 240)).open()
    with pytest.raises(DeviceError, match="no camera 'nothing'; found: camera:0 'Wide Cam'"):
        UvcBackend(uvc, "nothing", settings).open()


def test_a_uvc_camera_is_stamped_by_its_own_clock_and_is_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    class OpenError(Exception):
        """As that of pupil-labs-uvc, whose base is ``Exception`` itself."""

    def busy(self: FakeUvc, uid: str) -> FakeUvc:
        raise OpenError("busy")

    uvc = FakeUvc()
    backend = UvcBackend(uvc, "1:2", CameraSettings())
    backend.open()
    # The mode of the rate that is usual, where none is asked for.
    assert uvc.frame_mode.fps == 30
    times = []
    for _ in range(3):
        image, t_s = backend.read()
        times.append(t_s)
        assert image.shape == (480, 640, 3)
    assert np.diff(times) == pytest.approx([0.5, 0.5], abs=1e-6)
    with pytest.raises(DeviceError, match=r"camera:1:2 delivers no frames \(stalled\)"):
        backend.read()
    backend.close()
    backend.close()
    assert uvc.closed == 1
    # A camera that cannot do what is asked must be free for the next attempt.
    with pytest.raises(DeviceError, match="no mode"):
        UvcBackend(uvc, "0", CameraSettings(320, 240)).open()
    assert uvc.closed == 2
    monkeypatch.setattr(FakeUvc, "Capture", busy)
    with pytest.raises(DeviceError, match=r"cannot be opened \(busy\)"):
        UvcBackend(uvc, "0", CameraSettings()).open()


class FakeCapture:
    """The part of ``cv2.VideoCapture`` that is used, of a camera that does not take a focus."""

    def __init__(self) -> None:
        self.values: dict[int, float] = {}
        self.grabs, self.image, self.released = True, np.full((4, 6, 3), (0, 200, 0), np.uint8), False

    def isOpened(self) -> bool:
        return True

    def set(self, key: int, value: float) -> bool:
        self.values[key] = value
        return key != cv2.CAP_PROP_FOCUS

    def grab(self) -> bool:
        return self.grabs

    def retrieve(self) -> tuple[bool, Any]:
        return self.image is not None, self.image

    def release(self) -> None:
        self.released = True


def test_opencv_gets_what_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    capture = FakeCapture()
    monkeypatch.setattr(cv2, "VideoCapture", lambda device: capture)
    backend = OpenCvBackend(3, CameraSettings(640, 480, 60.0, exposure_s=0.005, focus=30, grey=True))
    with pytest.raises(DeviceError, match="camera:3 delivers no frames"):
        backend.read()
    backend.open()
    assert capture.values == {
        cv2.CAP_PROP_BUFFERSIZE: 1,  # the newest image, not the oldest that is left
        cv2.CAP_PROP_FRAME_WIDTH: 640,
        cv2.CAP_PROP_FRAME_HEIGHT: 480,
        cv2.CAP_PROP_FPS: 60,
        cv2.CAP_PROP_AUTO_EXPOSURE: 1,
        cv2.CAP_PROP_EXPOSURE: 50,  # in 0.1 ms
        cv2.CAP_PROP_AUTOFOCUS: 0,
        cv2.CAP_PROP_FOCUS: 30,
    }
    assert "camera:3 does not take focus 30" in caplog.text
    before_s = time_s()
    image, t_s = backend.read()
    assert before_s <= t_s <= time_s()
    assert image.shape == (4, 6)
    assert image[0, 0] == round(0.587 * 200)  # BT.601
    capture.image = None
    with pytest.raises(DeviceError, match="camera:3 has sent a damaged image"):
        backend.read()
    capture.grabs = False
    with pytest.raises(DeviceError, match="camera:3 delivers no frames"):
        backend.read()
    backend.close()
    backend.close()
    assert capture.released
    plain = FakeCapture()
    monkeypatch.setattr(cv2, "VideoCapture", lambda device: plain)
    backend = OpenCvBackend("rtsp://robot", CameraSettings())
    backend.open()
    assert list(plain.values) == [cv2.CAP_PROP_BUFFERSIZE]
    assert backend.read()[0].shape == (4, 6, 3)


def test_a_camera_is_chosen_by_a_part_of_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    there = [FoundCamera("camera:0", "Inner", ""), FoundCamera("camera:7", "Wide Cam", "")]
    opened: list[object] = []
    monkeypatch.setattr(_camera_drivers, "find", lambda: there)
    monkeypatch.setattr(_camera_drivers, "_uvc", lambda: None)
    monkeypatch.setattr(cv2, "VideoCapture", lambda device: opened.append(device) or FakeCapture())
    for which in ("wide", "0"):
        _camera_drivers.choose(which, CameraSettings(), uvc_only=True).open()
    assert opened == [7, 0]
    with pytest.raises(
        DeviceError, match="no camera named 'none'; found: camera:0 'Inner', camera:7 'Wide Cam'"
    ):
        _camera_drivers.choose("none", CameraSettings(), uvc_only=False)
    for which in ("\u00b2", "9" * 5000):  # digits that are no number, and no number of a device
        with pytest.raises(DeviceError, match=r"^no camera named .{1,60}; found: camera:0"):
            _camera_drivers.choose(which, CameraSettings(), uvc_only=False)


def test_a_camera_that_is_not_there_lists_those_that_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """The message needs nothing of Python to go on: it names what ``--source`` takes."""
    closed = SimpleNamespace(isOpened=lambda: False, release=lambda: None)
    monkeypatch.setattr(cv2, "VideoCapture", lambda number: closed)
    there = [FoundCamera("camera:2", "Wide Cam", "/sys/video2")]
    monkeypatch.setattr(_camera_drivers, "find", lambda: there)
    with pytest.raises(
        DeviceError,
        match=r"^no camera camera:0; found: camera:2 'Wide Cam'; connect one and list it with `visuohaptic cameras`$",
    ):
        OpenCvBackend(0, CameraSettings()).open()
    there.clear()
    with pytest.raises(
        DeviceError,
        match=r"^no camera camera:0; found: none; connect one and list it with `visuohaptic cameras`$",
    ):
        OpenCvBackend(0, CameraSettings()).open()


def test_a_stream_and_a_device_are_opened_by_their_address(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither has a number, and libuvc knows neither."""
    opened: list[object] = []
    closed = SimpleNamespace(isOpened=lambda: False, release=lambda: None)
    monkeypatch.setattr(cv2, "VideoCapture", lambda device: opened.append(device) or closed)
    monkeypatch.setattr(_camera_drivers, "find", list)
    with pytest.raises(DeviceError, match=r"^rtsp://robot/front does not answer; check the address"):
        _camera_drivers.choose("rtsp://robot/front", CameraSettings(), uvc_only=False).open()
    with pytest.raises(
        DeviceError,
        match=r"^no camera /dev/video7; found: none; connect one and list it with `visuohaptic cameras`$",
    ):
        _camera_drivers.choose("/dev/video7", CameraSettings(), uvc_only=False).open()
    assert opened == ["rtsp://robot/front", "/dev/video7"]


def test_a_vendor_that_fails_hides_no_other_camera(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Intel's package raises RuntimeError where it has no permission for the bus; Orbbec's lists one camera."""

    def broken() -> None:
        raise RuntimeError("no permission")

    devices = SimpleNamespace(
        get_count=lambda: 1,
        get_device_serial_number_by_index=lambda index: f"S{index}",
        get_device_name_by_index=lambda index: "Gemini",
    )
    modules = {
        "pyrealsense2": SimpleNamespace(camera_info=None, context=broken),
        "pyorbbecsdk": SimpleNamespace(Context=lambda: SimpleNamespace(query_devices=lambda: devices)),
    }
    monkeypatch.setattr(_camera_drivers, "import_module", modules.__getitem__)
    assert [camera.address for camera in _camera_drivers.find()][-1:] == ["orbbec:S0"]
    assert "pyrealsense2 cannot list its cameras (no permission)" in caplog.text
