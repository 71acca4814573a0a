"""Rosbag2 bags in SQLite, a ``.db3`` file or a folder of them: read with the interface of MCAP recordings, and written."""

from __future__ import annotations

import logging
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from copy import deepcopy
from pathlib import Path
from typing import Any

from ...core import InputError, read_head, save_yaml
from ...core.files.plain_json import dumps
from ._ros_definitions import definition
from .mcap_records import McapFile, McapMessage, RecordedChannel, RecordedSchema

_log = logging.getLogger(__name__)

_MAGIC = b"SQLite format 3\0"
#: Schema 4 of rosbag2_storage_sqlite3, as written by Iron and later.
_TABLES = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL,
    offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
    encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO schema VALUES (4, 'jazzy');
"""


def is_bag(path: Path) -> bool:
    """Whether a path is a rosbag2 bag: a ``.db3`` file, or a folder with ``metadata.yaml`` and such or MCAP files.

    Parameters
    ----------
    path
        File or folder.
    """
    if path.is_dir():
        return any(path.glob("*.db3")) or (path / "metadata.yaml").is_file()
    return path.suffix == ".db3"


def open_bag(path: Path | str) -> McapFile:
    """A recording of ROS 2 messages, in MCAP or SQLite.

    Parameters
    ----------
    path
        File, or folder of a bag.

    Raises
    ------
    InputError
        It is not a recording, or a folder of several MCAP files or with compressed ones.
    """
    path = Path(path)
    if path.is_dir():
        # Beside unpacked parts of a split bag, the packed ones would be left out silently.
        packed = [part for part in sorted(path.glob("*.zstd")) if not part.with_suffix("").exists()]
        if packed:
            raise InputError(
                path,
                f"{packed[0].name} is compressed as a whole, expected .db3 or .mcap",
                remedy=f"zstd -d {path / '*.zstd'}",
            )
    if path.is_dir() and not any(path.glob("*.db3")):
        files = sorted(path.glob("*.mcap"))
        if len(files) != 1:
            raise InputError(path, f"found {len(files)} MCAP files, expected one; name the one to read")
        return McapFile(files[0])
    return SqliteBag(path) if is_bag(path) else McapFile(path)


class SqliteBag(McapFile):
    """Messages of an SQLite bag, in temporal order.

    Since Iron, the bag contains the message definitions; for older bags, the definitions of this library are used,
    as far as available.

    Parameters
    ----------
    path
        ``.db3`` file, or folder of the parts of a split bag.

    Raises
    ------
    InputError
        The bag is missing or not SQLite.
    """

    kind = "SQLite"

    def __init__(self, path: Path | str) -> None:
        self._clear(path)
        if self.path.is_dir():
            self.parts = sorted(self.path.glob("*.db3"), key=_number)
        for part in self.parts:
            if (head := read_head(part, len(_MAGIC))) != _MAGIC:
                raise InputError(part, f"begins with {head!r}, expected a bag in SQLite")

    def messages(self, topics: set[str] | None = None) -> Iterator[McapMessage]:
        """All intact messages of the selected topics; afterwards, ``damage`` describes what was lost."""
        self.begin()
        for number, part in enumerate(self.parts):
            try:
                with closing(sqlite3.connect(f"{part.resolve().as_uri()}?mode=ro", uri=True)) as bag:
                    known = self._topics(bag, 10_000 * number)
                    rows = bag.execute(
                        "SELECT id, topic_id, timestamp, data FROM messages ORDER BY timestamp, id"
                    )
                    for sequence, topic, time_ns, data in rows:
                        # A column in SQLite may contain values of any type.
                        if not (topic in known and isinstance(time_ns, int) and isinstance(data, bytes)):
                            self.spoilt(f"{part.name}: message {sequence!r} has no topic, time or bytes")
                        elif topics is None or known[topic][0] in topics:
                            channel = self.channels[known[topic][2]]
                            if (whole := self.unpacked(data, channel, sequence)) is not None:
                                name, datatype, *numbers = known[topic]
                                yield McapMessage(name, datatype, time_ns, sequence, whole, *numbers)
            except (sqlite3.Error, TypeError, ValueError) as error:
                self.damage.chunks.append(f"{part.name}: {error}")
        if self.damage:
            _log.warning("%s is damaged: %s", self.path, self.damage)

    def _topics(self, bag: sqlite3.Connection, base: int) -> dict[int, tuple[str, str, int, int]]:
        """Id -> name, type, channel and schema; each part of a split bag has its own ids."""
        tables = {name for (name,) in bag.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if missing := {"topics", "messages"} - tables:
            # A view by this name may have rows without end.
            raise ValueError(f"has no table {min(missing)}, expected a bag of rosbag2")
        texts: dict[str, tuple[str, str]] = {}
        if "message_definitions" in tables:
            words = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            texts = {row[0]: row[1:] for row in bag.execute(words) if _are_texts(row)}
        known = {}
        for number, *words in bag.execute("SELECT id, name, type, serialization_format FROM topics"):
            if not _are_texts(words):
                continue  # its messages are reported as damage
            name, datatype, encoding = words
            channel = base + number
            self.channels[channel] = RecordedChannel(name, channel, encoding)
            kind, text = texts.get(datatype) or _own(datatype)
            if kind:
                self.schemas[channel] = RecordedSchema(datatype, kind, text.encode())
            known[number] = (name, datatype, channel, channel)
        return known


def write_bag(recording: McapFile, folder: Path) -> int:
    """Write a recording as an SQLite bag; returns the number of messages.

    Parameters
    ----------
    recording
        Its messages are written as CDR, unchanged.
    folder
        Folder of the bag, which is created; ``metadata.yaml`` is written last and marks a complete bag.

    Raises
    ------
    InputError
        The folder exists or cannot be written.
    """
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise InputError(folder, f"cannot be created ({error.strerror})") from error
    file = folder / f"{folder.name}_0.db3"
    try:
        with closing(sqlite3.connect(file)) as bag:
            bag.executescript(_TABLES)
            about = _write_messages(bag, recording, file.name)
            bag.commit()
    except sqlite3.Error as error:
        raise InputError(file, f"cannot be written ({error})") from error
    save_yaml(folder / "metadata.yaml", {"rosbag2_bagfile_information": about})
    return int(about["message_count"])


def _write_messages(bag: sqlite3.Connection, recording: McapFile, name: str) -> dict[str, Any]:
    """Fill the tables; returns the contents for ``metadata.yaml``."""
    numbers: dict[tuple[str, str, str], int] = {}  # by name, type and format of a topic
    for message in recording.messages():
        key = (message.topic, message.datatype, recording.channels[message.channel].encoding)
        if message.log_time_ns >= 1 << 63:
            recording.spoilt(f"a message at {message.log_time_ns} ns, which no bag in SQLite can hold")
            continue
        if key not in numbers:
            numbers[key] = len(numbers) + 1
            bag.execute("INSERT INTO topics VALUES (?, ?, ?, ?, '', '')", (numbers[key], *key))
        row = (numbers[key], message.log_time_ns, message.data)
        bag.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", row)
    for kind in {schema.name: schema for schema in recording.schemas.values()}.values():
        try:
            words = (kind.name, kind.encoding, kind.data.decode())
        except UnicodeDecodeError:
            continue  # damaged schema: readers that know the type do not need it
        bag.execute("INSERT INTO message_definitions VALUES (NULL, ?, ?, ?, '')", words)
    times = "SELECT count(*), coalesce(min(timestamp), 0), coalesce(max(timestamp), 0) FROM messages"
    count, first, last = bag.execute(times).fetchone()
    counts = dict(bag.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
    file = {
        "duration": {"nanoseconds": last - first},
        "starting_time": {"nanoseconds_since_epoch": first},
        "message_count": count,
    }
    about = {
        "version": 9,
        "storage_identifier": "sqlite3",
        **file,
        "topics_with_message_count": [
            {"topic_metadata": {"name": topic, "type": kind, "serialization_format": form,
                                "offered_qos_profiles": [], "type_description_hash": ""},
             "message_count": counts[number]}
            for (topic, kind, form), number in numbers.items()
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [name],
        "files": [{"path": name, **deepcopy(file)}],
        "custom_data": None,
        "ros_distro": "jazzy",
    }  # fmt: skip
    bag.execute("INSERT INTO metadata VALUES (1, 9, ?)", (dumps(about),))
    return about


def _number(path: Path) -> tuple[int, str]:
    """Sort key of the parts of a split bag: ``bag_0.db3`` to ``bag_12.db3``."""
    digits = path.stem.rpartition("_")[2]
    return (int(digits) if digits.isdecimal() else 0), path.name


def _are_texts(row: Sequence[Any]) -> bool:
    return all(isinstance(value, str) for value in row)


def _own(datatype: str) -> tuple[str, str]:
    try:
        return "ros2msg", definition(datatype)
    except InputError:
        return "", ""
