"""A small example recording for the foam sensor: files as recorded with a webcam and a strip of foam."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from ..core.errors import InputError, needs
from ..core.files import atomic_path, write_csv
from ..simulation.foam import FoamStripGeometry, PressShape, calibration_press, press
from ..simulation.foam.strip_law import write_calibration_csv
from .virtual_sensor import VirtualSensor, rest_scene

#: The 12 cm cylinder is pressed 8 mm deep and retracted, with this number of frames each.
_DEEPEST_M, _FRAMES = 0.008, 40
#: Rate factor of videos: from 10 to 20 the rms error of its force grows from 15 to 16 mN, and 54 MB become 14.
_CRF = 20


def write_example(
    folder: Path | str, *, seed: int = 1, on_message: Callable[[str], None] = lambda text: None
) -> Path:
    """Write press log, camera and sensor files, two videos and the truth.

    ``strain_stress.csv`` is the record of a press on the foam, ``rest.mp4`` shows
    the untouched strip, ``push.mp4`` a cylinder that is pressed into it and
    retracted; ``truth.csv`` contains the true force (t_s, force_N, depth_m).

    Parameters
    ----------
    folder
        Output folder.
    seed
        Seed of all noise sources.
    on_message
        Called with the name of each step.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    virtual = VirtualSensor()
    rows = calibration_press(
        geometry=FoamStripGeometry(spacing_m=0.002), reference_sigma_N=virtual.press_sigma_N, rng=rng
    )
    write_calibration_csv(folder / "strain_stress.csv", rows)
    virtual.rig.write(folder)
    renderer = virtual.renderer()
    on_message("rendering rest.mp4")
    write_video(folder / "rest.mp4", renderer.repeated(rest_scene(virtual.geometry), 20, rng=rng))
    depths = _DEEPEST_M * np.sin(np.linspace(0.0, np.pi, 2 * _FRAMES + 1)) ** 2
    truth: list[tuple[float, float, float]] = []

    def frames() -> Iterator[UInt8[np.ndarray, "rows columns"]]:
        for index, sample in enumerate(press(PressShape.CYLINDER_12CM, depths, geometry=virtual.geometry)):
            truth.append((index / virtual.frame_rate_Hz, sample.strip.load_N, sample.depth_m))
            yield renderer.render(sample.scene, rng=rng)

    on_message("rendering push.mp4")
    write_video(folder / "push.mp4", frames())
    write_truth(folder, ("t_s", "force_N", "depth_m"), truth)
    return folder


def write_truth(folder: Path, columns: Sequence[str], rows: Iterable[Iterable[float]]) -> None:
    """Write ``truth.csv``: the true values of each frame.

    Parameters
    ----------
    folder
        Existing folder.
    columns
        Column names with units.
    rows
        One row per frame.
    """
    write_csv(folder / "truth.csv", columns, ([f"{value:.6f}" for value in row] for row in rows))


def write_video(path: Path | str, images: Iterable[UInt8[np.ndarray, "rows columns"]]) -> None:
    """Write grey images as H.264 at 30 frames per second; sizes must be even.

    Parameters
    ----------
    path
        Output file.
    images
        Grey images (rows, columns).

    Raises
    ------
    InputError
        There is no image, or they differ in size, or are not 8-bit with an even number of rows and columns; an older
        file is kept.
    """
    with needs("av", "recording", "writing a video"):
        import av

    with atomic_path(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        stream = None
        for image in images:
            size = image.shape if stream is None else (stream.height, stream.width)
            if (
                image.dtype != np.uint8
                or image.shape != size
                or len(size) != 2
                or any(n % 2 or not n for n in size)
            ):
                found = f"found {image.dtype} {image.shape}"
                raise InputError(
                    path, f"{found}, expected uint8 (rows, columns), both even and always the same"
                )
            if stream is None:
                stream = container.add_stream("libx264", rate=30)
                stream.height, stream.width = image.shape
                stream.pix_fmt = "yuv420p"
                stream.time_base = Fraction(1, 30)
                # Grey levels are preserved only in full range. Noise is not reduced by motion
                # estimation, which the fastest preset omits.
                stream.options = {"crf": str(_CRF), "preset": "ultrafast", "x264-params": "fullrange=on"}
                stream.codec_context.color_range = 2
            frame = av.VideoFrame.from_ndarray(image, format="gray")
            for packet in stream.encode(frame.reformat(format="yuv420p", dst_color_range="JPEG")):
                container.mux(packet)
        if stream is None:
            raise InputError(path, "found no image, expected one or more")
        for packet in stream.encode():
            container.mux(packet)
