"""Bags in SQLite, written by the rosbags library, which shares no code with this one."""

from __future__ import annotations

import re
import sqlite3
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks._victim import Say, Victim

from visuohaptic.cli.main import main
from visuohaptic.core import InputError
from visuohaptic.io.frames import open_source
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.io.ros.sqlite_bag import SqliteBag, open_bag, write_bag

rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")
pytest.importorskip("mcap_ros2")

STORE = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
TYPES = STORE.types
IMAGES = np.random.default_rng(2).integers(0, 255, (3, 24, 32), dtype=np.uint8)


def header(t_s: float, frame: str = "cam") -> Any:
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=int(t_s), nanosec=round(t_s % 1 * 1e9))
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def vector(x: float) -> Any:
    return TYPES["geometry_msgs/msg/Vector3"](x=x, y=2.0, z=float("nan"))


def pose(x: float) -> Any:
    turn = TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    return TYPES["geometry_msgs/msg/Pose"](TYPES["geometry_msgs/msg/Point"](x=x, y=0.5, z=0.0), turn)


def kinds() -> dict[str, Any]:
    """One message of each of ten types that robots record."""
    zero = np.zeros(36)
    wrench = TYPES["geometry_msgs/msg/Wrench"](vector(1.5), vector(0.0))
    twist = TYPES["geometry_msgs/msg/Twist"](vector(0.25), vector(0.0))
    info = TYPES["nav_msgs/msg/MapMetaData"](header(1.0).stamp, 0.05, 3, 2, pose(1.0))
    with_covariance = TYPES["geometry_msgs/msg/PoseWithCovariance"](pose(1.0), zero)
    moving = TYPES["geometry_msgs/msg/TwistWithCovariance"](twist, zero)
    values = [TYPES["diagnostic_msgs/msg/KeyValue"]("force_N", "1.5")]
    status = TYPES["diagnostic_msgs/msg/DiagnosticStatus"](1, "foam", "stale", "f", values)
    ranges = np.array([1.0, np.inf], np.float32)
    return {
        "std_msgs/msg/String": TYPES["std_msgs/msg/String"]("Größe"),
        "geometry_msgs/msg/WrenchStamped": TYPES["geometry_msgs/msg/WrenchStamped"](header(1.0), wrench),
        "geometry_msgs/msg/PoseStamped": TYPES["geometry_msgs/msg/PoseStamped"](header(1.0), pose(1.0)),
        "geometry_msgs/msg/Twist": twist,
        "geometry_msgs/msg/PoseWithCovarianceStamped": TYPES["geometry_msgs/msg/PoseWithCovarianceStamped"](
            header(1.0), with_covariance
        ),
        "nav_msgs/msg/Odometry": TYPES["nav_msgs/msg/Odometry"](header(1.0), "base", with_covariance, moving),
        "nav_msgs/msg/OccupancyGrid": TYPES["nav_msgs/msg/OccupancyGrid"](
            header(1.0), info, np.array([0, 100, -1, 0, 0, 100], np.int8)
        ),
        "sensor_msgs/msg/LaserScan": TYPES["sensor_msgs/msg/LaserScan"](
            header(1.0), 0.0, 0.1, 0.1, 0.0, 0.1, 0.1, 9.0, ranges, np.zeros(0, np.float32)
        ),
        "diagnostic_msgs/msg/DiagnosticArray": TYPES["diagnostic_msgs/msg/DiagnosticArray"](
            header(1.0), [status]
        ),
        "sensor_msgs/msg/JointState": TYPES["sensor_msgs/msg/JointState"](
            header(1.0), ["a"], np.ones(1), np.ones(1), np.ones(1)
        ),
    }


