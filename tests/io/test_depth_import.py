"""Layouts of published data sets, written here by hand: their depth, colour, camera and poses arrive in a sequence."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.io.depth import DepthSequence, import_sequence, write_poses

SIZE = (16, 12)
DEPTH_M = (0.5 + 0.01 * np.arange(SIZE[0] * SIZE[1]).reshape(SIZE[1], SIZE[0])).astype(np.float32)
PLACE_M = np.array([0.1, -0.2, 0.3])


def _image(path: Path, units: float, *, rotate: int = 0) -> None:
    """Depth in 16 bit, with the bits turned to the left as the Amazon Picking Challenge's camera stores them."""
    path.parent.mkdir(parents=True, exist_ok=True)
    values = np.rint(DEPTH_M / units).astype(np.uint16)
    cv2.imwrite(str(path), ((values << rotate) | (values >> (16 - rotate))) if rotate else values)


def _colour(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((SIZE[1], SIZE[0], 3), 90, np.uint8))


def _arm(folder: Path) -> Path:
    for number in (3, 12):
        _image(folder / "depth" / f"depth_{number}.png", 0.001)
        _colour(folder / "color" / f"depth_{number}.jpg")
    _image(folder / "depth" / "depth_99.png", 0.001)  # no pose
    camera = {"width": 16, "height": 12, "fx": 20.0, "fy": 20.0, "cx": 7.5, "cy": 5.5, "depth_unit_m": 0.001}
    (folder / "camera.json").write_text(json.dumps(camera))
    rows = [f"{number} {PLACE_M[0]} {PLACE_M[1]} {PLACE_M[2]} 0 0 0 1" for number in (3, 12)]
    (folder / "base_T_cam.txt").write_text("\n".join(rows) + "\n")
    return folder


def _apc(folder: Path) -> Path:
    for name in ("frame-000000", "frame-000001"):
        _image(folder / f"{name}.depth.png", 1e-4, rotate=3)
        _colour(folder / f"{name}.color.png")
    _colour(folder / "overview.png")
    pose = np.eye(4)
    pose[:3, 3] = PLACE_M
    rows = "\n".join(" ".join(f"{value}" for value in row) for row in pose)
    (folder / "cam.info.txt").write_text(
        "# Color camera intrinsic matrix\n20 0 7.5\n0 20 5.5\n0 0 1\n\n"
        f"# Camera-to-world extrinsics for frame-000000\n{rows}\n"
    )
    return folder


def _cleargrasp(folder: Path) -> Path:
    folder.mkdir(parents=True)
    names = "camera_name: D435\nxres: 16\nyres: 12\nfx: 20.0\nfy: 20.0\ncx: 7.5\ncy: 5.5\n"
    (folder / "camera_intrinsics.yaml").write_text(names)

    def field(name: str, kind: str, body: bytes) -> bytes:
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<I", len(body)) + body

    head = b"v/1\x01" + struct.pack("<I", 2)
    head += field("channels", "chlist", b"R\0" + struct.pack("<iIii", 2, 0, 1, 1) + b"\0")
    head += field("compression", "compression", b"\0")
    head += field("dataWindow", "box2i", struct.pack("<4i", 0, 0, 15, 11)) + b"\0"
    blocks = [struct.pack("<iI", y, 64) + row.astype("<f4").tobytes() for y, row in enumerate(DEPTH_M)]
    places = [struct.pack("<Q", len(head) + 8 * 12 + 72 * y) for y in range(12)]
    for kind in ("transparent", "opaque"):
        data = head + b"".join(places + blocks)
        (folder / f"000000000-{kind}-depth-img.exr").write_bytes(data)
    _colour(folder / "000000000-transparent-rgb-img.jpg")
    return folder


