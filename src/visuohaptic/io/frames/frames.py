"""Opens any source of frames."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from ...core import Camera, FrameSource, InputError
from ...core.files import check_name, read_head
from ..image_folder import ImageFolderSource
from ..ros.sqlite_bag import is_bag
from .live import camera_of, open_camera
from .mcap_frames import McapSource
from .video import VideoSource

_TOPIC = re.compile(r"^(.+):(/.*)$")
_RECORDING = re.compile(r".+\.(?:mcap(?:\.part)?|db3)")


def open_source(
    source: str | Path,
    *,
    camera: Camera | None = None,
    start_s: float = 0.0,
    stop_s: float = float("inf"),
    rate_Hz: float | None = None,
    grey: bool = False,
) -> FrameSource:
    """Open frames of any format; the format is detected from the address and the file contents.

    Parameters
    ----------
    source
        - a folder of images (times: ``times.csv``, file names, or ``rate_Hz``)
        - ``run.mcap`` or ``run.mcap:/camera/image``, ROS 2 images; ``run.db3`` and folders of ``ros2 bag`` as well (``run:/camera/image``)
        - ``0``, ``camera:0``, ``camera:NAME`` or ``/dev/video0``, a live camera by number, part of its
          name or device file; ``uvc:0`` warns if the precise driver is not installed
        - ``rtsp://host/path`` and other stream addresses
        - ``realsense:`` or ``realsense:SERIAL``, ``orbbec:``: colour images of a depth camera via the vendor's package
        - any other file: a video
    camera
        Camera model; the images must have its size.
    start_s, stop_s
        Section of a recording, relative to its first frame [s]; not for live cameras.
    rate_Hz
        Frame rate of an image folder without times; requested rate of a live camera.
    grey
        Deliver grey images, which is faster if colour is not needed.

    Raises
    ------
    InputError
        One line: which file, what was found, what was expected.
    DeviceError
        The live camera does not exist.

    Examples
    --------
    >>> from pathlib import Path
    >>> import cv2, numpy as np
    >>> Path("frames").mkdir()
    >>> for number in range(3):
    ...     _ = cv2.imwrite(f"frames/{number}.png", np.full((8, 10), 50 * number, np.uint8))
    >>> with open_source("frames", rate_Hz=30.0) as source:
    ...     for frame in source:
    ...         print(f"{frame.t_s:.3f} s", frame.image.shape[:2], int(frame.image.mean()))
    0.000 s (8, 10) 0
    0.033 s (8, 10) 50
    0.067 s (8, 10) 100
    """
    text = str(source)
    live = camera_of(text)
    if live:
        if start_s > 0 or stop_s != float("inf"):
            raise InputError(text, "is live: start and stop are for recordings only")
        return open_camera(live[0], uvc_only=live[1], camera=camera, rate_Hz=rate_Hz, grey=grey)
    topic = _TOPIC.match(text)
    if topic and not (_RECORDING.fullmatch(topic[1]) or is_bag(Path(topic[1]))):
        topic = None
    path = check_name(topic[1] if topic else text)
    part: dict[str, Any] = {"camera": camera, "start_s": start_s, "stop_s": stop_s, "grey": grey}
    if is_bag(path):
        return McapSource(path, topic[2] if topic else None, **part)
    if path.is_dir():
        return ImageFolderSource(path, rate_Hz=rate_Hz, **part)
    try:
        head = read_head(path, 8)
    except InputError as error:
        raise InputError(
            text,
            error.problem,
            remedy=error.remedy
            or "expected a video, a folder of images, file.mcap[:/topic] or a camera (0, /dev/video0, rtsp://...)",
        ) from error
    if not head:
        raise InputError(text, "is empty")
    if head.startswith(b"\x89MCAP") or topic or path.suffix == ".mcap":
        return McapSource(path, topic[2] if topic else None, **part)
    return VideoSource(path, **part)
