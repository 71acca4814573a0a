"""The foam sensor in a world that shares nothing with it: phantom forces, disturbances, force, faults, segments.

``python -m benchmarks.foam_evidence shadows --seeds open --count 20 --report shadows.jsonl``
"""

from __future__ import annotations

import argparse
import logging
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from tests.worlds import foam

from benchmarks._journal import Journal
from visuohaptic.core import CalibrationError
from visuohaptic.core.camera import Frame
from visuohaptic.sensing.foam import FoamSensor
from visuohaptic.sensing.foam.material import calibrate_foam, read_strain_stress

#: A phantom force is beyond 3 sigma and this [N].
PHANTOM_N = 0.05
#: Columns of a frame's row.
COLUMNS = ("valid", "reason", "force_N", "sigma_N", "truth_N", "depth_m", "counted", "disturbed")

log = logging.getLogger(__name__)


def sensor_for(world: foam.World, folder: Path) -> FoamSensor:
    """A sensor configured and calibrated as its user would."""
    path = world.write(folder)
    data = read_strain_stress(folder / "strain_stress.csv")
    material = calibrate_foam(data, width_m=world.foam.width_m, height_m=world.foam.height_m).material
    material.save(folder / "foam.yaml")
    return FoamSensor.load(path)


def run_sequence(sequence: foam.Sequence) -> dict:
    """What the sensor makes of a sequence: ``frames`` by :data:`COLUMNS`, or why it refused."""
    row: dict = {"about": sequence.about, "frames": [], "refused": ""}
    with tempfile.TemporaryDirectory() as name:
        sensor = sensor_for(sequence.world, Path(name))
        try:
            sensor.zero([Frame(shot.image, shot.t_s, i) for i, shot in enumerate(sequence.zero())])
        except CalibrationError as error:
            # A zero that is refused reads no frame.
            row["refused"] = str(error)
            row["frames"] = [[False, "refused", None, None, *_truth(shot)] for shot, _ in sequence.moments]
            return row
        for i, shot in enumerate(sequence.shots(), start=foam.ZERO_FRAMES):
            profile = sensor.read(Frame(shot.image, shot.t_s, i))
            reading = (_number(profile.force_N), _number(profile.force_sigma_N))
            row["frames"].append([bool(profile.valid), str(profile.reason), *reading, *_truth(shot)])
    return row


def _truth(shot: foam.Shot) -> list:
    force, depth = round(float(shot.force_N), 5), round(float(shot.depth_m), 6)
    return [force, depth, bool(shot.counted), bool(shot.disturbed)]


def _number(value: float) -> float | None:
    return round(float(value), 5) if np.isfinite(value) else None


def frames_of(rows: list[dict]) -> dict[str, np.ndarray]:
    """All frames of some rows, column by column; unread forces are NaN, ``seed`` says whose it is."""
    frames = [(i, *frame) for i, row in enumerate(rows) for frame in row["frames"]]
    columns = list(zip(*frames, strict=True)) if frames else [[]] * (len(COLUMNS) + 1)
    found = {name: np.array(values) for name, values in zip(("row", *COLUMNS), columns, strict=True)}
    for name in ("force_N", "sigma_N"):
        found[name] = found[name].astype(float)
    return found


# -- campaigns --------------------------------------------------------------------------------------------


def shadow_figures(rows: list[dict]) -> list[dict]:
    """Phantom forces: nothing touches the strip."""
    f = frames_of(rows)
    valid = f["valid"].astype(bool)
    phantom = valid & (f["force_N"] > 3 * f["sigma_N"] + PHANTOM_N)
    worst = float(f["force_N"][valid].max(initial=0.0))
    refused = sum(bool(row["refused"]) for row in rows)
    note = f"{len(rows)} sequences, {refused} refused at zero"
    return [
        _row("phantom force: worst valid force", worst, "N", note),
        _row(
            "valid frames above 3 sigma + 0.05 N", phantom.sum(), "frames", f"of {len(valid)}", floor=0, aim=0
        ),
        _row("sequences with such a frame", len(set(f["row"][phantom])), "sequences", ""),
        _row("frames read under shadows", _percent(valid), "%", ""),
        _row("rms force / declared sigma where read", _rms((f["force_N"] / f["sigma_N"])[valid]), "", ""),
    ]


