"""What the core's records and readers refuse, with what was found and expected, and the values that they return."""

from __future__ import annotations

import copy
import errno
import math
import os
import re
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
import pytest

from visuohaptic.core import Camera, Estimate, Frame, HapticTag, InputError, LaserScan, VisuoHapticObject
from visuohaptic.core.cards import arrays_digest, card_text, decode, digest_of, encode, order_of
from visuohaptic.core.clock_watch import ClockWatch
from visuohaptic.core.errors import MissingExtraError, brief_list, needs
from visuohaptic.core.files import atomic_path, decode_image, encode_image, load_yaml_model, parse_yaml
from visuohaptic.core.files.atomic import write_text
from visuohaptic.core.files.part_file import PartFile
from visuohaptic.core.files.plain_json import dumps, picked, plain
from visuohaptic.core.files.regular import read_bytes, read_head, read_text, similar_names
from visuohaptic.core.measurement import Contact, ErrorBudget, ForceProfile, Reason
from visuohaptic.core.objects import (
    Geometry,
    Primitive,
    PrimitiveKind,
    Provenance,
    Sighting,
    StiffnessMap,
)
from visuohaptic.core.ranges import check_order
from visuohaptic.core.resources import Closing, one_blas_thread
from visuohaptic.core.robots import MobileBase, require_members

NAN, INF = math.nan, math.inf
TRIANGLE = np.eye(3), np.array([[0, 1, 2]])


def camera(**change: object) -> Camera:
    given = {"width": 4, "height": 3, "matrix": np.array([[5.0, 0, 2], [0, 5, 1], [0, 0, 1]])} | change
    return Camera(**given)


def scan(**change: object) -> LaserScan:
    given = {"t_s": 0.0, "ranges_m": np.ones(3), "angle_min_rad": 0.0, "angle_step_rad": 0.5} | change
    return LaserScan(**given)


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda: camera(width=0), "width, height: found 0 x 3, expected a positive size"),
        (lambda: camera(matrix=np.eye(2)), r"matrix: .*expected finite numbers \(3, 3\)"),
        (lambda: camera(matrix=np.diag([0.0, 5, 1])), "matrix: .*expected positive focal lengths and last row"),
        (lambda: camera(distortion=np.ones(3)), "distortion: .*expected 0, 4, 5 or 8 finite coefficients"),
        (lambda: camera(row_delay_s=-1.0), "row_delay_s: found -1.0, expected at least 0"),
        (lambda: camera(transfer_function="log"), "transfer_function: found 'log', expected one of"),
        (lambda: camera().check_size("a.png", 8, 6), "a.png: found images of 8 x 6, expected 4 x 3"),
        (lambda: Frame(np.zeros((2, 2)), 0.0, 0), "image: found float64 of shape .*expected uint8"),
        (lambda: Frame(np.zeros((2, 2, 4), np.uint8), 0.0, 0), r"found uint8 of shape \(2, 2, 4\)"),
        (lambda: scan(ranges_m=np.ones((2, 2))), r"found shape \(2, 2\), expected 1 to 100000 beams"),
        (lambda: scan(ranges_m=np.ones(0)), r"found shape \(0,\), expected 1 to"),
        (lambda: scan(range_min_m=40.0), r"range_max_m: found 30.0, expected more than range_min_m \(40.0\)"),
        (lambda: scan(angle_step_rad=0.0), "angle_step_rad: found 0, expected a non-zero step"),
        (lambda: scan(sigma_m=0.0), "sigma_m: found 0.0, expected more than 0"),
        (lambda: scan(t_s=NAN), "t_s: found nan, expected a finite number"),
        (lambda: scan(angle_min_rad="left"), "angle_min_rad: found .*left.*, expected a finite number"),
        (lambda: check_order(scan(), "range_max_m", "range_min_m"), "range_min_m: found 0.05, expected more"),
        (lambda: HapticTag(explored=-1).check_read(), "explored: found -1, expected at least 0"),
        (lambda: HapticTag(static_friction_N=Estimate(-9.0, 0.1)).check_read(), "found -9, expected >= 0"),
        (lambda: HapticTag(min_static_friction_N=INF).check_read(), "min_static_friction_N: found inf, expected"),
        (
            lambda: HapticTag(deformation_shape_m=np.array([[0.0, 1e6]])).check_read(),
            "deformation_shape_m: .*expected -1000 to 1000",
        ),
        (lambda: Geometry(*TRIANGLE[:1], TRIANGLE[1] + 1).check_read(), r"vertices outside 0\.\.2"),
        (lambda: Geometry(None, TRIANGLE[1]).check_read(), r"vertices outside 0\.\.-1"),
        (lambda: StiffnessMap(*TRIANGLE, np.ones(2), np.ones(3)).check_read(), "sigma for 3 vertices"),
        (lambda: Provenance(t_s=INF).check_read(), "t_s: found inf, expected a finite number"),
        (lambda: Sighting((0.0, 0.0, NAN), 0.1, 0.0).check_read(), "expected finite position_m"),
        (lambda: Sighting((0.0, 0.0, 0.0), -0.1, 0.0).check_read(), "sigma_m >= 0"),
        (
            lambda: Primitive(PrimitiveKind.CIRCLE, np.ones(2), np.eye(2), 1.0).check_read(),
            "found 2 parameters and a covariance of shape .*expected 3 of a circle",
        ),
        (
            lambda: Primitive(PrimitiveKind.CIRCLE, np.array([0, 0, NAN]), np.eye(3), 1.0).check_read(),
            "found a number that is not finite",
        ),
    ],
)  # fmt: skip
def test_a_record_is_refused(make, problem) -> None:
    with pytest.raises(InputError, match=problem):
        make()


