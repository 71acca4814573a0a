"""A recorded mission: log and live page of the demo, small enough to be shipped, replayed in seconds.

The file is a ZIP of ``events.json`` (lines and states in their order), ``report.html`` and the camera's
images as WebP. A replay computes nothing, so it needs no optional dependency and no compiled kernel.
"""

from __future__ import annotations

import json
import re
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core import ForceProfile, InputError, Pose, decode_image, from_dict, write_text

if TYPE_CHECKING:
    from ..viewer.page import LivePage


#: The mission of seed 2 that comes with the package; ``python docs/pictures.py mission`` records it again.
RECORDED = Path(__file__).with_name("mission.zip")
#: Maximum size of a recording that is read into memory [bytes].
MAX_BYTES = 64 * 2**20
#: Text of a line about the recording's own computing time.
_TIME_LEFT = re.compile(r" +\((?:about )?\d+ s(?: left)?\)$")


def replay(
    folder: Path | str,
    *,
    on_message: Callable[[str], None],
    page: LivePage | None = None,
    recording: Path | str = RECORDED,
    pause_s: float = 0.03,
) -> Path:
    """Replay a recorded mission, and write its report.

    Parameters
    ----------
    folder
        Receives ``report.html``.
    on_message
        Called with each line of the log.
    page
        Live page of the pushes.
    recording
        A recorded mission.
    pause_s
        Pause before each line and state [s].

    Returns
    -------
    Path
        The report.

    Raises
    ------
    InputError
        The file is not a recorded mission, or larger than 64 MiB when unpacked.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with zipfile.ZipFile(recording) as archive:
            if (size := sum(entry.file_size for entry in archive.infolist())) > MAX_BYTES:
                raise ValueError(f"unpacks to {size} bytes, expected at most {MAX_BYTES}")
            write_text(folder / "report.html", archive.read("report.html").decode())
            events = json.loads(archive.read("events.json"))
            pictures = (archive.read(name) for name in sorted(archive.namelist()) if name.endswith(".webp"))
            for event in events:
                picture = next(pictures) if event[0] == "update" else None
                if event[0] == "line":
                    on_message(_TIME_LEFT.sub("", event[1]))
                elif page is not None:
                    _show(page, event, picture)
                else:
                    continue
                time.sleep(pause_s)
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise InputError(recording, f"is not a recorded mission ({error})") from error
    return folder / "report.html"


def _show(page: LivePage, event: list[Any], picture: bytes | None) -> None:
    kind, *values = event
    if kind == "map":
        page.set_map(np.array(values[0], np.int8), values[1], tuple(values[2]))
    elif kind == "obstacle":
        name, outline_m, matrix, height_m, fixed = values
        pose = Pose.from_matrix(np.array(matrix))
        page.set_obstacle(name, np.array(outline_m), pose, height_m=height_m, fixed=fixed)
    elif kind == "tags":
        page.set_tags(values[0])
    elif kind == "update":
        t_s, profile, truth_N, place, note = values
        page.update(
            t_s,
            frame_bgr=decode_image(picture or b"", "recorded mission"),
            profile=from_dict(ForceProfile, profile, where="recorded mission"),
            truth_N=truth_N,
            T_world_foam=None if place is None else Pose.from_matrix(np.array(place)),
            note=note,
        )
