"""Depth sequences: round trip; damaged frames are left out and counted."""

from __future__ import annotations

import itertools
import math
import re
import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visuohaptic.cli.main import main
from visuohaptic.core import InputError
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.core.files import save_yaml
from visuohaptic.io.depth import (
    DepthEncoding,
    DepthFrame,
    DepthSequence,
    StampedPose,
    import_sequence,
    interpolate_pose,
    read_depth,
    read_poses,
    write_depth,
    write_poses,
)
from visuohaptic.io.depth._exr import decode_exr


def make_sequence(folder, count=4, rng=None, names="{:06d}.png", **fields):
    """A small sequence; returns its depth pictures and poses."""
    rng = rng or np.random.default_rng(3)
    (folder / "depth").mkdir(parents=True)
    (folder / "color").mkdir()
    camera = Camera.simple(40, 30, 35.0)
    camera.save(folder / "camera.yaml")
    depths, poses = [], []
    for k in range(count):
        depth = np.rint(rng.uniform(400, 2000, (30, 40))) * 1e-3
        depth[rng.random((30, 40)) < 0.1] = np.nan
        name = names.format(k)
        write_depth(folder / "depth" / name, depth)
        cv2.imwrite(str(folder / "color" / name), np.full((30, 40, 3), k, np.uint8))
        depths.append(depth.astype(np.float32))
        poses.append((0.1 * k, Pose.from_rotation_vector(rng.normal(0, 0.3, 3), rng.normal(0, 0.02, 3))))
    write_poses(folder / "poses.txt", poses)
    save_yaml(folder / "sequence.yaml", {"sensor": "test", "depth_scale_m": 0.001, **fields})
    return depths, poses


def test_a_sequence_comes_back_as_it_was_written(tmp_path):
    depths, poses = make_sequence(tmp_path / "s")
    sequence = DepthSequence(tmp_path / "s")
    frames = list(sequence)
    assert len(sequence) == len(frames) == 4
    assert not sequence.skipped
    for k, frame in enumerate(frames):
        np.testing.assert_allclose(frame.depth_m, depths[k], rtol=1e-6)
        np.testing.assert_allclose(frame.T_world_camera.matrix, poses[k][1].matrix, atol=1e-8)
        assert frame.t_s == pytest.approx(0.1 * k)
        assert frame.color is not None
        assert (frame.color == k).all()
        assert (frame.camera.width, frame.index) == (40, k)


