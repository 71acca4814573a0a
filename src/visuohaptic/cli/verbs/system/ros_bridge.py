"""``visuohaptic ros bridge``: run the sensors as a ROS 2 node.

reads
  bridge.yaml  node: name, namespace, domain, type_hashes (no for Humble), connect, listen, zenoh_config
               sensors: name, config (sensor.yaml or scene.yaml), image (topic), odometry, zero_frames
               (see `visuohaptic defaults bridge`)
writes, for each sensor NAME
  /NAME/wrench        geometry_msgs/WrenchStamped, NaN when invalid
  /NAME/diagnostics   diagnostic_msgs/DiagnosticArray: validity, reason, all values; stale without images
  /NAME/profile, /NAME/contact, /NAME/event, /NAME/markers of a foam sensor; /NAME/pose of a scene

Runs until Ctrl-C or SIGTERM, with exit code 0. It needs a running router (ros2 run rmw_zenoh_cpp rmw_zenohd)
unless connect is empty.

example: visuohaptic ros bridge bridge.yaml
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .... import ros
from ....core.resources import reuse_memory
from ..._stop import signals

#: Optional modules that the verb imports.
NEEDS = ("zenoh",)


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("config", Path, "bridge.yaml")
    add("--duration", float, "stop after S seconds", metavar="S", low=0, above=True)


def run(args: Any) -> dict[str, Any]:
    """Run the verb; returns the mapping that ``--json`` prints."""
    from ....core.files.plain_json import picked

    reuse_memory()
    with ros.Bridge.load(args.config) as bridge:
        args.report(
            f"{bridge.node.resolve(bridge.node.name)} runs: {', '.join(_topics(bridge))}; end with Ctrl-C"
        )
        with signals(bridge.stop):
            _wait(args, bridge)
    counts = "name frames reasons stale lost left_out damaged"
    sensors = [picked(report, counts) for report in bridge.reports]
    for sensor in sensors:
        reasons = ", ".join(f"{number} {reason}" for reason, number in sensor["reasons"].items())
        args.report(
            f"{sensor['name']}: {sensor['frames']} frames ({reasons or 'none'}), {sensor['stale']} times without "
            f"images, {sensor['lost']} lost or left out, {sensor['damaged']} damaged"
        )
    return {"sensors": sensors}


def _topics(bridge: ros.Bridge) -> Iterator[str]:
    for section in bridge.config.sensors:
        yield f"{bridge.node.resolve(section.image)} to {bridge.node.resolve(section.name)}/..."


def _wait(args: Any, bridge: ros.Bridge) -> None:
    left_s = float("inf") if args.duration is None else args.duration
    with args.progress(0, "reading") as bar:
        done = 0
        while left_s > 0 and not bridge.wait(min(left_s, 1.0)):
            left_s -= 1.0
            bar.advance(bridge.frames - done)
            done = bridge.frames