def write(folder: Path, storage: Any, version: int) -> Path:
    """A bag with every kind once, and three images."""
    with rosbag2.Writer(folder, version=version, storage_plugin=storage) as bag:
        for number, (name, message) in enumerate(kinds().items()):
            link = bag.add_connection(f"/t{number}", name, typestore=STORE)
            bag.write(link, 1_000_000_000 + number, STORE.serialize_cdr(message, name))
        kind = "sensor_msgs/msg/Image"
        link = bag.add_connection("/camera/image", kind, typestore=STORE)
        for number, pixels in enumerate(IMAGES):
            image = TYPES[kind](header(5.0 + number), 24, 32, "mono8", 0, 32, pixels.ravel())
            bag.write(link, (5 + number) * 1_000_000_000, STORE.serialize_cdr(image, kind))
    return folder


STORAGES = [("SQLITE3", 8), ("SQLITE3", 9), ("MCAP", 9)]


@pytest.fixture(params=STORAGES, ids=lambda each: f"{each[0]}-{each[1]}")
def bag(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Version 8 has no definitions of its messages, version 9 has."""
    name, version = request.param
    return write(tmp_path / "bag", rosbag2.StoragePlugin[name], version)


def test_ten_kinds_are_read_as_they_were_written(bag: Path) -> None:
    file = open_bag(bag)
    found = {message.datatype: file.decode(message) for message in file.messages() if message.topic[1] == "t"}
    assert not file.damage
    assert found.keys() == kinds().keys()
    assert found["std_msgs/msg/String"].data == "Größe"
    assert found["geometry_msgs/msg/WrenchStamped"].wrench.force.x == pytest.approx(1.5)
    assert np.isnan(found["geometry_msgs/msg/WrenchStamped"].wrench.force.z)
    assert found["nav_msgs/msg/Odometry"].twist.twist.linear.x == pytest.approx(0.25)
    assert list(found["nav_msgs/msg/OccupancyGrid"].data) == [0, 100, -1, 0, 0, 100]
    assert found["sensor_msgs/msg/LaserScan"].ranges[1] == np.inf
    assert found["diagnostic_msgs/msg/DiagnosticArray"].status[0].values[0].key == "force_N"
    assert found["sensor_msgs/msg/JointState"].name == ["a"]


def test_its_images_are_frames_and_its_map_is_a_map(bag: Path) -> None:
    with open_source(bag) as source:
        frames = list(source)
    assert [frame.t_s for frame in frames] == pytest.approx([5.0, 6.0, 7.0])
    np.testing.assert_array_equal(np.stack([frame.image for frame in frames]), IMAGES)
    grid = OccupancyMap.from_mcap(bag)
    assert grid.cells.tolist() == [[0, 100, -1], [0, 0, 100]]


def test_a_file_alone_and_a_topic_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "bag", rosbag2.StoragePlugin.SQLITE3, 9)
    (path,) = (tmp_path / "bag").glob("*.db3")
    with open_source(f"{path}:/camera/image") as source:
        assert source.frame_count == 3
    assert main(["recording", "info", str(path)]) == 0
    assert "/camera/image" in capsys.readouterr().out


def test_a_damaged_bag_gives_what_is_whole(tmp_path: Path) -> None:
    write(tmp_path / "bag", rosbag2.StoragePlugin.SQLITE3, 9)
    (path,) = (tmp_path / "bag").glob("*.db3")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    file = SqliteBag(path)
    list(file.messages())
    assert file.damage
    path.write_bytes(b"no database")
    with pytest.raises(InputError, match="expected a bag in SQLite"):
        open_bag(path)
    with sqlite3.connect(tmp_path / "other.db3") as other:
        other.execute("CREATE TABLE a (b)")
    strange = SqliteBag(tmp_path / "other.db3")
    assert list(strange.messages()) == []
    assert "has no table" in str(strange.damage)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_messages_that_are_packed_one_by_one_are_unpacked(tmp_path: Path, storage: str) -> None:
    """Compression mode "message" of rosbag2, written by rosbags; one message that is spoilt is left out and told."""
    plain = write(tmp_path / "plain", rosbag2.StoragePlugin[storage], 9)
    packed = tmp_path / "packed"
    out = rosbag2.Writer(packed, version=9, storage_plugin=rosbag2.StoragePlugin[storage])
    out.set_compression(rosbag2.CompressionMode.MESSAGE, rosbag2.CompressionFormat.ZSTD)
    with out, rosbag2.Reader(plain) as reader:
        links = {
            link.id: out.add_connection(link.topic, link.msgtype, typestore=STORE)
            for link in reader.connections
        }
        for link, t_ns, data in reader.messages():
            out.write(links[link.id], t_ns, data)
    want = [(message.topic, message.log_time_ns, message.data) for message in open_bag(plain).messages()]
    file = open_bag(packed)
    assert [(message.topic, message.log_time_ns, message.data) for message in file.messages()] == want
    assert not file.damage
    (path,) = packed.glob("*.db3" if storage == "SQLITE3" else "*.mcap")
    data = path.read_bytes()
    place = data.index(b"\x28\xb5\x2f\xfd")
    path.write_bytes(data[: place + 4] + b"\xff\xff" + data[place + 6 :])
    file = open_bag(packed)
    assert len(list(file.messages())) == len(want) - 1
    assert re.search(r"message \d+ of /\S+: cannot be unpacked", str(file.damage))


def test_a_packed_message_that_is_not_whole_is_left_out(tmp_path: Path) -> None:
    """The first bytes of a cut frame unpack without an error: of "Größe" there was "Gr", as a whole message."""
    import zstandard

    text = STORE.serialize_cdr(kinds()["std_msgs/msg/String"], "std_msgs/msg/String")
    stream = zstandard.ZstdCompressor(write_content_size=False).compressobj()
    unsized = stream.compress(text) + stream.flush()
    whole = zstandard.ZstdCompressor().compress(text)
    huge = b"\x28\xb5\x2f\xfd\xe0" + (1 << 40).to_bytes(8, "little") + whole[6:]  # states a terabyte
    with sqlite3.connect(tmp_path / "run.db3") as bag:
        bag.execute("CREATE TABLE topics(id, name, type, serialization_format)")
        bag.execute("INSERT INTO topics VALUES (1, '/x', 'std_msgs/msg/String', 'cdr')")
        bag.execute("CREATE TABLE messages(id, topic_id, timestamp, data)")
        for number, data in enumerate((whole, whole[:-6], whole[:5], unsized, unsized[:-5], huge)):
            bag.execute("INSERT INTO messages VALUES (?, 1, ?, ?)", (number, number, data))
    file = open_bag(tmp_path / "run.db3")
    assert [(one.sequence, one.data) for one in file.messages()] == [(0, text)]
    assert len(file.damage.chunks) == 5
    assert "message 1 of /x: cannot be unpacked" in file.damage.chunks[0]
    assert "states no size" in file.damage.chunks[3]
    assert f"declares {1 << 40} bytes, expected at most" in file.damage.chunks[4]


def test_packed_messages_together_unpack_to_a_bounded_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of a thousand messages of 50 bytes may unpack to a megabyte; what one part may have, and no more, is unpacked."""
    import zstandard

    monkeypatch.setattr("visuohaptic.io.ros.mcap_records.MAX_DATA_BYTES", 2_000_000)
    monkeypatch.setattr("visuohaptic.io.ros.mcap_records._UNPACKED_PER_BYTE", 10)
    packed = zstandard.ZstdCompressor().compress(bytes(1_000_000))
    path = tmp_path / "run.db3"
    with sqlite3.connect(path) as bag:
        bag.execute("CREATE TABLE topics(id, name, type, serialization_format)")
        bag.execute("INSERT INTO topics VALUES (1, '/x', 'std_msgs/msg/String', 'cdr')")
        bag.execute("CREATE TABLE messages(id, topic_id, timestamp, data)")
        bag.executemany("INSERT INTO messages VALUES (?, 1, ?, ?)", [(k, k, packed) for k in range(1000)])
    file = open_bag(path)
    for _ in range(2):  # a second pass has the same budget
        sizes = [len(one.data) for one in file.messages()]
        assert sizes == [1_000_000] * ((2_000_000 + 10 * path.stat().st_size) // 1_000_000)
        assert "the file unpacks to more than 10 times its size" in str(file.damage.chunks[0])
        assert len(file.damage.chunks) == 100  # the report is bounded, too


def test_bags_that_are_packed_as_a_whole_name_the_remedy(tmp_path: Path) -> None:
    folder = write(tmp_path / "bag", rosbag2.StoragePlugin.SQLITE3, 9)
    (path,) = folder.glob("*.db3")
    packed = path.rename(path.with_suffix(".db3.zstd"))
    with pytest.raises(InputError, match=r"compressed as a whole.* zstd -d .*\*\.zstd"):
        open_bag(folder)
    packed.with_name("other_1.db3").write_bytes(packed.read_bytes())  # another part, which is unpacked
    with pytest.raises(InputError, match=rf"{packed.name} is compressed as a whole"):
        open_bag(folder)
    path.write_bytes(packed.read_bytes())  # as zstd does, which keeps the packed file
    assert isinstance(open_bag(folder), SqliteBag)


def messages_of(folder: Path) -> list[tuple[str, str, int, bytes]]:
    """What rosbags reads: topic, type, time and bytes of each message."""
    with rosbag2.Reader(folder) as reader:
        return [(link.topic, link.msgtype, t_ns, bytes(data)) for link, t_ns, data in reader.messages()]


def test_a_bag_in_sqlite_is_written(tmp_path: Path, bag: Path) -> None:
    """From every storage: rosbags reads the same messages from the new bag as from the one that it has written itself."""
    assert main(["recording", "recover", str(bag), "--out", str(tmp_path / "copy")]) == 0
    assert {path.name for path in (tmp_path / "copy").iterdir()} == {"copy_0.db3", "metadata.yaml"}
    before, after = messages_of(bag), messages_of(tmp_path / "copy")
    assert len(before) == len(kinds()) + len(IMAGES)
    assert after == before
    with rosbag2.Reader(tmp_path / "copy") as reader:
        assert (reader.start_time, reader.message_count) == (1_000_000_000, len(before))
        assert {link.msgdef.format.name for link in reader.connections} == {"MSG"}
    assert (
        main(["recording", "recover", str(bag), "--out", str(tmp_path / "copy")]) == 2
    )  # never over another one


def test_a_bag_in_sqlite_becomes_mcap(tmp_path: Path, bag: Path) -> None:
    assert main(["recording", "recover", str(bag), "--out", str(tmp_path / "run.mcap")]) == 0
    file = open_bag(tmp_path / "run.mcap")
    found = [(m.topic, m.datatype, m.log_time_ns, m.data) for m in file.messages()]
    assert sorted(found) == sorted(messages_of(bag))
    assert [m.data for m in file.messages({"/t0"})] == [
        STORE.serialize_cdr(kinds()["std_msgs/msg/String"], "std_msgs/msg/String")
    ]
    (text,) = (file.decode(message) for message in file.messages({"/t0"}))
    assert text.data == "Größe"


def test_an_empty_or_cut_recording_becomes_a_bag(tmp_path: Path) -> None:
    with rosbag2.Writer(tmp_path / "empty", version=9, storage_plugin=rosbag2.StoragePlugin.MCAP):
        pass
    assert main(["recording", "recover", str(tmp_path / "empty"), "--out", str(tmp_path / "none")]) == 0
    assert messages_of(tmp_path / "none") == []
    write(tmp_path / "bag", rosbag2.StoragePlugin.SQLITE3, 9)
    (path,) = (tmp_path / "bag").glob("*.db3")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert main(["recording", "recover", str(path), "--out", str(tmp_path / "rest")]) == 0
    assert len(messages_of(tmp_path / "rest")) <= len(kinds()) + len(IMAGES)


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE messages SET data = 'text' WHERE id = 2",
        "UPDATE messages SET timestamp = 2.5 WHERE id = 2",
        "UPDATE messages SET timestamp = 'noon' WHERE id = 2",
        "UPDATE messages SET topic_id = 'x' WHERE id = 2",
        "UPDATE topics SET name = x'01' WHERE id = (SELECT topic_id FROM messages WHERE id = 2)",
        "UPDATE topics SET type = x'01' WHERE id = (SELECT topic_id FROM messages WHERE id = 2)",
    ],
)
def test_rows_of_another_type_are_damage_and_the_others_are_read(tmp_path: Path, change: str) -> None:
    """A column of SQLite holds values of any type."""
    path = write(tmp_path / "bag", rosbag2.StoragePlugin.SQLITE3, 9)
    part = next(path.glob("*.db3"))
    whole = {message.sequence for message in SqliteBag(part).messages()}
    with sqlite3.connect(part) as bag:
        bag.execute(change)
    found = SqliteBag(part)
    read = list(found.messages())
    assert {message.sequence for message in read} == whole - {2}
    assert "has no topic, time or bytes" in str(found.damage)
    assert all(found.decode(message) is not None for message in read)


