"""Videos of the rigs: what cannot be stored is refused, and an older file is kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.io.frames import VideoSource
from visuohaptic.rigs import write_video

pytest.importorskip("av")
GREY = np.full((32, 48), 90, np.uint8)


@pytest.mark.parametrize(
    ("images", "said"),
    [
        ([], "found no image"),
        ([GREY[:, :47]], r"found uint8 \(32, 47\), expected uint8"),
        ([GREY, np.full((64, 48), 90, np.uint8)], r"found uint8 \(64, 48\), expected .* the same"),
        ([GREY.astype(float)], "found float64"),
        ([np.zeros((0, 0), np.uint8)], "found uint8"),
        ([np.zeros((32, 48, 3), np.uint8)], r"found uint8 \(32, 48, 3\)"),
    ],
)
def test_what_is_no_video_leaves_the_older_one(tmp_path: Path, images: list[np.ndarray], said: str) -> None:
    path = tmp_path / "push.mp4"
    write_video(path, [GREY, GREY])
    before = path.read_bytes()
    with pytest.raises(InputError, match=f"push.mp4: {said}"):
        write_video(path, images)
    assert path.read_bytes() == before
    assert [one.name for one in tmp_path.iterdir()] == ["push.mp4"]
    frames = [frame.grey for frame in VideoSource(path)]
    assert len(frames) == 2
    # Uniform grey is stored exactly, up to the rounding of the codec.
    np.testing.assert_allclose(frames[1].astype(float), 90.0, atol=1.0)
