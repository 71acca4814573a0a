"""Recorded frames from files that were made without our own writers."""

from __future__ import annotations

import shutil
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from visuohaptic.core import FrameSource, InputError
from visuohaptic.core.camera import Camera
from visuohaptic.core.files import read_image
from visuohaptic.io import indices_from_times
from visuohaptic.io.frames import open_source

from .helpers import picture, write_video


def test_video_with_variable_rate_has_exact_times_and_pixels(tmp_path: Path) -> None:
    stamps = [0, 33, 51, 120, 121, 400]
    write_video(tmp_path / "v.mkv", stamps)
    with open_source(tmp_path / "v.mkv") as source:
        assert isinstance(source, FrameSource)
        assert source.frame_count == 6
        frames = list(source)
    # Matroska's time base is the millisecond: the stamps are exact.
    np.testing.assert_allclose([f.t_s for f in frames], np.array(stamps) / 1e3, atol=1e-12)
    assert [f.index for f in frames] == list(range(6))
    for number, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.image, picture(number))


def test_video_part_and_lost_frames(tmp_path: Path) -> None:
    stamps = [40 * n for n in range(20) if n not in (7, 8)]
    write_video(tmp_path / "v.mkv", stamps)
    with open_source(tmp_path / "v.mkv", start_s=0.2, stop_s=0.48) as source:
        frames = list(source)
        assert [f.index for f in frames] == [5, 6, 9, 10, 11]
        assert source.missing == 2
        np.testing.assert_array_equal(frames[2].image, picture(7))
        assert [f.index for f in source] == [5, 6, 9, 10, 11], "a second run gives the same"


def test_video_with_reordered_frames(tmp_path: Path) -> None:
    """B-frames are stored out of order; stamps and count must not notice."""
    write_video(tmp_path / "v.mp4", [40 * n for n in range(25)], codec="libx264", form="yuv420p")
    with open_source(tmp_path / "v.mp4", start_s=0.4) as source:
        frames = list(source)
    np.testing.assert_allclose([f.t_s for f in frames], 0.04 * np.arange(10, 25), atol=1e-9)
    # Frames differ by 8 grey levels: as long as lossy coding moves the mean by less than half
    # of that, the nearest picture tells which frame it is.
    means = [f.image[..., 0].mean() for f in frames]
    known = np.array([picture(n)[..., 0].mean() for n in range(25)])
    assert [int(np.abs(known - mean).argmin()) for mean in means] == list(range(10, 25))


def test_broken_videos_are_one_line(tmp_path: Path) -> None:
    write_video(tmp_path / "v.mp4", [40 * n for n in range(9)], codec="libx264", form="yuv420p")
    whole = (tmp_path / "v.mp4").read_bytes()
    (tmp_path / "cut.mp4").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "noise.avi").write_bytes(np.random.default_rng(1).bytes(4000))
    (tmp_path / "empty.mp4").write_bytes(b"")
    for name in ("cut.mp4", "noise.avi", "empty.mp4", "missing.mp4"):
        with pytest.raises(InputError, match=name) as caught, open_source(tmp_path / name) as source:
            list(source)
        assert "\n" not in str(caught.value)


def test_cut_matroska_gives_what_is_whole(tmp_path: Path) -> None:
    write_video(tmp_path / "v.mkv", [40 * n for n in range(20)])
    whole = (tmp_path / "v.mkv").read_bytes()
    (tmp_path / "cut.mkv").write_bytes(whole[: int(len(whole) * 0.6)])
    with open_source(tmp_path / "cut.mkv") as source:
        frames = list(source)
    assert 5 <= len(frames) < 20
    np.testing.assert_array_equal(frames[4].image, picture(4))


def test_size_must_be_the_cameras(tmp_path: Path) -> None:
    write_video(tmp_path / "v.mkv", [0, 40])
    with (
        open_source(tmp_path / "v.mkv", camera=Camera.simple(640, 480, 500.0)) as source,
        pytest.raises(InputError, match=r"found images of 64 x 48, expected 640 x 480"),
    ):
        list(source)


def test_folder_in_natural_order_with_rate(tmp_path: Path) -> None:
    for number in (0, 1, 2, 10, 9):
        cv2.imwrite(str(tmp_path / f"img{number}.png"), picture(number))
    (tmp_path / "._img0.png").write_bytes(b"what another system keeps beside an image")
    with open_source(tmp_path, rate_Hz=10.0) as source:
        frames = list(source)
    np.testing.assert_allclose([f.t_s for f in frames], [0, 0.1, 0.2, 0.3, 0.4])
    np.testing.assert_array_equal(frames[3].image, picture(9))
    np.testing.assert_array_equal(frames[4].image, picture(10))


def test_folder_times_by_names_and_by_table(tmp_path: Path) -> None:
    names = ["left_10.000.png", "left_10.100.png", "left_10.300.png", "left_10.400.png", "left_10.500.png"]
    for number, name in enumerate(names):
        cv2.imwrite(str(tmp_path / name), picture(number, colour=False))
    with open_source(tmp_path) as source:
        frames = list(source)
        assert source.missing == 1
    assert [f.t_s for f in frames] == pytest.approx([10.0, 10.1, 10.3, 10.4, 10.5])
    assert frames[0].image.ndim == 2, "a grey file stays grey"
    lines = "".join(f"{name},{5 - place}\n" for place, name in enumerate(names))
    (tmp_path / "times.csv").write_text("file,t_s\n" + lines)
    with open_source(tmp_path) as source:
        frames = list(source)
    assert [f.t_s for f in frames] == [1, 2, 3, 4, 5], "in order of time"
    np.testing.assert_array_equal(frames[0].image, picture(4, colour=False))