@pytest.mark.parametrize(
    ("make", "layout", "frames", "skipped", "place_m", "colours"),
    [
        (_arm, "arm", 2, ["base_T_cam.txt has no pose of it"], PLACE_M, 2),
        (_apc, "apc", 1, ["cam.info.txt has no pose of frame-000001"], PLACE_M, 1),
        (_cleargrasp, "cleargrasp", 1, [], None, 1),
    ],
)
def test_a_layout_arrives_whole(tmp_path, make, layout, frames, skipped, place_m, colours):
    found = import_sequence(make(tmp_path / "source"), tmp_path / "out")
    assert (found.layout, found.frames) == (layout, frames)
    assert len(found.skipped) == len(skipped)
    assert all(why in line for why, line in zip(skipped, found.skipped, strict=True))
    sequence = DepthSequence(tmp_path / "out")
    depths = list(sequence.depth_images())
    assert len(depths) == frames
    for depth_m in depths:
        # The sequence keeps 0.1 or 1 mm.
        np.testing.assert_allclose(depth_m, DEPTH_M, atol=6e-4)
    if place_m is None:  # single views of different scenes are not fused
        with pytest.raises(InputError, match="the sequence has no poses"):
            list(sequence)
    for frame in [] if place_m is None else sequence:
        np.testing.assert_allclose(frame.T_world_camera.translation_m, place_m, atol=1e-9)
        np.testing.assert_allclose(frame.camera.matrix, [[20, 0, 7.5], [0, 20, 5.5], [0, 0, 1]])
    assert len(list((tmp_path / "out" / "color").iterdir())) == colours


def test_a_plain_folder_needs_all_that_it_does_not_say(tmp_path):
    source = tmp_path / "source"
    _image(source / "000000.png", 0.001)
    Camera(*SIZE, np.array([[20, 0, 7.5], [0, 20, 5.5], [0, 0, 1.0]])).save(tmp_path / "camera.yaml")
    write_poses(tmp_path / "poses.txt", [(4.0, Pose(np.eye(3), PLACE_M))])
    told = {"camera": tmp_path / "camera.yaml", "poses": tmp_path / "poses.txt"}
    with pytest.raises(
        InputError, match="a plain folder needs depth_scale_m; give a camera_info file, a file of"
    ):
        import_sequence(source, tmp_path / "out", **told)
    with pytest.raises(InputError, match=r"has none of camera.json, cam.info.txt, .* sequence.yaml; "):
        import_sequence(source, tmp_path / "out")
    with pytest.raises(InputError, match="layout: found 'kinect', expected auto, "):
        import_sequence(source, tmp_path / "out", layout="kinect")
    found = import_sequence(source, tmp_path / "out", depth_scale_m=0.001, **told)
    assert (found.layout, found.frames, found.skipped) == ("plain", 1, [])
    (frame,) = DepthSequence(tmp_path / "out")
    assert frame.t_s == pytest.approx(4.0)
    with pytest.raises(InputError, match="is not empty; choose a new folder"):
        import_sequence(source, tmp_path / "out", depth_scale_m=0.001, **told)
    with pytest.raises(InputError, match="is not a folder"):
        import_sequence(source / "nowhere", tmp_path / "other")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("# Color camera intrinsic matrix\n20 0 x\n", "line 2: found '20 0 x', expected numbers"),
        ("# Color camera intrinsic matrix\n20 0 7.5\n0 20\n", "the rows of .* have different lengths"),
        (
            "# Depth camera intrinsic matrix\n1 0 0\n0 1 0\n0 0 1\n",
            "has no 3 x 3 color camera intrinsic matrix",
        ),
        ("# Color camera intrinsic matrix\n1 0\n0 1\n", "has no 3 x 3 color camera intrinsic matrix"),
    ],
)
def test_a_bad_text_of_matrices_is_told_by_its_line(tmp_path, text, said):
    source = _apc(tmp_path / "source")
    (source / "cam.info.txt").write_text(text)
    with pytest.raises(InputError, match=said):
        import_sequence(source, tmp_path / "out")


