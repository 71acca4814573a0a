"""Live depth cameras: RealSense and Orbbec, using the vendors' packages if installed.

Both deliver depth registered to the colour image, so that one camera
model is valid for both. The cameras have no pose: it comes from a tracker.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8

from ...core import Camera, Closing, Frame, Pose
from ...core.errors import DeviceError, InputError, needs
from .depth_sequence import DepthFrame


@dataclass(frozen=True, slots=True, eq=False)
class DepthColorImage:
    """Synchronised depth and colour images."""

    depth_m: Float32[np.ndarray, "rows columns"]  #: along the optical axis [m]; NaN: not measured
    color: UInt8[np.ndarray, "rows columns 3"]  #: blue, green, red, registered
    t_s: float  #: on the camera's clock [s]
    index: int  #: frame number; a gap means lost frames, if the camera counts them

    def posed(self, T_world_camera: Pose, camera: Camera) -> DepthFrame:
        """The view as input of fusion and detection.

        Parameters
        ----------
        T_world_camera
            Pose of the camera at the time of the image.
        camera
            Camera model, matching the image size.
        """
        return DepthFrame(self.t_s, self.depth_m, self.color, T_world_camera, camera, self.index)


class LiveDepthSource(Closing):
    """Frames of a live depth camera; implements :class:`visuohaptic.core.robots.FrameSource` with its colour images.

    Parameters
    ----------
    width, height
        Size of the images [px].
    rate_Hz
        Images per second.
    timeout_s
        Time-out for an image [s].
    serial
        Serial number of the camera; by default the first one found.

    Raises
    ------
    MissingExtraError
        The vendor's package is not installed.
    DeviceError
        The camera does not exist, or does not support this image format.
    """

    #: Module of the vendor's package, and the extra that installs it.
    module = ""
    extra = ""
    frame_count: int | None = None  #: a live camera has no end

    def __init__(
        self,
        *,
        width: int = 640,
        height: int = 480,
        rate_Hz: float = 30.0,
        timeout_s: float = 2.0,
        serial: str = "",
    ) -> None:
        if min(width, height) < 1 or not rate_Hz > 0 or not timeout_s > 0:
            raise InputError(
                type(self).__name__,
                f"found {width} x {height} at {rate_Hz} Hz, {timeout_s} s, expected numbers > 0",
            )
        with needs(self.module, self.extra, type(self).__name__):
            self._driver: Any = import_module(self.module)
        self._timeout_ms, self._serial = max(1, round(1e3 * timeout_s)), serial
        self._open = True
        try:
            self._camera = self._start(width, height, round(rate_Hz))
        except Exception as error:
            with suppress(Exception):  # where it had begun: it would be busy for the next attempt
                self._stop()
            raise DeviceError(
                f"{type(self).__name__} cannot be started ({error}); check its cable"
            ) from error

    @abstractmethod
    def _start(self, width: int, height: int, rate_Hz: int) -> Camera:
        """Open the device and return its camera model."""

    @abstractmethod
    def _wait(self) -> DepthColorImage | None:
        """The next image; None on time-out, or if depth or colour is missing."""

    @abstractmethod
    def _stop(self) -> None:
        """Release the device."""

    @property
    def camera(self) -> Camera:
        """Camera model of the images."""
        return self._camera

    def read(self) -> DepthColorImage:
        """Wait for the next image.

        Raises
        ------
        DeviceError
            No image arrived in time, or the camera is closed or disconnected.
        """
        if not self._open:
            raise DeviceError("the camera is closed")
        # Vendor packages raise arbitrary exceptions when a cable is unplugged.
        try:
            found = self._wait()
        except Exception as error:
            raise DeviceError(f"lost the connection to the camera ({error}); check its cable") from error
        if found is None:
            raise DeviceError(f"no frame for {self._timeout_ms} ms; check cable and power of the camera")
        return found

    def __iter__(self) -> Iterator[Frame]:
        """Colour images until the source is closed."""
        while self._open:
            found = self.read()
            yield Frame(found.color, found.t_s, found.index)

    def close(self) -> None:
        """Release the device; may be called repeatedly."""
        if self._open:
            self._open = False
            self._stop()


class RealSenseSource(LiveDepthSource):
    """A RealSense camera via ``pyrealsense2``; parameters as in :class:`LiveDepthSource`."""

    module, extra = "pyrealsense2", "realsense"

    def _start(self, width: int, height: int, rate_Hz: int) -> Camera:
        rs = self._driver
        self._pipeline, config = rs.pipeline(), rs.config()
        if self._serial:
            config.enable_device(self._serial)
        config.enable_stream(rs.stream.depth, width, height, rs.format.z16, rate_Hz)
        config.enable_stream(rs.stream.color, width, height, rs.format.bgr8, rate_Hz)
        profile = self._pipeline.start(config)
        self._scale_m = np.float32(profile.get_device().first_depth_sensor().get_depth_scale())
        self._align = rs.align(rs.stream.color)
        found = profile.get_stream(rs.stream.color).as_video_stream_profile().get_intrinsics()
        return _pinhole(found.width, found.height, found.fx, found.fy, found.ppx, found.ppy)

    def _wait(self) -> DepthColorImage | None:
        frames = self._align.process(self._pipeline.wait_for_frames(self._timeout_ms))
        depth, color = frames.get_depth_frame(), frames.get_color_frame()
        if not depth or not color:
            return None
        return DepthColorImage(
            _metres(np.asanyarray(depth.get_data()), self._scale_m),
            np.array(color.get_data(), dtype=np.uint8),
            1e-3 * float(depth.get_timestamp()),
            int(depth.get_frame_number()),
        )

    def _stop(self) -> None:
        self._pipeline.stop()


class OrbbecSource(LiveDepthSource):
    """An Orbbec camera via ``pyorbbecsdk2`` (module ``pyorbbecsdk``); parameters as in :class:`LiveDepthSource`."""

    module, extra = "pyorbbecsdk", "orbbec"

    def _start(self, width: int, height: int, rate_Hz: int) -> Camera:
        ob = self._driver
        if self._serial:
            devices = ob.Context().query_devices()
            self._pipeline = ob.Pipeline(devices.get_device_by_serial_number(self._serial))
        else:
            self._pipeline = ob.Pipeline()
        config = ob.Config()
        for sensor, kind in (
            (ob.OBSensorType.DEPTH_SENSOR, ob.OBFormat.Y16),
            (ob.OBSensorType.COLOR_SENSOR, ob.OBFormat.RGB),
        ):
            offered = self._pipeline.get_stream_profile_list(sensor)
            config.enable_stream(offered.get_video_stream_profile(width, height, kind, rate_Hz))
        config.set_frame_aggregate_output_mode(ob.OBFrameAggregateOutputMode.FULL_FRAME_REQUIRE)
        self._pipeline.enable_frame_sync()
        self._pipeline.start(config)
        self._count = -1
        self._align = ob.AlignFilter(align_to_stream=ob.OBStreamType.COLOR_STREAM)
        found = self._pipeline.get_camera_param().rgb_intrinsic
        return _pinhole(found.width, found.height, found.fx, found.fy, found.cx, found.cy)

    def _wait(self) -> DepthColorImage | None:
        frames = self._pipeline.wait_for_frames(self._timeout_ms)
        if frames is None:
            return None
        frames = self._align.process(frames).as_frame_set()
        depth, color = frames.get_depth_frame(), frames.get_color_frame()
        if depth is None or color is None:
            return None
        self._count += 1
        shape = (depth.get_height(), depth.get_width())
        # The vendor's scale is in millimetres.
        scale_m = np.float32(1e-3 * depth.get_depth_scale())
        rgb = np.frombuffer(color.get_data(), np.uint8).reshape(color.get_height(), color.get_width(), 3)
        return DepthColorImage(
            _metres(np.frombuffer(depth.get_data(), np.uint16).reshape(shape), scale_m),
            np.ascontiguousarray(rgb[..., ::-1]),
            # Some models have no clock and report 0.
            1e-3 * float(depth.get_timestamp() or depth.get_system_timestamp()),
            self._count,
        )

    def _stop(self) -> None:
        self._pipeline.stop()


def open_depth_camera(which: str) -> LiveDepthSource:
    """Open a live depth camera by its address.

    Parameters
    ----------
    which
        ``realsense:``, ``realsense:SERIAL``, ``orbbec:`` or ``orbbec:SERIAL``.

    Raises
    ------
    InputError
        The address is not that of a depth camera.
    MissingExtraError
        The vendor's package is not installed.
    DeviceError
        The camera does not exist.
    """
    maker, _, serial = which.partition(":")
    makers: dict[str, type[LiveDepthSource]] = {"realsense": RealSenseSource, "orbbec": OrbbecSource}
    if maker not in makers:
        raise InputError(
            which, f"is not a depth camera, expected one of {', '.join(f'{m}:' for m in makers)}"
        )
    return makers[maker](serial=serial)


def _pinhole(width: int, height: int, fx: float, fy: float, cx: float, cy: float) -> Camera:
    return Camera(int(width), int(height), np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]))


def _metres(raw: np.ndarray, scale_m: np.float32) -> Float32[np.ndarray, "rows columns"]:
    """Convert raw depth to metres; 0 means not measured."""
    depth_m = raw.astype(np.float32) * scale_m
    depth_m[raw == 0] = np.nan
    return depth_m
