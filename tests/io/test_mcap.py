"""MCAP in and out against the independent readers and writers: rosbags, mcap-ros2-support."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from visuohaptic.core import Event, EventKind, InputError, Reason, Wrench
from visuohaptic.core.camera import Camera, Frame, Pose
from visuohaptic.io import recover
from visuohaptic.io.frames import open_source
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.io.ros import McapFile, ros_messages
from visuohaptic.io.ros._ros_definitions import _PARTS, definition
from visuohaptic.io.ros.ros_image import camera_from_message
from visuohaptic.io.ros.sqlite_bag import write_bag as write_sqlite
from visuohaptic.io.sinks import MeasurementWriter

from .helpers import picture, profile

STORE = get_typestore(Stores.ROS2_HUMBLE)


def header(t_ns: int, frame: str = "camera") -> Any:
    time = STORE.types["builtin_interfaces/msg/Time"](t_ns // 10**9, t_ns % 10**9)
    return STORE.types["std_msgs/msg/Header"](time, frame)


def write_bag(folder: Path, images: list[np.ndarray], encoding: str, *, pad: int = 0, big: int = 0) -> Path:
    """An MCAP bag written by rosbags."""
    kind = "sensor_msgs/msg/Image"
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/cam/image", kind, typestore=STORE)
        for number, image in enumerate(images):
            t_ns = 10**9 + number * 40_000_000
            rows = image.reshape(image.shape[0], -1).view(np.uint8)
            rows = np.pad(rows, ((0, 0), (0, pad)), constant_values=7)
            height, width = image.shape[:2]
            message = STORE.types[kind](
                header(t_ns), height, width, encoding, big, rows.shape[1], rows.ravel()
            )
            writer.write(connection, t_ns + 5000, STORE.serialize_cdr(message, kind))
    return next(folder.glob("*.mcap"))


def read_all(path: Path) -> list[tuple[str, int, Any]]:
    with AnyReader([path]) as reader:
        return [(c.topic, t, reader.deserialize(raw, c.msgtype)) for c, t, raw in reader.messages()]


@pytest.mark.parametrize("short", [name for name in _PARTS if name != "builtin_interfaces/Time"])
def test_definitions_have_the_hashes_of_ros(short: str) -> None:
    from rosbags.typesys import get_types_from_msg

    name = short.replace("/", "/msg/")
    ours = get_typestore(Stores.EMPTY)
    ours.register({"builtin_interfaces/msg/Time": STORE.fielddefs["builtin_interfaces/msg/Time"]})
    ours.register(get_types_from_msg(definition(name), name))
    assert ours.hash_rihs01(name) == STORE.hash_rihs01(name)


GREY = [picture(n, colour=False) for n in range(3)]
BGR = [picture(n) for n in range(3)]


@pytest.mark.parametrize(
    ("encoding", "sent", "expected"),
    [
        ("mono8", GREY, GREY),
        ("bgr8", BGR, BGR),
        ("rgb8", [i[..., ::-1].copy() for i in BGR], BGR),
        ("bgra8", [np.dstack([i, i[..., :1]]) for i in BGR], BGR),
        ("rgba8", [np.dstack([i[..., ::-1], i[..., :1]]) for i in BGR], BGR),
        ("mono16", [i.astype(np.uint16) * 256 + 99 for i in GREY], GREY),
    ],
)
@pytest.mark.parametrize("pad", [0, 6])
def test_images_of_rosbags(
    tmp_path: Path, encoding: str, sent: list[np.ndarray], expected: list[np.ndarray], pad: int
) -> None:
    path = write_bag(tmp_path / "bag", sent, encoding, pad=pad)
    with open_source(path) as source:
        frames = list(source)
    assert [f.t_s for f in frames] == pytest.approx([1.0, 1.04, 1.08], abs=1e-9)
    for frame, image in zip(frames, expected, strict=True):
        np.testing.assert_array_equal(frame.image, image)
    frame.image[0, 0] = 1  # a frame owns its pixels


def test_12_bits_in_16_are_left_out_with_a_reason(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A driver that does not scale them: of 256 grey levels, 16 would remain."""
    path = write_bag(tmp_path / "bag", [image.astype(np.uint16) * 16 for image in GREY], "mono16")
    with open_source(path) as source, pytest.raises(InputError, match="none of 3 frames could be decoded"):
        list(source)
    assert " grey levels would remain; expected white at 65535" in caplog.text


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer(tmp_path: Path, pattern: str) -> None:
    """A plain colour under the named pattern of filters comes back as that colour."""
    blue, green, red = 40, 120, 200
    level = {"r": red, "g": green, "b": blue}
    tile = np.array(
        [[level[pattern[0]], level[pattern[1]]], [level[pattern[2]], level[pattern[3]]]], np.uint8
    )
    path = write_bag(tmp_path / "bag", [np.tile(tile, (12, 16))], f"bayer_{pattern}8")
    with open_source(path) as source:
        image = next(iter(source)).image
    np.testing.assert_array_equal(image[6, 6], [blue, green, red])


