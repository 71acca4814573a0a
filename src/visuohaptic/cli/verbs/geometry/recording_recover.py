"""``visuohaptic recording recover``: a killed run's recording made whole, or a bag another kind of bag.

reads   what a run that was killed, or met a full disk, has left: NAME.csv.part, NAME.parquet.part, NAME.mcap.part,
        a cut MCAP file, a bag of rosbag2 (also a damaged one), or the folder of a depth sequence without sequence.yaml
writes  all whole rows, messages or frames: NAME without .part, or the file --out; never over another file.
        ROS 2 messages become MCAP where --out ends in .mcap, else a folder with a bag of rosbag2 in SQLite

example: visuohaptic recording recover run.mcap.part
"""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any

__all__ = ["add_arguments", "needs", "run"]


def add_arguments(add: Any) -> None:
    """Arguments of the command."""
    add("path", Path, "the unfinished file, the bag, or the folder of a depth sequence")
    add("--out", Path, "the new file (default: the name without .part)")


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
    from ....io.recovery import recover

    found = recover(args.path, args.out)
    return {"path": str(found.path), "kind": found.kind, "recovered": found.count}
