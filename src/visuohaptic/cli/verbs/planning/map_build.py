"""``visuohaptic map build``: a map from laser scans and odometry."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import Any

__all__ = ["EPILOG", "add_arguments", "run"]

EPILOG = """\
Reads an MCAP file with sensor_msgs/LaserScan and nav_msgs/Odometry, or a CSV
file (t_s, x_m, y_m, yaw_rad, angle_min_rad, angle_step_rad, range_min_m,
range_max_m, r0, r1, ...); writes a map_server YAML file with its PGM image.
Every scan is laid on the map so far; scans that do not fit are left out and counted.

Example: visuohaptic map build run.mcap --out map.yaml
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("scans", help="MCAP or CSV file")
    parser.add_argument("--out", required=True, help="map YAML file to write")
    parser.add_argument(
        "--resolution-m", type=float, default=0.05, help="edge of a cell [m] (default: %(default)s)"
    )
    parser.add_argument("--scan-topic", help="topic of the scans, where an MCAP file has several")
    parser.add_argument("--odometry-topic", help="topic of the odometry, where an MCAP file has several")


def run(args: Namespace) -> dict[str, Any]:
    """Read, map, write; returns what is printed."""
    import numpy as np

    from ....io.laser_scans import read_scans
    from ....navigation.mapping.mapper import MapperSettings, OccupancyMapper

    scans = read_scans(args.scans, scan_topic=args.scan_topic, odometry_topic=args.odometry_topic)
    mapper = OccupancyMapper(MapperSettings(resolution_m=args.resolution_m))
    for scan, odometry in scans:
        mapper.add(scan, odometry)
    grid = mapper.map()
    grid.save(args.out)
    way = mapper.trajectory[:, :2]
    matched = [match for match in mapper.matches if match.valid]
    return {
        "map": str(args.out),
        "rows": grid.shape[0],
        "columns": grid.shape[1],
        "resolution_m": grid.resolution_m,
        "origin": list(grid.origin),
        "scans": len(scans),
        "refused": len(scans) - len(matched),
        "way_m": float(np.hypot(*np.diff(way, axis=0).T).sum()),
        "inliers_median": float(np.median([match.inliers for match in mapper.matches])),
        "end_pose": list(mapper.pose),
    }
