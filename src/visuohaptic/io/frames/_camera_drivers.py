"""Drivers of live cameras: pupil-labs-uvc, OpenCV as fallback, and vendors' drivers of depth cameras."""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from ...core import Camera, DeviceError, brief
from ...core.camera.frame import USUAL_RATE_Hz
from .camera_backend import CameraBackend, CameraSettings, FoundCamera, time_s

_log = logging.getLogger(__name__)


def _uvc() -> Any:
    try:
        import uvc
    except ImportError:
        return None
    return uvc


def _realsense(rs: Any) -> list[FoundCamera]:
    """RealSense cameras that the vendor's package finds."""
    key = rs.camera_info
    found = [(d.get_info(key.serial_number), d.get_info(key.name)) for d in rs.context().query_devices()]
    return [FoundCamera(f"realsense:{serial}", name, serial) for serial, name in found]


def _orbbec(ob: Any) -> list[FoundCamera]:
    """Orbbec cameras that the vendor's package finds."""
    devices = ob.Context().query_devices()
    found = [
        (devices.get_device_serial_number_by_index(index), devices.get_device_name_by_index(index))
        for index in range(devices.get_count())
    ]
    return [FoundCamera(f"orbbec:{serial}", name, serial) for serial, name in found]


def find() -> list[FoundCamera]:
    """Find UVC cameras or video devices of the system, and depth cameras whose vendor's package is installed."""
    found = _video()
    for package, listed in (("pyrealsense2", _realsense), ("pyorbbecsdk", _orbbec)):
        try:
            found += listed(import_module(package))
        except ImportError:
            continue
        except Exception as error:  # noqa: BLE001 - RuntimeError of both, OBError of Orbbec's, AttributeError of another version
            # The cameras of the others are still listed.
            _log.warning("%s cannot list its cameras (%s)", package, error)
    return found


def _video() -> list[FoundCamera]:
    uvc = _uvc()
    if uvc is not None:
        devices = uvc.device_list() or []
        return [
            FoundCamera(f"camera:{number}", str(device.get("name", "")), str(device.get("uid", "")))
            for number, device in enumerate(devices)
        ]
    found = []
    for entry in sorted(Path("/sys/class/video4linux").glob("video*"), key=lambda e: int(e.name[5:])):
        try:
            name = (entry / "name").read_text().strip()
            # A camera's metadata nodes have an index above 0 and deliver no images.
            if (entry / "index").read_text().strip() != "0":
                continue
        except OSError:
            continue
        found.append(FoundCamera(f"camera:{entry.name[5:]}", name, str(entry.resolve())))
    return found


def _listed(found: Sequence[FoundCamera]) -> str:
    return ", ".join(f"{camera.address} {camera.name!r}" for camera in found) or "none"


def choose(which: str, settings: CameraSettings, *, uvc_only: bool) -> CameraBackend:
    """The best driver for a camera given by number, part of its name, device file, stream address or vendor.

    Parameters
    ----------
    which
        Number, name, device file, address or vendor.
    settings
        Of the camera.
    uvc_only
        Warn if libuvc is not available.
    """
    maker, depth, serial = which.partition(":")
    if depth and maker in ("realsense", "orbbec"):
        return DepthCameraBackend(maker, serial, settings)
    if which.startswith("/") or "://" in which:
        return OpenCvBackend(which, settings)
    uvc = _uvc()
    if uvc is not None:
        return UvcBackend(uvc, which, settings)
    if uvc_only:
        _log.warning("pupil-labs-uvc is not installed: OpenCV reads the camera, time stamps are less exact")
    if not re.fullmatch("[0-9]{1,4}", which):
        found = find()
        match = [c for c in found if which.lower() in c.name.lower()]
        if not match:
            raise DeviceError(f"no camera named {brief(which)}; found: {_listed(found)}")
        which = match[0].address.partition(":")[2]
    return OpenCvBackend(int(which), settings)


class UvcBackend:
    """A UVC camera via libuvc: fixed focus and exposure, hardware timestamps.

    Parameters
    ----------
    uvc
        The module ``uvc``.
    which
        Number of the camera, or part of its name.
    settings
        Of the camera.
    """

    def __init__(self, uvc: Any, which: str, settings: CameraSettings) -> None:
        self._uvc, self._which, self._settings = uvc, which, settings
        self._capture: Any = None
        self._offset_s: float | None = None

    def open(self) -> None:
        devices = self._uvc.device_list() or []
        match = [d for n, d in enumerate(devices) if str(n) == self._which or d.get("uid") == self._which]
        if not match and not self._which.isdigit():
            match = [d for d in devices if self._which.lower() in str(d.get("name", "")).lower()]
        if not match:
            found = [FoundCamera(f"camera:{n}", str(d.get("name", "")), "") for n, d in enumerate(devices)]
            raise DeviceError(f"no camera {brief(self._which)}; found: {_listed(found)}")
        try:
            self._capture = self._uvc.Capture(match[0]["uid"])
            self._set_mode()
            self._set_controls()
        except DeviceError:
            self.close()
            raise
        except Exception as error:
            # The library's exceptions (OpenError, InitError, StreamError) have no common base class.
            self.close()
            raise DeviceError(f"camera:{self._which} cannot be opened ({error})") from error
        self._offset_s = None

    def _set_mode(self) -> None:
        requested = self._settings
        modes = [
            mode
            for mode in self._capture.available_modes
            if requested.width in (None, mode.width) and requested.height in (None, mode.height)
        ]
        if not modes:
            listed = ", ".join(f"{m.width} x {m.height} @ {m.fps}" for m in self._capture.available_modes)
            raise DeviceError(
                f"the camera has no mode {requested.width} x {requested.height}; it has {listed}"
            )
        rate = requested.rate_Hz or USUAL_RATE_Hz
        self._capture.frame_mode = min(modes, key=lambda m: (abs(m.fps - rate), -m.width * m.height))

    def _set_controls(self) -> None:
        controls = {control.display_name: control for control in self._capture.controls}

        def put(name: str, value: float) -> None:
            if name in controls:
                controls[name].value = round(value)
            else:
                _log.warning("the camera has no control %r", name)

        if self._settings.exposure_s is not None:
            put("Auto Exposure Mode", 1)  # manual
            put("Absolute Exposure Time", self._settings.exposure_s * 1e4)  # in 0.1 ms
        if self._settings.focus is not None:
            put("Auto Focus", 0)
            put("Absolute Focus", self._settings.focus)

    def read(self) -> tuple[UInt8[np.ndarray, "rows columns *colour"], float]:
        try:
            frame = self._capture.get_frame(timeout=1.0)
            image = np.array(frame.gray if self._settings.grey else frame.bgr)
        except Exception as error:
            raise DeviceError(f"camera:{self._which} delivers no frames ({error})") from error
        if self._offset_s is None:
            # Its timestamps are regular, but have an arbitrary offset.
            self._offset_s = time_s() - float(frame.timestamp)
        return image, float(frame.timestamp) + self._offset_s

    def close(self) -> None:
        if self._capture is not None:
            self._capture.close()
            self._capture = None