def test_folder_refusals(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="found no images"):
        open_source(tmp_path)
    cv2.imwrite(str(tmp_path / "a.png"), picture(0))
    with pytest.raises(InputError, match=r"have no times.*rate_Hz"):
        open_source(tmp_path)
    (tmp_path / "times.csv").write_text("file,t_s\na.png,soon\n")
    with pytest.raises(InputError, match=r"line 2, t_s: found 'soon', expected a number"):
        open_source(tmp_path)
    (tmp_path / "times.csv").write_text("file,t_s\nb.png,1\n")
    with pytest.raises(InputError, match=r"'b.png' is not an image of the folder"):
        open_source(tmp_path)


def test_damaged_image_is_left_out_and_counted(tmp_path: Path) -> None:
    for number in range(4):
        cv2.imwrite(str(tmp_path / f"{number}.jpg"), picture(number))
    (tmp_path / "2.jpg").write_bytes(b"\xff\xd8 no image")
    with open_source(tmp_path, rate_Hz=1.0) as source:
        frames = list(source)
        assert source.damaged == 1
    assert [f.index for f in frames] == [0, 1, 3], "the lost frame leaves a gap"


@pytest.mark.parametrize("kind", ["png", "pgm", "bmp", "jpg", "tiff"])
def test_header_sizes_are_checked_before_memory_is_taken(tmp_path: Path, kind: str) -> None:
    """The size by the header is the true one; a forged size of 100000 x 100000 is refused at once."""
    from visuohaptic.core.files import image_size

    grey = picture(3, size=(70, 50), colour=False)
    path = tmp_path / f"a.{kind}"
    assert cv2.imwrite(str(path), grey)
    assert image_size(path.read_bytes(), "a") == (70, 50)
    assert read_image(path).shape[:2] == (50, 70)


def test_forged_header_is_refused(tmp_path: Path) -> None:
    body = struct.pack(">IIBBBBB", 100_000, 100_000, 8, 0, 0, 0, 0)
    chunk = b"IHDR" + body
    data = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))
    (tmp_path / "a.png").write_bytes(data + b"\0" * 100)
    with pytest.raises(InputError, match="100000 x 100000"):
        read_image(tmp_path / "a.png")


def test_indices() -> None:
    regular = np.arange(100) / 30 + np.random.default_rng(0).normal(0, 1e-3, 100)
    assert indices_from_times(regular).tolist() == list(range(100))
    lost = np.delete(regular, [20, 50, 51])
    assert indices_from_times(lost).tolist() == np.delete(np.arange(100), [20, 50, 51]).tolist()
    irregular = np.cumsum(np.random.default_rng(0).uniform(0.01, 0.1, 100))
    assert indices_from_times(irregular).tolist() == list(range(100)), "a variable rate has no gaps"


def test_bad_bounds(tmp_path: Path) -> None:
    write_video(tmp_path / "v.mkv", [0, 40])
    with pytest.raises(InputError, match="expected start < stop"):
        open_source(tmp_path / "v.mkv", start_s=2, stop_s=1)
    with pytest.raises(InputError, match="has no frame from"):
        open_source(tmp_path / "v.mkv", start_s=2)
    with pytest.raises(InputError, match="is live"):
        open_source("uvc:0", start_s=2)


@pytest.mark.data
def test_real_pictures(data: Path, tmp_path: Path) -> None:
    for path in sorted((data / "sensing" / "apriltag").glob("*.jpg"))[:2]:
        shutil.copy(path, tmp_path / path.name)
        np.testing.assert_array_equal(read_image(path), cv2.imread(str(path)))


def test_a_misspelt_file_is_found_beside_it(tmp_path: Path) -> None:
    write_video(tmp_path / "push.mkv", [0, 40])
    with pytest.raises(InputError, match=r"did you mean .*push\.mkv\?"):
        open_source(tmp_path / "psh.mkv")


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (
            (1764336000000, 1764336000033, 1764336000067),
            r"last frame \[s\]: found 1\S+, expected -1e\+11 to 1e\+11",
        ),
        ((5, 5, 5), "has 3 frames, all at 5 s, expected ascending times"),
    ],
)
def test_times_that_are_no_seconds_are_refused(tmp_path: Path, times: tuple[int, ...], said: str) -> None:
    with pytest.raises(InputError, match=said):
        open_source(_timed_folder(tmp_path, times))


def test_intervals_that_may_be_milliseconds_are_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """With the times of a recording of 30 Hz in milliseconds, every speed and rate is wrong by a thousand."""
    with open_source(_timed_folder(tmp_path, (0, 33, 67))) as source:
        assert source.frame_count == 3
    assert "its frames are 33.5 s apart; expected times in seconds" in caplog.text


def _timed_folder(folder: Path, times: tuple[int, ...]) -> Path:
    for number in range(len(times)):
        cv2.imwrite(str(folder / f"{number}.png"), np.zeros((4, 4), np.uint8))
    (folder / "times.csv").write_text("\n".join(map(str, ("t_s", *times))))
    return folder


def test_a_part_of_a_stream_without_an_index_is_whole(tmp_path: Path) -> None:
    """A transport stream estimates the place of a time, often behind the first frame of the part."""
    write_video(tmp_path / "v.ts", list(range(50)), codec="mpeg2video", form="yuv420p", rate=25)
    with open_source(tmp_path / "v.ts") as source:
        whole = {frame.index: frame for frame in source}
    assert len(whole) == 50
    for start in (5, 13, 26, 41):
        with open_source(tmp_path / "v.ts", start_s=0.04 * start) as source:
            part = list(source)
            assert source.damaged == 0
        assert [frame.index for frame in part] == list(range(start, 50))
        for frame in part:
            assert frame.t_s == whole[frame.index].t_s
            np.testing.assert_array_equal(frame.image, whole[frame.index].image)
