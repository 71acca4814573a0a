"""Live cameras: fixed focus and exposure, latest frame, reconnection."""

from __future__ import annotations

import logging
import re
import threading
import time
from collections.abc import Callable

import numpy as np
from jaxtyping import UInt8

from ...core import Camera, DeviceError, Frame, StaleFrameError
from ..source import LiveFrames
from .camera_backend import CameraBackend, CameraSettings, FoundCamera, time_s

_log = logging.getLogger(__name__)

#: ``realsense:`` or ``orbbec:SERIAL``; ``camera:0`` and ``uvc:NAME``; a bare number; a device file; the address of a stream.
_DEPTH = re.compile(r"(?:realsense|orbbec)(?=:|$)")
_LIVE = re.compile(r"(?:(?P<driver>uvc|camera):)?(?P<which>.+)")
_BARE = re.compile(r"[0-9]{1,4}|/dev/video\d+|(?:rtsps?|rtmp|udp|tcp|https?)://.+")


class LiveSource(LiveFrames):
    """Frames of a live camera; implements :class:`visuohaptic.core.robots.FrameSource`.

    A thread fetches every image from the driver, so that the latest one never
    waits behind a queue of old ones. Frames skipped by a slow reader leave a
    gap in ``Frame.index``, and so does a reconnection.

    Parameters
    ----------
    backend
        The driver.
    camera
        Camera model, if known; images of another size are rejected.
    reconnect_s
        Time [s] to look for a lost device before reading fails.
    clock
        Clock of the driver's timestamps [s]; seconds since the epoch.
    """

    def __init__(
        self,
        backend: CameraBackend,
        *,
        camera: Camera | None = None,
        reconnect_s: float = 10.0,
        clock: Callable[[], float] | None = None,
    ) -> None:
        self._backend = backend
        self._camera = camera
        self._reconnect_s = reconnect_s
        # Longer than a reconnection may take, during which no frames arrive.
        self._patience_s = reconnect_s + 5.0
        self._clock = clock or time_s
        self._new = threading.Condition()
        self._frame: Frame | None = None
        self._problem: Exception | None = None
        self._next_index = 0
        self._last_read = -1
        self.reconnections = 0  #: number of reconnections to a lost device
        backend.open()
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()

    @property
    def camera(self) -> Camera | None:
        """Camera model, if known: the given one, or the vendor's."""
        return self._camera or getattr(self._backend, "camera", None)

    def read(self, timeout_s: float = 2.0) -> Frame:
        """Wait for a frame newer than all frames read before.

        Parameters
        ----------
        timeout_s
            Maximum wait [s].

        Raises
        ------
        DeviceError
            No frame arrived in time, or the device is lost.
        """
        with self._new:
            before = self._last_read
            until = time.monotonic() + timeout_s
            while self._running and self._problem is None:
                if self._frame is not None and self._frame.index > before:
                    self._last_read = self._frame.index
                    return self._frame
                left = until - time.monotonic()
                if left <= 0 or not self._new.wait(left):
                    break
            self._raise_problem()
        raise DeviceError(f"no frame for {timeout_s} s; check cable and power of the camera")

    def read_latest(self, max_age_ms: float = 100.0) -> Frame:
        """The latest frame, without waiting.

        Parameters
        ----------
        max_age_ms
            Maximum age of the frame [ms].

        Raises
        ------
        StaleFrameError
            There is no frame yet, or it is older than ``max_age_ms``.
        DeviceError
            The device is lost.
        """
        with self._new:
            self._raise_problem()
            frame = self._frame
        if frame is None:
            raise StaleFrameError("the camera has delivered no frame yet; wait with read()")
        self.check_age(self._clock() - frame.t_s, max_age_ms)
        return frame

    def close(self) -> None:
        """Stop the thread and release the device; may be called repeatedly."""
        with self._new:
            self._running = False
            self._new.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout=5.0)
        self._backend.close()

    def _raise_problem(self) -> None:
        if self._problem is not None:
            raise DeviceError(str(self._problem)) from self._problem
        if not self._running:
            raise DeviceError("the camera is closed")

    def _run(self) -> None:
        while self._running:
            try:
                try:
                    image, t_s = self._backend.read()
                    self._deliver(image, t_s)
                except DeviceError as error:
                    if self._running and not self._reconnect(error):
                        return
            except Exception as error:  # noqa: BLE001 - the reader gets it, in its own thread
                self._fail(error)
                return

    def _deliver(self, image: UInt8[np.ndarray, "rows columns *colour"], t_s: float) -> None:
        if self._camera:
            self._camera.check_size("live camera", image.shape[1], image.shape[0])
        with self._new:
            self._frame = Frame(image, t_s, self._next_index)
            self._next_index += 1
            self._new.notify_all()

    def _reconnect(self, error: DeviceError) -> bool:
        """Look for the device with increasing pauses."""
        _log.warning("camera lost (%s), looking for it for %.0f s", error, self._reconnect_s)
        until = time.monotonic() + self._reconnect_s
        pause = 0.05
        problem: Exception = error
        while self._running and time.monotonic() < until:
            try:
                self._backend.close()
                self._backend.open()
            except DeviceError as again:
                problem = again
                with self._new:  # ends early when the source is closed
                    self._new.wait_for(lambda: not self._running, pause)
                pause = min(2 * pause, 1.0)
                continue
            self.reconnections += 1
            self._next_index += 1  # at least one frame is missing
            return True
        if self._running:
            self._fail(problem)
        return False

    def _fail(self, problem: Exception) -> None:
        with self._new:
            self._problem = problem
            self._new.notify_all()