@given(st.integers(0, 15), st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_rotated_bits_are_turned_back(tmp_path_factory, turn, seed):
    folder = tmp_path_factory.mktemp("bits")
    words = np.random.default_rng(seed).integers(1000, 30000, (7, 9)).astype(np.uint16)
    rotated = ((words.astype(np.uint32) << turn) | (words.astype(np.uint32) >> (16 - turn))).astype(np.uint16)
    cv2.imwrite(str(folder / "d.png"), rotated)
    depth = read_depth(folder / "d.png", DepthEncoding(1e-4, bit_rotation=turn))
    np.testing.assert_allclose(depth, words * 1e-4, rtol=1e-6)


def _runs(data):
    """Run lengths as OpenEXR has them: n + 1 times the next byte, or -n bytes as they are."""
    out = b""
    for value, same in itertools.groupby(data):
        count = len(list(same))
        out += b"".join(
            bytes([min(127, left - 1), value]) if left > 1 else bytes([255, value])
            for left in range(count, 0, -128)
        )
    return out


def exr(values, compression):
    """A scan-line OpenEXR file with channels A (half, junk) and Z (float), written apart from the reader."""
    height, width = values.shape

    def attribute(name, kind, body):
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<I", len(body)) + body

    channels = b"".join(
        name + b"\0" + struct.pack("<iIii", kind, 0, 1, 1) for name, kind in ((b"A", 1), (b"Z", 2))
    )
    box = struct.pack("<4i", 0, 5, width - 1, height + 4)
    head = b"v/1\x01" + struct.pack("<I", 2) + attribute("channels", "chlist", channels + b"\0")
    head += attribute("compression", "compression", bytes([compression]))
    head += attribute("dataWindow", "box2i", box) + b"\0"
    rows_per_block = 16 if compression == 3 else 1
    blocks = []
    for top in range(0, height, rows_per_block):
        rows = values[top : top + rows_per_block]
        raw = b"".join(np.arange(width, dtype="<f2").tobytes() + row.astype("<f4").tobytes() for row in rows)
        if compression:
            split = raw[0::2] + raw[1::2]
            steps = bytes([split[0]] + [(b - a + 128) % 256 for a, b in itertools.pairwise(split)])
            packed = _runs(steps) if compression == 1 else zlib.compress(steps)
            raw = packed if len(packed) < len(raw) else raw
        blocks.append(struct.pack("<iI", top + 5, len(raw)) + raw)
    table, place = b"", len(head) + 8 * len(blocks)
    for block in blocks:
        table += struct.pack("<Q", place)
        place += len(block)
    return head + table + b"".join(blocks)


@pytest.mark.parametrize("even", [False, True])
@pytest.mark.parametrize("compression", [0, 1, 2, 3])
def test_exr_files_are_read(compression, even, tmp_path):
    values = np.linspace(0.3, 2.0, 37 * 301).reshape(37, 301).astype(np.float32)
    if even:  # long runs
        values[:] = 0.5
    data = exr(values, compression)
    np.testing.assert_array_equal(decode_exr(data, "x"), values)
    (tmp_path / "d.exr").write_bytes(data)
    np.testing.assert_array_equal(read_depth(tmp_path / "d.exr", DepthEncoding(1.0)), values)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda data: b"PNG" + data[3:], "begins with b'PNG.*', expected an OpenEXR file"),
        (
            lambda data: data[:4] + struct.pack("<I", 0x202) + data[8:],
            "is a tiled, deep or multi-part OpenEXR file",
        ),
        (lambda data: data.replace(b"dataWindow", b"dataWandow"), "is a damaged OpenEXR file: no dataWindow"),
        (
            lambda data: data.replace(b"Z\0" + struct.pack("<i", 2), b"Z\0" + struct.pack("<i", 7)),
            "of unknown type 7",
        ),
        (lambda data: data.replace(b"Z\0", b"N\0", 1), "has channels A, N, expected one of Z, Y, R"),
        (lambda data: data[:-40], "is a truncated OpenEXR file"),
    ],
)
def test_an_exr_file_that_is_not_read_says_why(change, said):
    data = exr(np.full((20, 11), 0.5, np.float32), 0)
    with pytest.raises(InputError, match=said):
        decode_exr(change(data), "x")


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_damaged_exr_files_give_input_errors_or_numbers(seed):
    rng = np.random.default_rng(seed)
    data = bytearray(exr(rng.uniform(0.3, 2, (20, 11)).astype(np.float32), 3))
    if rng.random() < 0.5:
        data = data[: rng.integers(len(data))]
    for _ in range(3):
        if data:
            data[rng.integers(len(data))] = rng.integers(256)
    try:
        found = decode_exr(bytes(data), "x")
    except InputError:
        return
    assert found.ndim == 2


@pytest.mark.parametrize("text", ["rows", "blocks", "numbered", "redwood", "kitti"])
def test_matrices_as_text_are_read(tmp_path, text):
    rng = np.random.default_rng(1)
    poses = [Pose.from_rotation_vector(rng.normal(0, 1, 3), rng.normal(0, 1, 3)) for _ in range(3)]
    lines = ["# made here"]
    for k, pose in enumerate(poses):
        numbers = [f"{value:.9g}" for value in pose.matrix.ravel()]
        if text == "kitti":
            lines.append(" ".join(numbers[:12]))
        elif text in ("rows", "numbered"):
            lines.append(" ".join(([str(k)] if text == "numbered" else []) + numbers))
        else:
            if text == "redwood":
                lines.append(f"{k} {k} {k + 1}")
            lines += [" ".join(numbers[4 * row : 4 * row + 4]) for row in range(4)] + [""]
    (tmp_path / "poses.txt").write_text("\n".join(lines))
    found = read_poses(tmp_path / "poses.txt")
    assert len(found) == 3
    for stamped, pose in zip(found, poses, strict=True):
        assert stamped.pose is not None
        np.testing.assert_allclose(stamped.pose.matrix, pose.matrix, atol=1e-7)


def test_poses_between_times_lie_on_the_arc():
    turn = np.array([0.0, 0.0, 0.4])
    ends = [StampedPose(t, Pose.from_rotation_vector(turn * t, [t, 0, 0])) for t in (0.0, 1.0)]
    pose, problem = interpolate_pose(ends, 0.25, max_gap_s=2.0)
    assert problem == ""
    np.testing.assert_allclose(
        pose.matrix, Pose.from_rotation_vector(turn * 0.25, [0.25, 0, 0]).matrix, atol=1e-12
    )
    assert interpolate_pose(ends, 0.25, max_gap_s=0.5)[0] is None
    assert interpolate_pose(ends, 1.5)[0] is None