def disturbance_figures(rows: list[dict]) -> list[dict]:
    """Frames read, force error and honesty of sigma, by disturbance."""
    out = []
    for kind in foam.DISTURBANCES:
        mine = [row for row in rows if row["about"]["kind"] == kind]
        if not mine:
            continue
        f = frames_of(mine)
        wanted = f["counted"].astype(bool)
        read = wanted & f["valid"].astype(bool)
        error = (f["force_N"] - f["truth_N"])[read]
        deep = read & (f["depth_m"] >= 1e-3)
        relative = (f["force_N"] / np.where(f["truth_N"] > 0, f["truth_N"], np.nan) - 1)[deep]
        z = error / f["sigma_N"][read]
        why = {
            str(r): int(n)
            for r, n in zip(*np.unique(f["reason"][wanted & ~read], return_counts=True), strict=True)
        }
        out.append(
            _row(
                f"{kind}: frames read",
                _percent(f["valid"][wanted]),
                "%",
                f"{len(mine)} presses, {wanted.sum()} frames; from 1 mm error median {_quantile(np.abs(relative), 0.5)}, "
                f"90 % {_quantile(np.abs(relative), 0.9)}, worst {_quantile(np.abs(relative), 1.0)} %; "
                f"rms error/sigma {_rms(z):.2f}, in 90 % interval {_percent(np.abs(z) < 1.645):.0f} %, "
                f"beyond 4 sigma {int((np.abs(z) > 4).sum())}; unread: {why}",
                floor=70,
                aim=90,
            )
        )
    return out


def _row(name: str, value: float, unit: str, note: str, **limits: float) -> dict:
    return {"name": name, "ours": float(value), "unit": unit, "note": note, **limits}


def _percent(flags: np.ndarray) -> float:
    return 100.0 * float(np.mean(flags)) if len(flags) else float("nan")


def _rms(values: np.ndarray) -> float:
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _quantile(values: np.ndarray, q: float) -> str:
    values = values[np.isfinite(values)]
    return f"{100 * np.quantile(values, q):.2f}" if len(values) else "-"


def _disturbance_keys(seeds: list[int]) -> list[tuple[str, Callable[[], foam.Sequence]]]:
    return [
        (f"{kind}:{s}", lambda k=kind, s=s: foam.disturbed(k, s)) for s in seeds for kind in foam.DISTURBANCES
    ]


#: By name: keys with makers of sequences, and figures of the rows.
CAMPAIGNS: dict[str, tuple[Callable, Callable]] = {
    "shadows": (lambda seeds: [(str(s), lambda s=s: foam.shadows(s)) for s in seeds], shadow_figures),
    "disturbances": (_disturbance_keys, disturbance_figures),
}


def campaign(
    name: str, *, seeds: str = "open", count: int = 20, report: Path | None = None, say=None
) -> list[dict]:
    """Rows of one campaign; those in ``report`` are not run again."""
    make, _ = CAMPAIGNS[name]
    journal = Journal(report, {"campaign": f"foam_evidence {name}", "seeds": seeds})
    rows = []
    for key, sequence in make([2 * i + (seeds == "closed") for i in range(count)]):
        if key not in journal:
            journal.put(key, run_sequence(sequence()))
            if say is not None:
                say(key, journal.rows[key])
        rows.append(journal.rows[key])
    return rows


def run() -> list[dict]:
    """Rows of the table: closed seeds."""
    return [
        row for name, (_, figures) in CAMPAIGNS.items() for row in figures(campaign(name, seeds="closed"))
    ]


def main() -> None:
    """Run one campaign and print its figures."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.foam_evidence", description=__doc__)
    parser.add_argument("campaign", choices=list(CAMPAIGNS))
    parser.add_argument("--seeds", choices=("open", "closed"), default="open")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--report", type=Path, help="JSON lines; a stopped campaign goes on where it was")
    args = parser.parse_args()

    def say(key: str, row: dict) -> None:
        f = frames_of([row])
        valid = f["valid"].astype(bool) if row["frames"] else np.zeros(0, bool)
        worst = float(np.max(np.abs(f["force_N"] - f["truth_N"])[valid], initial=0.0)) if len(valid) else 0.0
        about = {k: round(v, 3) if isinstance(v, float) else v for k, v in row["about"].items()}
        print(
            f"{key}: read {valid.sum()}/{len(valid)}, worst error {worst:.2f} N {row['refused']} {about}",
            flush=True,
        )

    rows = campaign(args.campaign, seeds=args.seeds, count=args.count, report=args.report, say=say)
    for line in CAMPAIGNS[args.campaign][1](rows):
        print(f"{line['name']}: {line['ours']:.3g} {line['unit']}  ({line['note']})")


if __name__ == "__main__":
    main()