class DepthCameraBackend:
    """Colour images of a depth camera via the vendor's package, which provides the camera model.

    Parameters
    ----------
    maker
        ``realsense`` or ``orbbec``.
    serial
        Serial number; empty for any.
    settings
        Of the camera.
    """

    def __init__(self, maker: str, serial: str, settings: CameraSettings) -> None:
        self._maker, self._serial, self._settings = maker, serial, settings
        self._source: Any = None
        self._offset_s: float | None = None
        self.camera: Camera | None = None  #: the vendor's camera model

    def open(self) -> None:
        from ..depth.depth_live import OrbbecSource, RealSenseSource

        make = RealSenseSource if self._maker == "realsense" else OrbbecSource
        given = {
            name: value
            for name in ("width", "height", "rate_Hz")
            if (value := getattr(self._settings, name)) is not None
        }
        self._source, self._offset_s = make(serial=self._serial, **given), None
        self.camera = self._source.camera

    def read(self) -> tuple[UInt8[np.ndarray, "rows columns *colour"], float]:
        import cv2

        if self._source is None:
            raise DeviceError(f"{self._maker}: delivers no frames")
        found = self._source.read()
        if self._offset_s is None:
            self._offset_s = time_s() - found.t_s
        image = cv2.cvtColor(found.color, cv2.COLOR_BGR2GRAY) if self._settings.grey else found.color
        return image, found.t_s + self._offset_s

    def close(self) -> None:
        if self._source is not None:
            self._source.close()
            self._source = None


class OpenCvBackend:
    """Any camera or stream that OpenCV opens; timestamped on arrival, later than the exposure.

    Parameters
    ----------
    device
        Number, device file or address.
    settings
        Of the camera.
    """

    def __init__(self, device: int | str, settings: CameraSettings) -> None:
        self._device, self._settings = device, settings
        self._name = f"camera:{device}" if isinstance(device, int) else device
        self._capture: Any = None

    def open(self) -> None:
        import cv2

        capture = cv2.VideoCapture(self._device)
        if not capture.isOpened():
            capture.release()
            if "://" in self._name:
                raise DeviceError(
                    f"{self._name} does not answer; check the address, the network and the login"
                )
            raise DeviceError(
                f"no camera {self._name}; found: {_listed(find())}; connect one and list it with `visuohaptic cameras`"
            )
        requested = self._settings
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        properties = [
            (cv2.CAP_PROP_FRAME_WIDTH, requested.width, "width"),
            (cv2.CAP_PROP_FRAME_HEIGHT, requested.height, "height"),
            (cv2.CAP_PROP_FPS, requested.rate_Hz, "rate"),
        ]
        if requested.exposure_s is not None:
            # In Video4Linux, which OpenCV passes through, 1 means manual and the unit is 0.1 ms.
            properties += [
                (cv2.CAP_PROP_AUTO_EXPOSURE, 1, "manual exposure"),
                (cv2.CAP_PROP_EXPOSURE, requested.exposure_s * 1e4, "exposure"),
            ]
        if requested.focus is not None:
            properties += [
                (cv2.CAP_PROP_AUTOFOCUS, 0, "fixed focus"),
                (cv2.CAP_PROP_FOCUS, requested.focus, "focus"),
            ]
        for key, value, name in properties:
            if value is not None and not capture.set(key, float(value)):
                _log.warning("%s does not take %s %s", self._name, re.sub("_", " ", name), value)
        self._capture = capture

    def read(self) -> tuple[UInt8[np.ndarray, "rows columns *colour"], float]:
        import cv2

        if self._capture is None or not self._capture.grab():
            raise DeviceError(f"{self._name} delivers no frames")
        t_s = time_s()
        good, image = self._capture.retrieve()
        if not good:
            raise DeviceError(f"{self._name} has sent a damaged image")
        if self._settings.grey and image.ndim == 3:
            image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        return image, t_s

    def close(self) -> None:
        if self._capture is not None:
            self._capture.release()
            self._capture = None