@pytest.mark.parametrize("encoding", ["yuyv", "yuv422_yuy2", "uyvy", "yuv422"])
def test_colours_shared_by_two_pixels(tmp_path: Path, encoding: str) -> None:
    """Plain colours, converted by the equations of ITU-R BT.601, come back."""
    red, green, blue = (
        np.array([[30.0, 200.0, 90.0, 250.0]] * 6)[:, order]
        for order in np.mgrid[:3, :4][1] - [[0], [1], [2]]
    )
    y = 16 + 0.257 * red + 0.504 * green + 0.098 * blue
    u = 128 - 0.148 * red - 0.291 * green + 0.439 * blue
    v = 128 + 0.439 * red - 0.368 * green - 0.071 * blue
    twice_y = np.repeat(y, 2, axis=1)
    colour = np.stack([u, v], axis=-1).reshape(6, 8)
    pair = (twice_y, colour) if encoding.startswith("yu") and "y" in encoding[-4:] else (colour, twice_y)
    path = write_bag(tmp_path / "bag", [np.stack(pair, axis=-1).round().astype(np.uint8)], encoding)
    with open_source(path) as source:
        image = next(iter(source)).image
    expected = np.repeat(np.stack([blue, green, red], axis=-1), 2, axis=1)
    np.testing.assert_allclose(image, expected, atol=2.0)  # three roundings of a level, times 1.6 at most