def test_folders_without_a_usable_image_say_which(tmp_path):
    source = _apc(tmp_path / "source")
    for path in source.glob("*.depth.png"):
        path.unlink()
    with pytest.raises(InputError, match=r"has no frame-NNNNNN\.depth\.png"):
        import_sequence(source, tmp_path / "out")
    source = _cleargrasp(tmp_path / "glass")
    with pytest.raises(InputError, match="kind: found 'clear', expected transparent or opaque"):
        import_sequence(source, tmp_path / "out", kind="clear")
    (source / "000000000-opaque-depth-img.exr").write_bytes(b"v/1\x01 and no more")
    with pytest.raises(InputError, match="no image of the source can be used; the first: "):
        import_sequence(source, tmp_path / "out", kind="opaque")
    assert not (tmp_path / "out").exists()


def test_images_named_by_their_seconds_are_read_in_time_order(tmp_path: Path) -> None:
    """Python writes 12.6, not 12.600: by its digits it would come before 12.533."""
    for number, name in enumerate(("12.5", "12.533", "12.567", "12.6")):
        path = tmp_path / "plain" / f"depth_{name}.png"
        path.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(path), np.full(SIZE[::-1], 500 + 100 * number, np.uint16))
    Camera.simple(*SIZE, 20.0).save(tmp_path / "camera.yaml")
    options = {"camera": tmp_path / "camera.yaml", "depth_scale_m": 1e-3, "poses": "none"}
    import_sequence(tmp_path / "plain", tmp_path / "scan", **options)
    sequence = DepthSequence(tmp_path / "scan")
    assert sequence.times_s.tolist() == pytest.approx([12.5, 12.533, 12.567, 12.6])
    found = [float(np.median(depth_m)) for depth_m in sequence.depth_images() if depth_m is not None]
    assert found == pytest.approx([0.5, 0.6, 0.7, 0.8], abs=1e-4)


@pytest.mark.parametrize(
    "option",
    [{"poses": "poses.txt"}, {"depth_scale_m": 0.5}, {"bit_rotation": 3}],
    ids=lambda one: next(iter(one)),
)
def test_what_a_layout_states_itself_is_not_taken_from_the_caller(
    tmp_path: Path, option: dict[str, object]
) -> None:
    with pytest.raises(InputError, match=f"{next(iter(option))}: does not apply to the layout arm"):
        import_sequence(_arm(tmp_path / "arm"), tmp_path / "scan", **option)
    assert not (tmp_path / "scan").exists()


def test_colour_of_other_times_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """As in the TUM data sets: both cameras have their own times, and one has an image more."""
    for name in ("1.00", "1.10"):
        _image(tmp_path / "plain" / "depth" / f"{name}.png", 0.001)
    for name in ("1.01", "1.11", "1.21"):
        _colour(tmp_path / "plain" / "color" / f"{name}.png")
    Camera.simple(*SIZE, 20.0).save(tmp_path / "camera.yaml")
    options = {"camera": tmp_path / "camera.yaml", "depth_scale_m": 1e-3, "poses": "none"}
    import_sequence(tmp_path / "plain", tmp_path / "scan", **options)
    assert "none of its 3 images has the name of one of 2 depth images; colour is left out" in caplog.text


_ROW = "1 0 0 0.1 0 1 0 -0.2 0 0 1 0.3 0 0 0 1"


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (f"3,{_ROW.replace(' ', ',')}\n12,{_ROW.replace(' ', ',')}\n", ""),
        ("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "line 1: found 4 numbers, expected that of an image"),
        (f"{_ROW}\n", "line 1: found 16 numbers, expected that of an image"),
        (f"nan {_ROW}\n", "no image of the source can be used"),
    ],
)
def test_a_table_of_an_arm_has_the_number_of_each_image(tmp_path: Path, table: str, said: str) -> None:
    folder = _arm(tmp_path / "arm")
    (folder / "base_T_cam.txt").write_text(table)
    if said:
        with pytest.raises(InputError, match=said):
            import_sequence(folder, tmp_path / "out")
        return
    assert import_sequence(folder, tmp_path / "out").frames == 2
    for frame in DepthSequence(tmp_path / "out"):
        np.testing.assert_allclose(frame.T_world_camera.translation_m, PLACE_M, atol=1e-9)
