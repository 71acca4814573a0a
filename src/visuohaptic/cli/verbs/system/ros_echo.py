"""``visuohaptic ros echo``: list the topics of a robot, or print the messages of one.

reads   the topics of the robot's graph
writes  one line of JSON per message on stdout; NaN is null, arrays of more than 128 values are given by their length

Without a topic, the published topics are listed with their types. The type is that of the publisher; it must be one
of the standard messages that this library knows. `ros2 topic echo` of an installation prints the same messages.

example: visuohaptic ros echo /foam/wrench --count 3
"""

from __future__ import annotations

from itertools import islice
from typing import Any

from .... import ros
from ....ros import transports
from .ros_node import add_transport, options_of


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("topic", str, "topic, such as /foam/wrench", nargs="?")
    add("--count", int, "stop after N messages", metavar="N", low=1)
    add("--timeout", 5.0, "longest wait for the topic and for a message", metavar="S", low=0, above=True)
    add_transport(add)


def run(args: Any) -> dict[str, Any]:
    """Run the verb; returns the mapping that ``--json`` prints."""
    from ....core.files.plain_json import dumps

    with transports.open_node("visuohaptic_echo", options_of(args), args.transport) as node:
        if args.topic is None:
            topics = {name: one.datatype for name, one in ros.find_topics(node, args.timeout).items()}
            for name, datatype in topics.items():
                args.report(f"{name}  {datatype}")
            return {"topics": topics}
        count = 0
        for message in islice(ros.echo(node, args.topic, args.timeout), args.count):
            args.report(dumps(message))
            count += 1
    return {"topic": args.topic, "messages": count}
