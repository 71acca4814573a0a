"""A recorded mission: what the demo said and showed, small enough to be shipped, replayed in seconds.

The file is a ZIP of ``events.json`` (lines and states in their order), ``report.html`` and the camera's
pictures as JPEG. Nothing is computed when it is replayed, so that it needs no extra and no kernel.
"""

from __future__ import annotations

import json
import re
import time
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int8, UInt8

from ..core.camera.pose import Pose
from ..core.codec import from_dict, to_dict
from ..core.errors import InputError
from ..core.files import atomic_path, decode_image, write_text
from ..core.measurement import ForceProfile
from ..core.objects import HapticTag

if TYPE_CHECKING:
    from ..viewer.page import LivePage

__all__ = ["RECORDED", "MissionRecorder", "replay"]

#: The mission of seed 2 that comes with the package; ``python docs/pictures.py mission`` records it again.
RECORDED = Path(__file__).with_name("mission.zip")
#: Every n-th state of the platform is kept, its pictures this wide [px].
_EVERY, _WIDTH_PX, _QUALITY = 8, 480, 45
#: What a line said of the recording's own computing time.
_TIME_LEFT = re.compile(r" +\((?:about )?\d+ s(?: left)?\)$")


class MissionRecorder:
    """Takes the place of the live page, and of the terminal, while a mission is recorded."""

    def __init__(self) -> None:
        self.events: list[list[Any]] = []
        self.pictures: list[bytes] = []
        self._updates = 0

    def log(self, text: str) -> None:
        """Take a line of the story.

        Parameters
        ----------
        text
            Without its end.
        """
        self.events.append(["line", text])

    def set_map(
        self, cells: Int8[np.ndarray, "rows columns"], resolution_m: float, origin_world_m: tuple[float, ...]
    ) -> None:
        """As the page's.

        Parameters
        ----------
        cells
            -1 unknown, 0 free, 100 occupied.
        resolution_m
            Edge of a cell [m].
        origin_world_m
            Lower left corner (x, y) [m] and yaw [rad].
        """
        self.events.append(["map", cells.tolist(), resolution_m, list(origin_world_m)])

    def set_obstacle(
        self,
        name: str,
        outline_m: Float[np.ndarray, "n 2"],
        T_world_object: Pose,
        *,
        height_m: float = 0.3,
        fixed: bool | None = None,
    ) -> None:
        """As the page's; while it is moved every n-th place is kept.

        Parameters
        ----------
        name
            Of the obstacle.
        outline_m
            Its outline on the floor [m].
        T_world_object
            Where it is.
        height_m
            Its height [m].
        fixed
            Its colour.
        """
        known = any(event[:2] == ["obstacle", name] for event in self.events)
        if not known or self._updates % _EVERY == 0:
            matrix = np.round(T_world_object.matrix, 4).tolist()
            self.events.append(
                ["obstacle", name, np.round(outline_m, 4).tolist(), matrix, height_m, bool(fixed)]
            )

    def set_tags(self, tags: Mapping[str, HapticTag]) -> None:
        """As the page's.

        Parameters
        ----------
        tags
            By the name of the object.
        """
        from ..report.run_tables import tag_text

        self.events.append(["tags", {name: tag_text(tag) for name, tag in tags.items()}])

    def update(
        self,
        t_s: float,
        *,
        frame_bgr: UInt8[np.ndarray, "rows columns *colour"],
        profile: ForceProfile,
        truth_N: float | None = None,
        T_world_foam: Pose | None = None,
        note: str = "",
    ) -> None:
        """As the page's; every n-th state is kept.

        Parameters
        ----------
        t_s
            Time [s].
        frame_bgr
            Picture of the camera.
        profile
            What was read.
        truth_N
            True force.
        T_world_foam
            Where the platform's foam is.
        note
            Newest event.
        """
        import cv2

        self._updates += 1
        if self._updates % _EVERY and not note:
            return
        height = round(_WIDTH_PX * frame_bgr.shape[0] / frame_bgr.shape[1])
        small = cv2.resize(frame_bgr, (_WIDTH_PX, height), interpolation=cv2.INTER_AREA)
        self.pictures.append(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes())
        place = None if T_world_foam is None else np.round(T_world_foam.matrix, 4).tolist()
        self.events.append(["update", t_s, _rounded(to_dict(profile)), truth_N, place, note])

    def save(self, path: Path | str, report: Path | str) -> None:
        """Write the recording.

        Parameters
        ----------
        path
            ZIP file.
        report
            HTML file of the same mission, which goes in.
        """
        with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_LZMA) as archive:
            archive.writestr("events.json", json.dumps(self.events, separators=(",", ":")))
            archive.writestr("report.html", Path(report).read_bytes())
            for number, picture in enumerate(self.pictures):
                archive.writestr(f"{number:04d}.jpg", picture)


def _rounded(value: Any) -> Any:
    """Four digits are more than a picture shows."""
    if isinstance(value, float):
        return float(f"{value:.4g}")
    if isinstance(value, dict):
        return {name: _rounded(item) for name, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, (list, tuple)) else value


def replay(
    folder: Path | str,
    *,
    on_message: Callable[[str], None],
    page: LivePage | None = None,
    recording: Path | str = RECORDED,
    pause_s: float = 0.03,
) -> Path:
    """Say and show a recorded mission, and write its report.

    Parameters
    ----------
    folder
        Receives ``report.html``.
    on_message
        Takes the lines of the story.
    page
        Shows the pushes.
    recording
        File of :meth:`MissionRecorder.save`.
    pause_s
        Before each line and state [s].

    Returns
    -------
    Path
        The report.

    Raises
    ------
    InputError
        The file is no recorded mission.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with zipfile.ZipFile(recording) as archive:
            write_text(folder / "report.html", archive.read("report.html").decode())
            events = json.loads(archive.read("events.json"))
            pictures = (archive.read(name) for name in sorted(archive.namelist()) if name.endswith(".jpg"))
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