def test_what_no_bag_in_sqlite_can_hold_is_left_out(tmp_path: Path) -> None:
    """A damaged definition and a time beyond 63 bits: the other messages are whole."""
    from mcap.writer import Writer

    said = {
        name: STORE.serialize_cdr(TYPES["std_msgs/msg/String"](name), "std_msgs/msg/String") for name in "abc"
    }
    with (tmp_path / "damaged.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\xff\xfe")
        channel = writer.register_channel("/said", "cdr", schema)
        for name, time_ns in (("a", 5), ("b", 1 << 63), ("c", (1 << 63) - 1)):
            writer.add_message(channel, time_ns, said[name], time_ns)
        writer.finish()
    source = open_bag(tmp_path / "damaged.mcap")
    assert write_bag(source, tmp_path / "bag") == 2
    assert "which no bag in SQLite can hold" in str(source.damage)
    found = open_bag(tmp_path / "bag")
    messages = list(found.messages())
    assert [(one.log_time_ns, one.data) for one in messages] == [(5, said["a"]), ((1 << 63) - 1, said["c"])]
    assert [found.decode(one).data for one in messages] == ["a", "c"]  # by this library's own definition


@pytest.mark.skipif(sys.platform == "win32", reason="the limit for the size of files stands for the disk")
def test_a_full_disk_is_told_in_one_line_and_leaves_no_bag_that_looks_whole(
    tmp_path: Path, bag: Path
) -> None:
    def work(say: Say) -> None:
        resource = pytest.importorskip("resource")
        resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))
        try:
            write_bag(open_bag(bag), tmp_path / "copy")
        except InputError as error:
            say(str(error))

    (message,), _ = Victim.start(work).end()
    assert message.startswith(f"{tmp_path / 'copy' / 'copy_0.db3'}: cannot be written")
    assert not (tmp_path / "copy" / "metadata.yaml").exists()


def test_messages_without_end_are_no_bag(tmp_path: Path) -> None:
    """A view has the columns of the table, and as many rows as it likes: sorting them would fill the disk."""
    rows = "WITH RECURSIVE c(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM c) SELECT id, 1 topic_id, id timestamp, x'00' data FROM c"
    with sqlite3.connect(tmp_path / "view.db3") as bag:
        bag.execute("CREATE TABLE topics(id, name, type, serialization_format)")
        bag.execute("INSERT INTO topics VALUES (1, '/x', 'std_msgs/msg/String', 'cdr')")
        bag.execute(f"CREATE VIEW messages AS {rows}")
    found = SqliteBag(tmp_path / "view.db3")
    assert list(found.messages()) == []
    assert found.damage.chunks == ["view.db3: has no table messages, expected a bag of rosbag2"]