def test_values_of_a_frame_and_a_scan() -> None:
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4)
    assert Frame(grey, 0.0, 0).grey is grey
    colour = np.zeros((1, 3, 3), np.uint8)
    colour[0, :, :] = np.diag([255, 255, 255])
    # ITU-R BT.601: blue, green, red.
    assert Frame(colour, 0.0, 0).grey[0].tolist() == [29, 150, 76]
    bent = camera(distortion=np.array([0.1, 0.0, 0.0, 0.0]))
    ray = bent.rays(np.array([[3.0, 2.0]]))
    np.testing.assert_allclose(bent.project(ray), [[3.0, 2.0]], atol=1e-6)
    assert bent.rays(np.zeros((0, 2))).shape == (0, 3)
    found = scan(ranges_m=np.array([1.0, INF, NAN, 0.01, 2.0]), angle_step_rad=math.pi / 8)
    assert found.hits.tolist() == [True, False, False, False, True]
    np.testing.assert_allclose(found.angles_rad, np.arange(5) * math.pi / 8)
    np.testing.assert_allclose(found.points_m, [[1.0, 0.0], [0.0, 2.0]], atol=1e-12)


def test_a_profile_that_cannot_be_trusted_keeps_its_contours() -> None:
    def contact(delta_m: list[float], reason: Reason = Reason.OK) -> Contact:
        points, budget = np.zeros((len(delta_m), 2)), ErrorBudget(3.0, 4.0, 0.0, 12.0)
        sigma, valid = np.ones(len(delta_m)), reason is Reason.OK
        return Contact(0.0, 0.2, 1.0, budget, valid, reason, points, sigma, np.array(delta_m))

    none, some = np.zeros(3), (contact([0.0, 0.0, 1e-3]), contact([0.0, 0.0], Reason.SATURATED))
    kept = (np.ones(3, dtype=bool), some)
    budget = ErrorBudget(0.3, 0.4)
    profile = ForceProfile(0.0, False, Reason.OCCLUDED, 2.0, budget, none, none, none, none, none, *kept)
    assert profile.force_sigma_N == pytest.approx(0.5)
    assert some[0].force_sigma_N == pytest.approx(13.0)
    assert some[0].centre_m == pytest.approx(0.2)  # weighted by deflection
    assert some[1].centre_m == pytest.approx(0.1)  # nothing is deflected: its middle
    assert profile.max_contact is some[0]
    unread = profile.unread()
    assert [one.reason for one in unread.contacts] == [Reason.OCCLUDED, Reason.SATURATED]
    assert not any(one.valid for one in unread.contacts)
    assert math.isnan(unread.force_N)
    assert math.isnan(unread.force_sigma_N)
    assert np.isnan(unread.pressure_Pa).all()
    assert unread.s_m is profile.s_m


