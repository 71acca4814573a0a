"""A folder of images as a source of frames."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from ..core import Camera, InputError
from ..core.files import ImageMode, read_csv, read_image
from .source import RecordedSource

_log = logging.getLogger(__name__)

_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".tif", ".tiff"}
#: ``left_0012.500.png`` or ``frame_12.5.jpg``: decimal seconds at the end of the name.
_SECONDS = re.compile(r"(?:^|[^0-9.])(\d+\.\d+)$")


def natural(name: str) -> list[tuple[int, int, str]]:
    """Natural sort key: ``img10`` comes after ``img9``.

    Parameters
    ----------
    name
        File name.
    """
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in re.split(r"(\d+)", name)]


def seconds_in(paths: Iterable[Path]) -> list[float]:
    """Times at the end of the file names [s]; empty if any name has none.

    Parameters
    ----------
    paths
        Paths of the images.
    """
    matches = [_SECONDS.search(path.stem) for path in paths]
    return [float(match[1]) for match in matches if match] if all(matches) else []


def _times_from_csv(table: Path, names: list[str]) -> tuple[list[str], list[float]]:
    """File names and times of ``times.csv`` (columns ``file``, ``t_s``; or only ``t_s``, in order)."""
    columns, read = read_csv(table, ("t_s",))
    rows = list(read)
    times = [row.number("t_s") for row in rows]
    if "file" in columns:
        listed, known = [row["file"] for row in rows], set(names)
        if missing := next((name for name in listed if name not in known), None):
            raise InputError(table, f"{missing!r} is not an image of the folder", field="file")
        return listed, times
    if len(times) != len(names):
        raise InputError(table, f"found {len(times)} times, expected {len(names)}, one for each image")
    return names, times


class ImageFolderSource(RecordedSource):
    """Images of a folder, in natural order of their names.

    Times come from the first available source: ``times.csv`` in the
    folder (columns ``file`` and ``t_s``), names that end in seconds
    (``left_12.533.png``), ``rate_Hz``.

    Parameters
    ----------
    folder
        Folder with the images.
    camera
        Camera model, if known; its size must match the images.
    rate_Hz
        Frame rate, if neither a table nor the names specify times [Hz].
    start_s, stop_s
        Section of the recording, relative to its first frame [s]; ``stop_s`` is exclusive.
    grey
        Whether to read images as grey.

    Raises
    ------
    InputError
        There are no images or no times.
    """

    def __init__(
        self,
        folder: Path | str,
        *,
        camera: Camera | None = None,
        rate_Hz: float | None = None,
        start_s: float = 0.0,
        stop_s: float = float("inf"),
        grey: bool = False,
    ) -> None:
        folder = Path(folder)
        try:
            # Systems leave hidden companions of images (._a.png), which would count as frames.
            names = [
                entry.name
                for entry in folder.iterdir()
                if entry.suffix.lower() in _SUFFIXES and not entry.name.startswith(".")
            ]
        except OSError as error:
            raise InputError(folder, f"cannot be read ({error.strerror})") from error
        if not names:
            raise InputError(folder, f"found no images, expected files with {', '.join(sorted(_SUFFIXES))}")
        names.sort(key=natural)
        names, times = self._times(folder, names, rate_Hz)
        order = np.argsort(times, kind="stable")
        self._paths = [folder / names[place] for place in order]
        self._grey = grey
        super().__init__(str(folder), times[order], camera=camera, start_s=start_s, stop_s=stop_s)

    @staticmethod
    def _times(
        folder: Path, names: list[str], rate_Hz: float | None
    ) -> tuple[list[str], Float[np.ndarray, "n"]]:
        table = folder / "times.csv"
        if table.is_file():
            names, listed = _times_from_csv(table, names)
            return names, np.array(listed)
        if seconds := seconds_in(map(Path, names)):
            return names, np.array(seconds)
        if rate_Hz is None:
            raise InputError(
                folder,
                "its images have no times",
                remedy="add times.csv (columns file, t_s), name the files ..._<seconds>.png, "
                "or give the frame rate (rate_Hz; --rate-Hz)",
            )
        if not (np.isfinite(rate_Hz) and rate_Hz > 0):
            raise InputError("rate_Hz", f"found {rate_Hz}, expected > 0")
        return names, np.arange(len(names)) / rate_Hz

    def _images(
        self, chosen: Int[np.ndarray, "k"]
    ) -> Iterator[tuple[int, UInt8[np.ndarray, "rows columns *colour"]]]:
        mode: ImageMode = "grey" if self._grey else "any"
        for position, place in enumerate(chosen):
            try:
                image = read_image(self._paths[place], mode, check_pixels=False)
            except InputError as error:
                _log.warning("frame skipped: %s", error)
                continue
            yield position, image