def test_pictures_named_by_time_find_their_pose(tmp_path):
    _, poses = make_sequence(tmp_path / "s", names="{}.050000.png")
    write_poses(tmp_path / "s" / "poses.txt", [(k + 0.05, poses[k][1]) for k in (0, 1, 3)])
    sequence = DepthSequence(tmp_path / "s")
    frames = list(sequence)
    assert [frame.index for frame in frames] == [0, 1, 3]
    assert sequence.skipped == {"no pose": 1}


def test_a_lost_picture_is_counted_and_the_others_keep_their_pose(tmp_path):
    _, poses = make_sequence(tmp_path / "s")
    (tmp_path / "s" / "depth" / "000001.png").unlink()
    sequence = DepthSequence(tmp_path / "s")
    frames = list(sequence)
    assert sequence.missing == 1
    np.testing.assert_allclose(frames[1].T_world_camera.matrix, poses[2][1].matrix, atol=1e-8)
    (tmp_path / "s" / "depth" / "000003.png").unlink()  # the last: nobody knows which one it was
    with pytest.raises(InputError, match=r"2 depth images and 4 poses, expected one pose for each"):
        DepthSequence(tmp_path / "s")


def test_unusable_frames_are_left_out_and_counted(tmp_path):
    make_sequence(tmp_path / "s", count=6)
    depth = tmp_path / "s" / "depth"
    whole = (depth / "000000.png").read_bytes()
    (depth / "000000.png").write_bytes(whole[: len(whole) // 2])
    write_depth(depth / "000001.png", np.full((20, 40), 1.0))
    write_depth(depth / "000002.png", np.full((30, 40), np.nan))
    cv2.imwrite(str(depth / "000003.png"), np.full((30, 40), 60000, np.uint16))  # 60 m
    text = (tmp_path / "s" / "poses.txt").read_text().splitlines()
    text[5] = "0.4 nan 0 0 0 0 0 1"
    (tmp_path / "s" / "poses.txt").write_text("\n".join(text))
    sequence = DepthSequence(tmp_path / "s")
    assert [frame.index for frame in sequence] == [5]
    assert sequence.skipped == {"unreadable": 2, "wrong size": 1, "empty": 1, "no pose": 1}
    assert all("\n" not in problem for problem in sequence.problems)


@pytest.mark.parametrize(
    ("scale", "said"),
    [(1.0, "check depth_scale_m"), (1e-6, "check depth_scale_m")],
)
def test_a_scale_off_by_a_thousand_is_refused(tmp_path, scale, said):
    make_sequence(tmp_path / "s", depth_scale_m=scale)
    with pytest.raises(InputError, match=said):
        list(DepthSequence(tmp_path / "s"))


def test_frames_beyond_the_memory_are_refused_before_any_is_read(tmp_path, monkeypatch, capsys):
    """36 bytes for each of 40 x 30 pixels: 43.2 kB an image; a machine of 90 kB holds two of four, one of 190 kB all."""
    make_sequence(tmp_path / "s")
    sequence = DepthSequence(tmp_path / "s")
    assert [frame.index for frame in sequence.load(3)] == [0, 3]
    sizes = {"SC_PHYS_PAGES": 90, "SC_PAGE_SIZE": 1000}
    monkeypatch.setattr("os.sysconf", sizes.get)
    monkeypatch.setattr(DepthSequence, "_read", lambda *_: pytest.fail("an image was read"))
    with pytest.raises(InputError, match=r"4 images of 40 x 30 need .* \(--every\)"):
        sequence.load()
    monkeypatch.undo()
    monkeypatch.setattr("os.sysconf", sizes.get)
    assert main(["reconstruct", str(tmp_path / "s"), "--out", str(tmp_path / "m")]) == 2
    remedy = re.search(r"one of (\d+) images", capsys.readouterr().err)
    assert remedy
    assert len(sequence.load(int(remedy[1]))) == 2  # what is advised fits, and no more is left out
    sizes["SC_PHYS_PAGES"] = 150
    with pytest.raises(InputError, match="of memory"):
        sequence.load()
    sizes["SC_PHYS_PAGES"] = 190
    assert len(sequence.load()) == 4
    for every in (0, 1.5, math.inf):
        with pytest.raises(InputError, match=r"every: found .*, expected a whole number of 1 or more"):
            sequence.load(every)  # type: ignore[arg-type]
    monkeypatch.delattr("os.sysconf")  # Windows has none
    assert len(sequence.load()) == 4


@pytest.mark.parametrize("count", [5, 7, 8])
def test_the_advised_images_fit_where_the_memory_holds_no_whole_number(tmp_path, monkeypatch, count):
    """Memory of 2.4 images: one of three of seven would be three images, one too many."""
    make_sequence(tmp_path / "s", count=count)
    monkeypatch.setattr("os.sysconf", {"SC_PHYS_PAGES": 104, "SC_PAGE_SIZE": 1000}.get)
    sequence = DepthSequence(tmp_path / "s")
    with pytest.raises(InputError) as caught:
        sequence.load()
    advised = re.search(r"one of (\d+) images", str(caught.value))
    assert advised
    assert len(sequence.load(int(advised[1]))) == 2


def test_poses_in_millimetres_are_refused(tmp_path):
    _, poses = make_sequence(tmp_path / "s")
    moved = [(t, Pose(pose.rotation, 1000 * pose.translation_m)) for t, pose in poses]
    write_poses(tmp_path / "s" / "poses.txt", moved)
    with pytest.raises(InputError, match="poses are in metres"):
        DepthSequence(tmp_path / "s")


@pytest.mark.parametrize("name", ["../outside.yaml", "/etc/passwd", "a\0b"])
def test_the_description_cannot_lead_out_of_its_folder(tmp_path, name):
    make_sequence(tmp_path / "s", camera=name)
    with pytest.raises(InputError):
        DepthSequence(tmp_path / "s")


def test_a_frame_checks_its_shapes():
    camera = Camera.simple(4, 3, 5.0)
    with pytest.raises(InputError, match=r"expected float32 \(3, 4\)"):
        DepthFrame(0.0, np.ones((3, 4)), None, Pose.identity(), camera)


def test_colour_belongs_to_the_depth_of_its_name(tmp_path):
    """The first colour image is missing and there is one more at the end: as many as depth images, shifted by one."""
    make_sequence(tmp_path / "s")
    (tmp_path / "s/color/000000.png").rename(tmp_path / "s/color/000004.png")
    found = [frame.color for frame in DepthSequence(tmp_path / "s")]
    assert found[0] is None
    assert [int(color[0, 0, 0]) for color in found[1:]] == [1, 2, 3]


@pytest.mark.data
@pytest.mark.parametrize(
    ("layout", "frames", "median_m"),
    [
        ("d435i_robot_arm", 32, (0.3, 0.7)),
        ("apc_f200_shelf", 10, (0.5, 0.6)),
        ("cleargrasp_d435", 3, (0.5, 0.7)),
    ],
)
def test_published_layouts_are_imported(data, tmp_path, layout, frames, median_m, capsys):
    source = tmp_path / "source"
    # Links, so that only a part of the long sequence is decoded.
    real = data / "geometry" / "dev" / layout
    source.mkdir()
    for path in real.iterdir():
        if path.name != "depth":
            (source / path.name).symlink_to(path)
    if (real / "depth").is_dir():
        (source / "depth").mkdir()
        for k in range(1, 6):
            (source / "depth" / f"{k}.png").symlink_to(real / "depth" / f"{k}.png")
        frames = 5
    assert main(["recording", "import", str(source), "--out", str(tmp_path / "out"), "--json"]) == 0
    assert f'"frames": {frames}' in capsys.readouterr().out
    sequence = DepthSequence(tmp_path / "out")
    found = list(sequence.depth_images())
    assert len(found) == frames
    assert median_m[0] < np.nanmedian(found[0]) < median_m[1]
    assert all(sequence.color_paths)
    assert all((stamped.pose is None) == (layout == "cleargrasp_d435") for stamped in sequence.stamped)
    with pytest.raises(InputError, match="not empty"):
        import_sequence(source, tmp_path / "out")


@pytest.mark.data
def test_neighbouring_real_views_agree_in_the_world(data, tmp_path):
    """The poses' direction: clouds of two views 2-18 mm apart must lie on each other (2 mm by the source)."""
    from scipy.spatial import cKDTree

    imported = import_sequence(data / "geometry" / "dev" / "apc_f200_shelf", tmp_path / "out")
    assert imported.frames == 10
    clouds = []
    for frame in list(DepthSequence(imported.folder))[:2]:
        rows, columns = np.nonzero(np.isfinite(frame.depth_m))
        chosen = np.random.default_rng(0).permutation(len(rows))[:4000]
        pixels = np.column_stack([columns, rows])[chosen].astype(float)
        points = frame.camera.rays(pixels) * frame.depth_m[rows[chosen], columns[chosen], None]
        clouds.append(frame.T_world_camera.apply(points))
    distances, _ = cKDTree(clouds[0]).query(clouds[1])
    # Views are 6-8 cm apart and the samples 5 mm; with a wrong direction the clouds are decimetres apart.
    assert np.median(distances) < 0.01