def test_the_digest_of_an_object_is_of_its_contents() -> None:
    cup = VisuoHapticObject("cup", geometry=Geometry(*TRIANGLE), tag=HapticTag(drift=Estimate(0.1, 0.01)))
    card, arrays = encode(cup)
    again = decode(card, arrays)
    assert again.id == "cup"
    np.testing.assert_array_equal(again.geometry.vertices_m, np.eye(3))
    digest = digest_of(card_text(card), arrays_digest(arrays))
    assert len(digest) == 64
    assert digest == digest_of(card_text(encode(again)[0]), arrays_digest(encode(again)[1]))
    name = next(iter(arrays))
    for other in (arrays[name].astype(np.float32), arrays[name].T + 1, arrays[name][:0]):
        assert arrays_digest(arrays | {name: other}) != arrays_digest(arrays)
    with pytest.raises(InputError, match=r"cup\.json.*colour"):
        decode(card | {"colour": 1}, arrays, "cup.json")
    # Estimates do not count for the order, everything else does.
    tags = [HapticTag(drift=Estimate(value, 0.01), explored=count) for value, count in ((0.1, 1), (0.2, 1), (0.1, 2))]  # fmt: skip
    keys = [order_of({"tag": tag}) for tag in tags]
    assert keys[0] == keys[1] != keys[2]


def test_a_clock_that_stands_still_is_told_by_periods_and_by_the_host() -> None:
    host_s = [0.0]
    watch = ClockWatch(max_periods=3, max_host_s=5.0, host_clock=lambda: host_s[0])
    assert [watch.update(t_s) for t_s in (1.0, 1.0, 1.0)] == ["", "", ""]
    assert watch.update(1.0) == "the robot's clock has stood still at 1 s for 3 control periods"
    assert watch.update(1.1) == ""
    host_s[0] = 5.1
    assert "at 1.1 s for 1 control periods" in watch.update(1.1)
    polled = ClockWatch(max_periods=None, host_clock=lambda: host_s[0])
    assert not any(polled.update(2.0) for _ in range(1000))
    # A clock that has never told a time does not run.
    silent = ClockWatch(max_periods=2)
    assert [bool(silent.update(NAN)) for _ in range(3)] == [False, False, True]


def test_results_are_plain_data() -> None:
    class Colour(Enum):
        RED = "red"

    @dataclass
    class Record:
        where: Path
        values: np.ndarray

    given = {
        Colour.RED: (True, None, NAN, np.float32(0.5), np.int64(3)),
        "record": Record(Path("a/b"), np.array([[1.0, INF]])),
        "set": {2},
    }
    expected = {
        "red": [True, None, None, 0.5, 3],
        "record": {"where": str(Path("a/b")), "values": [[1.0, None]]},
        "set": [2],
    }
    assert plain(given) == expected
    assert dumps({"ü": NAN}) == '{"ü": null}'
    assert picked(Record(Path("c"), np.zeros(0)), "values where") == {"values": [], "where": "c"}
    with pytest.raises(TypeError, match="a value of type object, which JSON cannot represent"):
        plain([object()])


