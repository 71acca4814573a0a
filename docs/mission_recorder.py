"""Records a mission for ``visuohaptic demo --quick``: takes the place of the live page and of the terminal."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from visuohaptic.core import ForceProfile, HapticTag, Pose, to_dict
from visuohaptic.core.files import atomic_path

#: Every n-th state of the platform is kept, its pictures this wide [px].
_EVERY, _WIDTH_PX, _QUALITY = 8, 480, 50


class MissionRecorder:
    """Takes the place of the live page, and of the terminal, while a mission is recorded."""

    def __init__(self) -> None:
        self.events: list[list[Any]] = []
        self.pictures: list[bytes] = []
        self._updates = 0

    def log(self, text: str) -> None:
        """Take a line of the story."""
        self.events.append(["line", text])

    def set_map(self, cells: np.ndarray, resolution_m: float, origin_world_m: tuple[float, ...]) -> None:
        """As the page's."""
        self.events.append(["map", cells.tolist(), resolution_m, list(origin_world_m)])

    def set_obstacle(
        self,
        name: str,
        outline_m: np.ndarray,
        T_world_object: Pose,
        *,
        height_m: float = 0.3,
        fixed: bool | None = None,
    ) -> None:
        """As the page's; while it is moved every n-th place is kept."""
        known = any(event[:2] == ["obstacle", name] for event in self.events)
        if not known or self._updates % _EVERY == 0:
            matrix = np.round(T_world_object.matrix, 7).tolist()
            self.events.append(
                ["obstacle", name, np.round(outline_m, 4).tolist(), matrix, height_m, bool(fixed)]
            )

    def set_tags(self, tags: Mapping[str, HapticTag]) -> None:
        """As the page's."""
        from visuohaptic.report.run_tables import tag_text

        self.events.append(["tags", {name: tag_text(tag) for name, tag in tags.items()}])

    def update(
        self,
        t_s: float,
        *,
        frame_bgr: np.ndarray,
        profile: ForceProfile,
        truth_N: float | None = None,
        T_world_foam: Pose | None = None,
        note: str = "",
    ) -> None:
        """As the page's; every n-th state is kept."""
        import cv2

        self._updates += 1
        if self._updates % _EVERY and not note:
            return
        height = round(_WIDTH_PX * frame_bgr.shape[0] / frame_bgr.shape[1])
        small = cv2.resize(frame_bgr, (_WIDTH_PX, height), interpolation=cv2.INTER_AREA)
        self.pictures.append(cv2.imencode(".webp", small, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])[1].tobytes())
        place = None if T_world_foam is None else np.round(T_world_foam.matrix, 7).tolist()
        self.events.append(["update", t_s, _rounded(to_dict(profile)), truth_N, place, note])

    def save(self, path: Path | str, report: Path | str) -> None:
        """Write the recording."""
        with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_LZMA) as archive:
            archive.writestr("events.json", json.dumps(self.events, separators=(",", ":")))
            archive.writestr("report.html", Path(report).read_bytes())
            for number, picture in enumerate(self.pictures):
                archive.writestr(f"{number:04d}.webp", picture)


def _rounded(value: Any) -> Any:
    """Four digits are more than a picture shows."""
    if isinstance(value, float):
        return float(f"{value:.4g}")
    if isinstance(value, dict):
        return {name: _rounded(item) for name, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, (list, tuple)) else value
