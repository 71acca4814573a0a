"""``visuohaptic map build``: build a map from laser scans and odometry.

reads   an MCAP file with sensor_msgs/LaserScan and nav_msgs/Odometry, or a CSV file (t_s, x_m, y_m, yaw_rad,
        angle_min_rad, angle_step_rad, range_min_m, range_max_m, r0, r1, ...)
writes  a map_server YAML file with its PGM image

Every scan is matched with the map built so far; scans that do not match are left out and counted.
Several files are mapped as separate floors: --out is then a folder with one map per file. With --workers or
--cluster, the floors are built in parallel.

Example: visuohaptic map build run.mcap --out map.yaml
         visuohaptic map build floor-1.mcap floor-2.mcap --out maps
"""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any

from .... import core, io
from ....navigation import mapping
from ..._workers import add_worker_arguments, chosen_workers


def add_arguments(add: Any) -> None:
    """Arguments of the command."""
    add("scans", str, "MCAP or CSV file, one for each floor", nargs="+")
    add("--out", str, "map YAML file to write, a folder for several floors", required=True)
    add("--resolution-m", 0.05, "edge of a cell [m] (default: %(default)s)")
    add("--scan-topic", str, "topic of the scans, where an MCAP file has several")
    add("--odometry-topic", str, "topic of the odometry, where an MCAP file has several")
    add_worker_arguments(add)


def run(args: Namespace) -> dict[str, Any]:
    """Read, map, write; returns what is printed."""
    from functools import partial

    import numpy as np

    workers = chosen_workers(args)
    paths = [Path(name) for name in args.scans]
    targets = (
        [Path(args.out)] if len(paths) == 1 else [Path(args.out) / f"{path.stem}.yaml" for path in paths]
    )
    if len(set(targets)) < len(targets):
        raise core.InputError("scans", "found two files with the same name, expected one name for each floor")
    build = partial(mapping.build_map, settings=mapping.MapperSettings(resolution_m=args.resolution_m))
    floors = [
        io.read_scans(path, scan_topic=args.scan_topic, odometry_topic=args.odometry_topic) for path in paths
    ]
    if len(paths) > 1:
        Path(args.out).mkdir(parents=True, exist_ok=True)
    built: list[dict[str, Any]] = [{}] * len(paths)
    with args.progress(len(paths), "floors") as bar:
        for number, mapper in core.map_tasks(build, floors, name="map build", workers=workers):
            grid = mapper.map()
            grid.save(targets[number])
            bar.advance(text=targets[number].name)
            built[number] = {
                "map": str(targets[number]),
                "rows": grid.shape[0],
                "columns": grid.shape[1],
                "resolution_m": grid.resolution_m,
                "origin": list(grid.origin),
                "scans": len(mapper.matches),
                "refused": sum(not match.valid for match in mapper.matches),
                "path_length_m": float(np.hypot(*np.diff(mapper.trajectory[:, :2], axis=0).T).sum()),
                "inliers_median": float(np.median([match.inliers for match in mapper.matches])),
                "end_pose": list(mapper.pose),
            }
    return built[0] if len(built) == 1 else {"floors": built}
