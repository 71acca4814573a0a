"""``visuohaptic recording recover``: restore the recording of an interrupted run, or convert a bag.

reads   what a killed run or a full disk left behind: NAME.csv.part, NAME.parquet.part, NAME.mcap.part,
        a truncated MCAP file, a rosbag2 bag (also a damaged one), or the folder of a depth sequence without sequence.yaml
writes  every complete row, message or frame to NAME without .part, or to --out; existing files are not overwritten.
        ROS 2 messages become MCAP where --out ends in .mcap, otherwise a rosbag2 folder with SQLite

example: visuohaptic recording recover run.mcap.part
"""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any

from .... import io


def add_arguments(add: Any) -> None:
    """Arguments of the command."""
    add("path", Path, "unfinished file, bag, or folder of a depth sequence")
    add("--out", Path, "file to write (default: the name without .part)")


def needs(args: Any) -> set[str]:
    """Libraries beyond the core, by the name of the file.

    Parameters
    ----------
    args
        As parsed.
    """
    return {
        library
        for kind, library in ((".mcap", "mcap"), (".parquet", "pyarrow"))
        if kind in (args.path.suffix, args.path.with_suffix("").suffix, getattr(args.out, "suffix", ""))
    }


def run(args: Namespace) -> dict[str, Any]:
    """Recover; returns what is printed."""
    found = io.recover(args.path, args.out)
    return {"path": str(found.path), "kind": found.kind, "recovered": found.count}