def test_pairs_of_pixels_need_an_even_width(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", [np.zeros((6, 7, 2), np.uint8)], "yuyv")
    with open_source(path) as source, pytest.raises(InputError, match="none of 1 frames"):
        list(source)


def test_unknown_encoding_and_wrong_data_size(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "a", GREY, "nv21")
    with (
        pytest.raises(InputError, match="found 'nv21', expected one of mono8"),
        open_source(path) as source,
    ):
        list(source)
    # Says 3 bytes per pixel, has one: refused before pixels are touched.
    path = write_bag(tmp_path / "b", GREY, "bgr8")
    with pytest.raises(InputError, match="none of 3 frames could be decoded"), open_source(path) as source:
        list(source)


def test_topics_are_chosen_or_named(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with MeasurementWriter(path) as writer:
        for number in range(3):
            writer.write_frame(Frame(BGR[number], number * 0.1, number), "left")
            writer.write_frame(Frame(GREY[number], number * 0.1, number), "right", compressed=False)
        writer.write_camera(Camera.simple(64, 48, 60.0), 0.0, "left")
    with pytest.raises(InputError, match=r"/left/image/compressed, /right/image, expected exactly one"):
        open_source(path)
    with open_source(f"{path}:/left/image/compressed") as source:
        np.testing.assert_array_equal(next(iter(source)).image, BGR[0])
        assert source.camera is not None
        assert source.camera.focal_px == 60.0
    with open_source(f"{path}:/right/image") as source:
        assert [f.image.ndim for f in source] == [2, 2, 2]
        assert source.camera is None
    with pytest.raises(InputError, match="has no images on '/up'"):
        open_source(f"{path}:/up")
    # The folder of a bag as well.
    write_sqlite(McapFile(path), tmp_path / "bag")
    with open_source(f"{tmp_path / 'bag'}:/left/image/compressed") as source:
        np.testing.assert_array_equal(next(iter(source)).image, BGR[0])


def test_a_map_among_costmaps_has_to_be_named(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with MeasurementWriter(path) as writer:
        for number, topic in enumerate(("/map", "/local_costmap/costmap")):
            grid = OccupancyMap(np.full((2, 3), 100 * number, np.int8), 0.05)
            writer.write(topic, "nav_msgs/msg/OccupancyGrid", number, grid.to_message(number))
    with pytest.raises(InputError, match="has maps on /local_costmap/costmap, /map; name one topic"):
        OccupancyMap.from_mcap(path)
    assert OccupancyMap.from_mcap(path, "/map").free.all()


@pytest.mark.parametrize("topic", ["/eye/image", "/eye/image_rect", "/eye/image_rect_color/compressed"])
def test_rectified_images_have_the_projection_and_no_distortion(topic: str) -> None:
    """CameraInfo describes the raw image and the rectified one; no projection is given by some drivers."""
    camera = Camera(
        64, 48, np.array([[60.0, 0, 31], [0, 61, 23], [0, 0, 1]]), np.array([-0.2, 0.05, 0, 0, 0])
    )
    info = ros_messages.camera_info(1.0, camera, "eye")
    info["p"] = [55.0, 0, 30, 0, 0, 55, 22, 0, 0, 0, 1, 0]
    message = SimpleNamespace(**{**info, "header": SimpleNamespace(frame_id="eye")})
    found = camera_from_message(message, "here", topic)
    if topic == "/eye/image":
        np.testing.assert_array_equal(found.matrix, camera.matrix)
        np.testing.assert_array_equal(found.distortion, camera.distortion)
    else:
        assert found.matrix.tolist() == [[55, 0, 30], [0, 55, 22], [0, 0, 1]]
        assert not found.distortion.any()
        message.p = [0.0] * 12
        np.testing.assert_array_equal(camera_from_message(message, "here", topic).matrix, camera.matrix)


def test_measurements_are_read_by_rosbags_and_mcap(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    good, bad = profile(1.5), profile(1.6, valid=False, force_N=9.0)
    covariance = np.diag(np.arange(1.0, 7.0))
    wrench = Wrench(2.0, True, Reason.OK, np.array([1.0, 2, 3]), np.array([4.0, 5, 6]), covariance, "tip")
    camera = Camera(640, 480, np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]]), np.arange(5) * 0.01)
    pose = Pose.from_rotation_vector([0.1, -0.2, 0.3], [1.0, 2.0, 3.0])
    grid = OccupancyMap(np.array([[0, 100, -1], [50, 0, 0]], dtype=np.int8), 0.05, (1.0, -2.0, 0.5))
    with MeasurementWriter(path, frame="foam") as writer:
        writer.write_force(good)
        writer.write_force(bad)
        writer.write_event(Event(EventKind.CONTACT, 1.7, 0.01))
        writer.write_wrench(wrench)
        writer.write_camera(camera, 2.1)
        writer.write_pose(pose, 2.2)
        writer.write_pose(pose, 2.3, "/pose_cov", covariance=covariance)
        writer.write_map(grid, 2.4)
        writer.write_frame(Frame(BGR[0], 2.5, 0), quality=90)
        assert not path.exists(), "the file has its name only when it is whole"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.mcap"]
    found = read_all(path)
    by_topic: dict[str, list[tuple[int, Any]]] = {}
    for topic, t_ns, message in found:
        by_topic.setdefault(topic, []).append((t_ns, message))
    (first_ns, first), (_, second) = by_topic["/foam/wrench"]
    assert first_ns == 1_500_000_000
    assert (first.header.stamp.sec, first.header.stamp.nanosec) == (1, 500_000_000)
    assert first.wrench.force.x == pytest.approx(2.25)
    assert np.isnan(second.wrench.force.x), "an invalid force is no number for a reader of wrenches"
    status = by_topic["/foam/diagnostics"][1][1].status[0]
    values = {v.key: v.value for v in status.values}
    assert status.message == "occluded"
    assert float(values["force_N"]) == 9.0, "but it is not lost"
    assert float(values["model_N"]) == pytest.approx(0.03)
    cloud = by_topic["/foam/profile"][0][1]
    kinds = {7: "<f4", 8: "<f8"}
    layout = np.dtype([(f.name, kinds[f.datatype]) for f in cloud.fields])
    points = np.frombuffer(cloud.data.tobytes(), layout)
    np.testing.assert_array_equal(points["delta"], good.delta_m)
    np.testing.assert_array_equal(points["pressure"], good.pressure_Pa)
    contour = by_topic["/foam/contact"][0][1]
    names = [f.name for f in contour.fields]
    assert names == ["x", "y", "z", "delta", "pressure", "sigma", "contact"]
    values_array = np.frombuffer(contour.data.tobytes(), "<f4").reshape(-1, 7)
    inside = good.delta_m > 0
    np.testing.assert_allclose(values_array[:, 4], good.pressure_Pa[inside], rtol=1e-6)
    np.testing.assert_allclose(values_array[:, :2], good.contacts[0].points_foam_m, rtol=1e-6)
    assert json.loads(by_topic["/foam/event"][0][1].data) == {"kind": "contact", "t_s": 1.7, "s_m": 0.01}
    force = by_topic["/beam/wrench"][0][1]
    assert (force.wrench.force.z, force.wrench.torque.x, force.header.frame_id) == (3.0, 4.0, "tip")
    info = by_topic["/camera/camera_info"][0][1]
    np.testing.assert_array_equal(info.k.reshape(3, 3), camera.matrix)
    np.testing.assert_array_equal(info.d, camera.distortion)
    orientation = by_topic["/pose"][0][1].pose.orientation
    quaternion = [orientation.x, orientation.y, orientation.z, orientation.w]
    np.testing.assert_allclose(quaternion, pose.quaternion_xyzw, atol=1e-15)
    sent = by_topic["/pose_cov"][0][1].pose.covariance
    np.testing.assert_array_equal(sent.reshape(6, 6), covariance)
    message = by_topic["/map"][0][1]
    np.testing.assert_array_equal(message.data.reshape(2, 3), grid.cells)
    jpeg = cv2.imdecode(by_topic["/camera/image/compressed"][0][1].data, cv2.IMREAD_COLOR)
    assert jpeg.shape == BGR[0].shape
    back = OccupancyMap.from_mcap(path)
    np.testing.assert_array_equal(back.cells, grid.cells)
    assert back.resolution_m == pytest.approx(0.05)
    assert back.origin == pytest.approx(grid.origin, abs=1e-12)
    # The second independent reader.
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = {m.channel.topic: m.decoded_message for m in reader.iter_decoded_messages()}
        assert len(decoded) == len(by_topic)
        assert decoded["/beam/wrench"].wrench.torque.z == 6.0


def long_file(path: Path, count: int = 40, chunk_bytes: int = 20_000) -> list[np.ndarray]:
    rng = np.random.default_rng(5)
    images = [rng.integers(0, 255, (48, 64), dtype=np.uint8) for _ in range(count)]
    with MeasurementWriter(path, chunk_bytes=chunk_bytes) as writer:
        for number, image in enumerate(images):
            writer.write_frame(Frame(image, number * 0.05, number), compressed=False)
    return images


@pytest.mark.parametrize("part", [0.2, 0.5, 0.77, 0.98])
def test_cut_file_gives_all_that_is_whole(tmp_path: Path, part: float) -> None:
    """No footer and half a chunk at the end, where the readers of the mcap package give up."""
    path = tmp_path / "a.mcap"
    images = long_file(path)
    data = path.read_bytes()
    cut = int(len(data) * part)
    path.write_bytes(data[:cut])
    with open_source(path) as source:
        frames = list(source)
        assert source.damage.cut
    # Noise does not compress: about this many images are in the file; the one that is cut is lost,
    # and zstd gives whole blocks (128 kB) only, so a cut chunk of 20 kB may be lost with it.
    whole = int(cut / len(data) * 40)
    assert whole - 9 <= len(frames) <= whole + 1
    for number, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.image, images[number])


