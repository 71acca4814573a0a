"""Recovery of files left by interrupted runs: tables, recordings, depth sequences."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ..core.errors import InputError, needs
from ..core.files import atomic_path, check_name, check_unlocked, read_head, whole_lines, write_text
from .depth.depth_sequence_out import recover_sequence
from .ros.mcap_records import MCAP_MAGIC, RecordedSchema
from .ros.sqlite_bag import is_bag, open_bag, write_bag
from .sinks.tables import pack_rows

#: Start of an Arrow message.
_ARROW = b"\xff\xff\xff\xff"


@dataclass(frozen=True, slots=True)
class Recovered:
    """A recovered recording."""

    path: Path  #: the recovered file or folder
    kind: Literal["CSV", "Parquet", "MCAP", "bag", "depth sequence"]
    count: int  #: rows, messages or frames


def recover(path: Path | str, out: Path | str | None = None) -> Recovered:
    """Recover all complete rows, messages or frames of an unfinished recording.

    The unfinished file is not changed; the folder of a depth sequence is completed in place. A recording of ROS 2 messages
    is written in the format given by the name of ``out``: ``NAME.mcap``, or a folder with a rosbag2 bag in SQLite.

    Parameters
    ----------
    path
        ``NAME.csv.part``, ``NAME.parquet.part``, ``NAME.mcap.part``, a truncated MCAP file, a rosbag2 bag, or the folder of
        a depth sequence whose writer was interrupted.
    out
        New file; by default the name without ``.part``.

    Raises
    ------
    InputError
        There is nothing to recover, another process is still writing it, or ``out`` exists.
    """
    path = check_name(path)
    bag = is_bag(path)
    if path.is_dir() and not bag:
        return Recovered(path, "depth sequence", recover_sequence(path))
    if not bag:
        check_unlocked(path)
    if out is None and path.suffix != ".part":
        raise InputError(path, "does not end with .part", remedy="name the new file with --out")
    target = path.with_suffix("") if out is None else check_name(out)
    if target.exists():
        raise InputError(target, "exists", remedy="name a new file with --out")
    head = MCAP_MAGIC if bag else read_head(path, len(MCAP_MAGIC))
    if head == MCAP_MAGIC:
        if not target.suffix:
            return Recovered(target, "bag", write_bag(open_bag(path), target))
        return Recovered(target, "MCAP", _mcap(path, target))
    if head[:4] == _ARROW:
        return Recovered(target, "Parquet", pack_rows(path, target))
    if any(byte < ord("\t") or byte > ord("~") for byte in head):
        raise InputError(path, "is neither a table, nor MCAP", remedy="it cannot be recovered")
    return Recovered(target, "CSV", _csv(path, target))


def _csv(path: Path, target: Path) -> int:
    lines = whole_lines(path)
    columns = len(next(csv.reader(lines[:1]), []))
    if columns < 2 or any(len(row) != columns for row in csv.reader(lines)):
        raise InputError(path, "is neither a table, nor MCAP", remedy="it cannot be recovered")
    write_text(target, "".join(f"{line}\n" for line in lines))
    return len(lines) - 1


def _mcap(path: Path, target: Path) -> int:
    with needs("mcap", "recording", "writing MCAP"):
        from mcap.writer import Writer
    file = open_bag(path)
    channels: dict[int, int] = {}
    schemas: dict[int, int] = {0: 0}
    count = 0
    with atomic_path(target) as temporary, temporary.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="visuohaptic")
        for message in file.messages():
            if message.schema not in schemas:
                # Where its record is damaged, the messages are kept without it.
                schema = file.schemas.get(message.schema) or RecordedSchema("", "", b"")
                schemas[message.schema] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if message.channel not in channels:
                channel = file.channels[message.channel]
                channels[message.channel] = writer.register_channel(
                    channel.topic, channel.encoding, schemas[message.schema]
                )
            time_ns = message.log_time_ns
            writer.add_message(
                channels[message.channel], time_ns, message.data, time_ns, sequence=message.sequence
            )
            count += 1
        writer.finish()
    return count