def test_files_that_cannot_be_read_or_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"its folder does not exist; create .*none"):
        write_text(tmp_path / "none" / "a", "x")
    with pytest.raises(InputError, match="is a folder, expected the name of a file"):
        write_text(tmp_path, "x")
    os.mkfifo(pipe := tmp_path / "pipe")
    for write in (lambda: write_text(pipe, "x"), lambda: PartFile(pipe)):
        with pytest.raises(InputError, match="is a pipe, expected the name of a file"):
            write()
    assert pipe.is_fifo()  # devices, too: /dev/null was replaced by a file
    pipe.unlink()
    path = tmp_path / "map.yaml"
    write_text(path, "\ufeffa: 1\r\nb: 2\r")
    assert read_text(path, 100) == "a: 1\nb: 2\n"
    assert read_head(path, 4) == b"\xef\xbb\xbfa"
    with pytest.raises(InputError, match=r"it is a folder, expected a file; it has map\.yaml$"):
        read_text(tmp_path, 100)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"it is a folder, expected a file$"):
        read_text(tmp_path / "empty", 100)
    (tmp_path / "empty").rmdir()
    assert similar_names(tmp_path / "mop.yaml") == f"did you mean {path}?"
    assert similar_names(tmp_path / "none" / "mop.yaml") == ""
    assert similar_names(tmp_path / "zzzzzz") == ""
    with pytest.raises(InputError, match=r"has 14 bytes|more than 5 bytes"):
        read_bytes(path, 5)
    path.write_bytes(b"caf\xe9")
    with pytest.raises(InputError, match=r"is not UTF-8 text \(byte 3\)"):
        read_text(path, 100)

    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EIO, "the disk is gone")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", refuse)
        for read in (read_bytes, read_head):
            with pytest.raises(InputError, match=r"cannot be read \(the disk is gone\)"):
                read(path, 100)
    with monkeypatch.context() as patch:
        patch.setattr("tempfile.mkstemp", refuse)
        with pytest.raises(InputError, match=r"cannot be written \(the disk is gone\)"):
            write_text(path, "x")
    # An error of write() has no name of a file: it gets that of the target, which is left as it was.
    with pytest.raises(OSError, match="full") as caught, atomic_path(path):
        raise OSError(errno.ENOSPC, "full")
    assert caught.value.filename == str(path)
    assert path.read_bytes() == b"caf\xe9"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda png: png[:-12], "is truncated: the PNG has no end chunk"),
        (lambda png: png[:40], "is truncated: the PNG has no end chunk"),
        (lambda png: png + b"more", "has 4 bytes after the end of its image"),
        (lambda png: png + bytes(20_000_000), "far more than 4 x 3 pixels need"),
        (lambda png: png[:20] + b"\0\0\0\1" + png[24:], "the checksum of its chunk b'IHDR' is wrong"),
    ],
)
def test_a_damaged_png_is_refused(change, problem) -> None:
    png = encode_image(np.arange(12, dtype=np.uint8).reshape(3, 4))
    np.testing.assert_array_equal(decode_image(png, "a"), np.arange(12).reshape(3, 4))
    with pytest.raises(InputError, match=problem):
        decode_image(change(png), "a")


def test_damaged_images_of_other_formats_and_pixels_without_one() -> None:
    grey = np.full((8, 8), 90, np.uint8)
    jpg = encode_image(grey, "jpg", quality=90)
    with pytest.raises(InputError, match="is truncated: the JPEG has no end marker"):
        decode_image(jpg[:-2], "a")
    import cv2

    bmp = bytes(cv2.imencode(".bmp", grey)[1])
    np.testing.assert_array_equal(decode_image(bmp, "a", "grey"), grey)
    with pytest.raises(InputError, match=f"is truncated: it has {len(bmp) - 1} bytes, expected {len(bmp)}"):
        decode_image(bmp[:-1], "a")
    with pytest.raises(InputError, match=r"found suffix '\.xyz', expected \.png, \.jpg or \.webp"):
        encode_image(grey, "xyz")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("a: 99999999999999999999999", "an integer of more than 64 bits; quote it if it is a string"),
        ("a: !!int 1:30", "a number in base 60, expected base 10"),
        ("a: !!float 1:30.5", "a number in base 60, expected base 10"),
        ("a: 0x" + "f" * 5000, "a number of 5002 characters, expected at most"),
        ("a: &x [*x]", "an alias that contains itself"),
        ("a: !!timestamp 2000-99-99", "is not valid YAML"),
        ("a: [1", "line 1: is not valid YAML"),
    ],
)
def test_yaml_that_is_refused(text, problem) -> None:
    with pytest.raises(InputError, match=problem):
        parse_yaml(text, "a.yaml")