def camera_of(source: str) -> tuple[str, bool] | None:
    """Which live camera a source refers to; ``None`` for a recording.

    Parameters
    ----------
    source
        ``0``, ``camera:0``, ``camera:NAME``, ``uvc:0``, ``/dev/video0``, ``rtsp://host/path``, ``realsense:``,
        ``realsense:SERIAL``, ``orbbec:``, or a file.

    Returns
    -------
    tuple or None
        Arguments ``which`` and ``uvc_only`` of :func:`open_camera`.

    Examples
    --------
    >>> camera_of("0"), camera_of("/dev/video2"), camera_of("uvc:Wide")
    (('0', False), ('/dev/video2', False), ('Wide', True))
    >>> camera_of("realsense")[0], camera_of("realsense:0123")[0]
    ('realsense:', 'realsense:0123')
    >>> camera_of("rtsp://robot/front")[0], camera_of("push.mp4")
    ('rtsp://robot/front', None)
    """
    if maker := _DEPTH.match(source):
        return f"{maker[0]}:{source[maker.end() + 1 :]}", False
    match = _LIVE.fullmatch(source)
    if match is None or not (match["driver"] or _BARE.fullmatch(source)):
        return None
    return match["which"], match["driver"] == "uvc"


def find_cameras() -> list[FoundCamera]:
    """Connected cameras; an empty list if there are none.

    Examples
    --------
    >>> for camera in find_cameras():  # doctest: +SKIP
    ...     print(camera)
    >>> isinstance(find_cameras(), list)
    True
    """
    from . import _camera_drivers

    return _camera_drivers.find()


def open_camera(
    which: str,
    *,
    uvc_only: bool = False,
    camera: Camera | None = None,
    rate_Hz: float | None = None,
    grey: bool = False,
    settings: CameraSettings | None = None,
) -> LiveSource:
    """Open a live camera by number or part of its name.

    Parameters
    ----------
    which
        Number, part of the name, device file, address of a stream or depth camera; see :func:`camera_of`.
    uvc_only
        Warn if the precise driver (pupil-labs-uvc), which sets focus and exposure with UVC
        controls, is not installed. OpenCV is the fallback.
    camera
        Camera model, if known; determines the size of the images.
    rate_Hz
        Frame rate [Hz].
    grey
        Whether to deliver grey images.
    settings
        All settings at once, instead of those above.

    Raises
    ------
    DeviceError
        The camera does not exist or cannot be opened.

    Examples
    --------
    >>> with open_camera("0", grey=True) as camera:  # doctest: +SKIP
    ...     frame = camera.read_latest(max_age_ms=50)
    >>> from visuohaptic.core import DeviceError
    >>> try:
    ...     open_camera("no camera has this name")
    ... except DeviceError as error:
    ...     "no camera has this name" in str(error)
    True
    """
    from . import _camera_drivers

    if settings is None:
        settings = CameraSettings(
            camera.width if camera else None, camera.height if camera else None, rate_Hz, grey=grey
        )
    return LiveSource(_camera_drivers.choose(which, settings, uvc_only=uvc_only), camera=camera)
