"""``visuohaptic ros launch``: run several nodes from a launch file, with or without ROS.

reads
  robot.launch.xml   <launch> with <arg name="..." default="..."/> and <executable cmd="..."/>, $(var name) in the
                     latter: `ros2 launch` runs the same file
writes
  nothing itself; its nodes publish

Runs until Ctrl-C or SIGTERM, with exit code 0; when one process fails, all are stopped and the exit code is 3.
Without a name, the launch files of this library are listed.

example: visuohaptic ros launch
"""

from __future__ import annotations

import shlex
import threading
from pathlib import Path
from typing import Any

from ....core.errors import InputError
from ....ros import nodes
from ..._stop import signals


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("file", str, "*.launch.xml, or the name of one of this library", nargs="?")
    add("values", str, "arguments of the file", nargs="*", metavar="NAME:=VALUE")


def run(args: Any) -> dict[str, Any]:
    """Run the verb; returns the mapping that ``--json`` prints."""

    folder = Path(nodes.__file__).with_name("launch_files")
    own = {path.name.removesuffix(".launch.xml"): path for path in sorted(folder.glob("*.launch.xml"))}
    if args.file is None:
        for name, path in own.items():
            args.report(f"{name:<12} {path}")
        return {"files": {name: str(path) for name, path in own.items()}}
    given = {}
    for word in args.values:
        name, equals, value = word.partition(":=")
        if not equals:
            raise InputError("ros launch", f"found {word!r}, expected name:=value")
        given[name] = value
    if args.file not in own and not Path(args.file).exists():
        raise InputError(
            args.file, "does not exist", remedy=f"give a *.launch.xml file, or one of {', '.join(own)}"
        )
    commands = nodes.read_launch(own.get(args.file, Path(args.file)), given)
    for words in commands:
        args.report(shlex.join(words))
    stop = threading.Event()
    with signals(stop.set):
        nodes.run_launch(commands, stop)
    return {"commands": [list(words) for words in commands]}