def test_all_problems_of_a_file_are_told(tmp_path: Path) -> None:
    from typing import Literal

    from pydantic import BaseModel, Field, field_validator

    class Inner(BaseModel, extra="forbid"):
        length_m: float = Field(1.0, gt=0, le=10)

    class Model(BaseModel, extra="forbid"):
        name: str
        kind: Literal["foam", "beam"] = "foam"
        size: list[int] = Field([1], min_length=1)
        strip: Inner = Inner()
        even: int = 0

        @field_validator("even")
        @classmethod
        def _even(cls, value: int) -> int:
            if value % 2:
                raise ValueError("expected an even number")
            return value

    path = tmp_path / "a.yaml"
    path.write_text("kind: rod\neven: 3\n")
    with pytest.raises(InputError, match=r"kind: found 'rod', expected foam or beam$"):
        load_yaml_model(path, Model)  # a file of another kind: the rest of its problems says nothing
    path.write_text("size: []\nstrip: {length_m: 20, lenght_m: 1}\neven: 3\n")
    with pytest.raises(InputError) as caught:
        load_yaml_model(path, Model)
    said = str(caught.value)
    for part in (
        "name: is missing", "strip.length_m: found 20, expected",
        "unknown field (found 1), did you mean length_m?", "expected an even number (found 3)", "entries",
    ):  # fmt: skip
        assert part in said, said
    path.write_text("- 1\n")
    with pytest.raises(InputError, match="found list, expected a mapping of fields"):
        load_yaml_model(path, Model)
    path.write_text("".join(f"{'long ' * 90}{number}: 1\n" for number in range(99)))
    with pytest.raises(
        InputError, match=r"name: is missing; .*\.\.\.: unknown field .*; and 9\d more$"
    ) as caught:
        load_yaml_model(path, Model)
    assert len(str(caught.value)) < len(str(path)) + 700


@pytest.mark.parametrize("count", [1, 40, 2000])
def test_a_list_in_a_message_counts_what_it_leaves_out(count) -> None:
    names = [f"field_{number}" for number in range(count)]
    said = brief_list(names)
    *shown, last = said.split(", ")
    more = re.fullmatch(r"and (\d+) more", last)
    assert len(said) < 620
    if more is None:
        assert [*shown, last] == names
    else:
        assert shown == names[: len(shown)]
        assert len(shown) + int(more[1]) == count
        assert len(said) > 580, "of many short names, as many as have room"
    assert (more is None) == (len(", ".join(names)) <= 600)


def test_a_part_of_a_robot_is_checked_before_it_moves() -> None:
    class Base:
        count = 3

        def stop(self) -> None: ...

        def drive(self) -> None: ...

    for members, problem in (
        ("stop", None), ("state", "without method state"), ("drive", "whose drive takes other arguments than the method drive"),
    ):  # fmt: skip
        if problem is None:
            require_members(Base(), MobileBase, "explore", "base", members=(members,))
        else:
            with pytest.raises(InputError, match=rf"explore: found base of type Base {problem}"):
                require_members(Base(), MobileBase, "explore", "base", members=(members,))

    class Stopped:
        stop = 3

    with pytest.raises(InputError, match="whose stop is int, expected the method stop"):
        require_members(Stopped(), MobileBase, "explore", "base", members=("stop",))


def test_resources_are_closed_and_a_missing_library_is_named() -> None:
    class Kept(Closing):
        closed = False

        def close(self) -> None:
            self.closed = True

    with pytest.raises(ZeroDivisionError), Kept() as kept:
        _ = 1 / 0
    assert kept.closed
    with one_blas_thread():
        assert np.allclose(np.ones((2, 2)) @ np.ones(2), 2.0)
    with pytest.raises(MissingExtraError, match="drawing needs the package 'nolib'") as caught, needs("nolib", "plots", "drawing"):  # fmt: skip
        raise ImportError("nolib")
    again = copy.copy(caught.value)
    assert str(again) == str(caught.value)
    assert "run: pip install 'visuohaptic[plots]'" in str(again)