def test_damaged_chunk_is_left_out_and_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "a.mcap"
    long_file(path)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    with open_source(path) as source:
        frames = list(source)
        assert len(source.damage.chunks) == 1
        assert "chunk at byte" in str(source.damage)
    assert 25 <= len(frames) < 40
    gaps = np.diff([f.index for f in frames])
    assert gaps.max() > 1, "the missing frames leave a gap"
    assert "is damaged" in caplog.text


def test_noise_never_hangs_nor_leaks_foreign_errors(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    long_file(path, 8)
    data = path.read_bytes()
    rng = np.random.default_rng(11)
    for _ in range(60):
        spoilt = bytearray(data)
        for place in rng.integers(8, len(data), 12):
            spoilt[place] = rng.integers(0, 256)
        path.write_bytes(spoilt)
        try:
            with open_source(path) as source:
                list(source)
        except InputError:
            pass


def test_messages_out_of_order_are_sorted(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    order = [0, 2, 1, 3, 5, 4, 6]
    with MeasurementWriter(path) as writer:
        for number in order:
            writer.write_frame(Frame(picture(number), number * 0.1, number), compressed=False)
    with open_source(path) as source:
        frames = list(source)
    assert [f.index for f in frames] == list(range(7))
    np.testing.assert_array_equal(frames[1].image, picture(1))


def test_nothing_is_lost_when_the_process_is_killed(tmp_path: Path) -> None:
    """Killed without warning, the .part file has every message whose write had returned."""
    code = (
        "import sys\n"
        "from visuohaptic.io import MeasurementWriter\n"
        "from visuohaptic.core import Event, EventKind\n"
        "writer = MeasurementWriter(sys.argv[1])\n"
        "for n in range(25):\n"
        "    writer.write_event(Event(EventKind.CONTACT, float(n)))\n"
        "sys.stdout.write('written\\n'); sys.stdout.flush()\n"
        "sys.stdin.read()\n"
    )
    path = tmp_path / "run.mcap"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(
        [sys.executable, "-c", code, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment,
    ) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"written\n"
        child.send_signal(signal.SIGKILL)
    part = tmp_path / "run.mcap.part"
    assert not path.exists()
    file = McapFile(part)
    assert [topic.messages for topic in file.topics()] == [25]
    assert file.damage.cut
    with MeasurementWriter(path) as writer:
        writer.write_event(Event(EventKind.RELEASE, 1.0))
    assert (tmp_path / "run.unfinished1.mcap.part").exists(), "a new run keeps what the last one left"


def test_bad_use(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="its folder does not exist"):
        MeasurementWriter(tmp_path / "no" / "a.mcap")
    writer = MeasurementWriter(tmp_path / "a.mcap")
    with pytest.raises(InputError, match="found nan, expected 0 to"):
        writer.write_event(Event(EventKind.CONTACT, float("nan")))
    writer.close()
    writer.close()
    with pytest.raises(InputError, match="is closed"):
        writer.write_event(Event(EventKind.CONTACT, 1.0))
    with pytest.raises(InputError, match="no image topic"):
        open_source(tmp_path / "a.mcap")
    (tmp_path / "b.mcap").write_bytes(b"hello, world")
    with pytest.raises(InputError, match="expected an MCAP file"):
        open_source(tmp_path / "b.mcap")


@pytest.mark.parametrize("compression", ["NONE", "LZ4", "ZSTD"])
def test_all_compressions_whole_and_cut(tmp_path: Path, compression: str) -> None:
    """Written by mcap-ros2-support; cut in the last chunk, what can be unpacked of it is read."""
    from mcap.writer import CompressionType
    from mcap_ros2.writer import Writer as RosWriter

    from visuohaptic.io.ros import ros_messages

    path = tmp_path / "a.mcap"
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 255, (48, 64), dtype=np.uint8) for _ in range(12)]
    with path.open("wb") as stream:
        writer = RosWriter(stream, chunk_size=1 << 20, compression=CompressionType[compression])
        schema = writer.register_msgdef("sensor_msgs/msg/Image", definition("sensor_msgs/msg/Image"))
        for number, image in enumerate(images):
            writer.write_message("/i", schema, ros_messages.image(number, image, "c"), log_time=number)
        writer.finish()
    with open_source(path) as source:
        for frame, image in zip(source, images, strict=True):
            np.testing.assert_array_equal(frame.image, image)
    if compression == "NONE":
        # One chunk holds all; its first half is whole messages.
        path.write_bytes(path.read_bytes()[:20_000])
        with open_source(path) as source:
            assert len(list(source)) == 6


def test_decompression_bomb_is_left_out(tmp_path: Path) -> None:
    import struct

    import zstandard

    path = tmp_path / "a.mcap"
    writer = MeasurementWriter(path)
    writer.write_event(Event(EventKind.CONTACT, 1.0))
    writer.close()
    whole = path.read_bytes()
    packed = zstandard.compress(b"\0" * 50_000_000)
    for claimed in (50, 1 << 40):
        body = struct.pack("<QQQI", 0, 0, claimed, 0) + struct.pack("<I", 4) + b"zstd"
        body += struct.pack("<Q", len(packed)) + packed
        path.write_bytes(whole[:8] + struct.pack("<BQ", 6, len(body)) + body + whole[8:])
        file = McapFile(path)
        assert len(list(file.messages())) == 1
        assert "unpacks to 51 bytes, expected 50" in str(file.damage) or "declares" in str(file.damage)


def test_a_record_larger_than_any_is_left_out_unread(tmp_path: Path) -> None:
    """Five gigabytes of a sparse file: reading them would take the memory of the machine."""
    source = write_bag(tmp_path / "bag", [picture(0)], "mono8")
    whole = source.read_bytes()
    length = 5_000_000_000
    with (tmp_path / "huge.mcap").open("wb") as stream:
        stream.write(whole[:8] + b"\6" + length.to_bytes(8, "little"))
        stream.seek(length, os.SEEK_CUR)
        stream.write(whole[8:])
    file = McapFile(tmp_path / "huge.mcap")
    assert len(list(file.messages())) == 1
    assert "has 5000000000 bytes, expected at most" in str(file.damage)


def test_messages_without_their_schema_are_recovered(tmp_path: Path) -> None:
    """A damaged name of a type: the messages themselves are whole."""
    data = STORE.serialize_cdr(STORE.types["std_msgs/msg/String"]("a"), "std_msgs/msg/String")
    with (tmp_path / "run.mcap.part").open("wb") as stream:
        writer = McapWriter(
            stream, compression=CompressionType.NONE, use_chunking=False, repeat_schemas=False
        )
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        writer.add_message(writer.register_channel("/said", "cdr", schema), 5, data, 5)
        writer.finish()
    damaged = (tmp_path / "run.mcap.part").read_bytes().replace(b"std_msgs/msg", b"std_\xffsgs/msg")
    (tmp_path / "run.mcap.part").write_bytes(damaged)
    assert recover(tmp_path / "run.mcap.part").count == 1
    (message,) = McapFile(tmp_path / "run.mcap").messages()
    assert (message.topic, message.datatype, message.data) == ("/said", "", data)


@pytest.mark.parametrize(("chunk_bytes", "max_bytes"), [(0, 2.0), (1 << 16, 40.0)])
def test_a_long_recording_keeps_nothing_of_its_messages(
    tmp_path: Path, chunk_bytes: int, max_bytes: float
) -> None:
    """An index entry per message would be half a kilobyte: a quarter of a gigabyte an hour."""
    import tracemalloc

    def write(count: int) -> None:
        for _ in range(count):
            writer.write("/a/event", "std_msgs/msg/String", 1.0, {"data": "x" * 100})

    with MeasurementWriter(tmp_path / "long.mcap", chunk_bytes=chunk_bytes) as writer:
        write(1000)
        tracemalloc.start()
        try:
            before = tracemalloc.get_traced_memory()[0]
            write(6000)
            grown = tracemalloc.get_traced_memory()[0] - before
        finally:
            tracemalloc.stop()
    assert grown < max_bytes * 6000
