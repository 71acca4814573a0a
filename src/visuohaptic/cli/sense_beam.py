"""``visuohaptic sense beam``: from template poses to six axes of force and moment."""

from __future__ import annotations

import argparse
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ..sensing.beam import BeamSensor, TemplatePose

__all__ = ["EPILOG", "HELP", "add_arguments", "run"]

HELP = "read force and moment, six axes, from templates on a bending rod"

EPILOG = """\
reads
  --config   sensor.yaml with kind: beam (beam, templates, frame of the sensor)
  --poses    poses.csv: t_s, name, valid, reason, x_m, y_m, z_m, qx, qy, qz, qw and the covariance of
             each template in the camera, rows of a frame together
writes
  --out      run.mcap with geometry_msgs/WrenchStamped and diagnostics
  --csv      t_s, valid, reason, fx_N, fy_N, fz_N, mx_Nm, my_Nm, mz_Nm and their sigmas, a row a frame
  --parquet  the same
  --zero     the resting poses that sensor.yaml names, from frames of a sensor that nothing touches

examples
  visuohaptic sense beam --config sensor.yaml --poses rest.csv --zero
  visuohaptic sense beam --config sensor.yaml --poses push.csv --out run.mcap --csv run.csv
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("--config", required=True, type=Path, help="sensor.yaml")
    parser.add_argument("--poses", required=True, type=Path, help="poses of the templates, CSV")
    parser.add_argument("--out", type=Path, help="MCAP recording to write")
    parser.add_argument("--csv", type=Path, help="table to write")
    parser.add_argument("--parquet", type=Path, help="table to write")
    parser.add_argument("--zero", action="store_true", help="take and store the zero, then stop")
    parser.add_argument(
        "--zero-frames",
        type=int,
        default=0,
        metavar="N",
        help="zero on the first N frames, then measure (nothing is stored)",
    )


def run(args: Any) -> dict[str, Any]:
    """Do it; the mapping is what ``--json`` prints."""
    from ..sensing.beam import BeamSensor, BeamSensorConfig, BeamZero, read_template_poses

    if args.zero_frames < 0:
        raise InputError("--zero-frames", f"found {args.zero_frames}, expected 0 or more")
    setup = BeamSensorConfig.load(args.config)
    sensor = BeamSensor(setup)
    assert setup.zero_path is not None
    frames = read_template_poses(args.poses)
    if args.zero:
        return _zero(args, sensor, setup.zero_path, frames)
    if args.zero_frames:
        sensor.zero(frame for _, frame in zip(range(args.zero_frames), frames, strict=False))
    elif setup.zero_path.is_file():
        sensor = BeamSensor(setup, BeamZero.load(setup.zero_path, list(setup.xi)))
    else:
        raise InputError(
            setup.zero_path,
            "there is no zero reference",
            remedy="take one first (visuohaptic sense beam ... --zero) or give --zero-frames N",
        )
    return _measure(args, sensor, frames)


def _zero(
    args: Any, sensor: BeamSensor, path: Path, frames: Iterator[tuple[float, list[TemplatePose]]]
) -> dict[str, Any]:
    zero = sensor.zero(args.progress(frames, "zeroing"))
    zero.save(path)
    args.report(f"zero from {zero.frames} frames of {', '.join(zero.rest.names)} written to {path}")
    return {"zero": str(path), "frames": zero.frames, "templates": list(zero.rest.names)}


def _measure(
    args: Any, sensor: BeamSensor, frames: Iterator[tuple[float, list[TemplatePose]]]
) -> dict[str, Any]:
    import numpy as np

    from ..recording import MeasurementWriter, TableWriter

    reasons: Counter[str] = Counter()
    largest = np.zeros(6)
    sigma = np.full(6, np.nan)
    exact = 0
    with ExitStack() as stack:
        recording = stack.enter_context(MeasurementWriter(args.out)) if args.out else None
        writers = [stack.enter_context(TableWriter(path)) for path in (args.csv, args.parquet) if path]
        for t_s, templates in args.progress(frames, "measuring"):
            reading = sensor.read(t_s, templates)
            wrench = reading.wrench
            reasons[wrench.reason.value] += 1
            exact += reading.exact
            if recording is not None:
                recording.write_wrench(wrench)
            for writer in writers:
                writer.write(wrench)
            if wrench.valid:
                now = np.concatenate([wrench.force_N, wrench.moment_Nm])
                if np.isnan(sigma[0]):
                    sigma = np.sqrt(np.diag(reading.noise))
                largest = np.where(np.abs(now) > np.abs(largest), now, largest)
    count = sum(reasons.values())
    if not count:
        raise InputError(args.poses, "no frames are left to measure", remedy="check --zero-frames")
    args.report(
        f"{count} frames, {reasons.get('ok', 0)} valid, {exact} read by the exact rod"
        + "".join(f", {number} {reason}" for reason, number in reasons.items() if reason != "ok")
    )
    names = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
    for name, value, noise in zip(names, largest, sigma, strict=True):
        args.report(f"{name:6} largest {value:9.4f}, noise of a frame {noise:.5f}")
    return {
        "frames": count,
        "reasons": dict(reasons),
        "exact_frames": exact,
        "largest": dict(zip(names, largest.tolist(), strict=True)),
        "out": [str(path) for path in (args.out, args.csv, args.parquet) if path],
    }
