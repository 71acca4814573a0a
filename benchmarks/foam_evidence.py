"""The foam sensor in an independent simulation: phantom forces, disturbances, force, faults, segments.

python -m benchmarks.foam_evidence shadows --seeds open --count 20 --report shadows.jsonl
                                  prints the figures of one campaign: e.g. valid frames, force errors, errors over sigma
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from tests.worlds import foam
from tests.worlds.foam_disturbances import DISTURBANCES, covered, disturbed, faulty, forces, segments
from tests.worlds.foam_lamps import lamps
from tests.worlds.foam_presses import calibration_plate

from benchmarks._journal import Journal
from benchmarks._seeds import add_seeds, seeds_of
from visuohaptic.core import CalibrationError
from visuohaptic.core.camera import Frame
from visuohaptic.core.measurement import ForceProfile
from visuohaptic.core.objects import PrimitiveKind
from visuohaptic.sensing.foam import FoamSensor
from visuohaptic.sensing.foam.material import (
    PlateRecord,
    calibrate_foam,
    calibrate_tension,
    read_strain_stress,
)
from visuohaptic.sensing.push.primitives import fit_contact

#: A phantom force is beyond 3 sigma and this [N].
PHANTOM_N = 0.05
#: Columns of a frame's row.
COLUMNS = ("valid", "reason", "force_N", "sigma_N", "truth_N", "depth_m", "counted", "disturbed")


def sensor_for(world: foam.World, folder: Path, *, encoding_known: bool = False) -> FoamSensor:
    """A sensor configured and calibrated as its user would, with a narrow plate as well."""
    path = world.write(folder, encoding_known=encoding_known)
    data = read_strain_stress(folder / "strain_stress.csv")
    material = calibrate_foam(data, width_m=world.foam.width_m, height_m=world.foam.height_m).material
    scale = world.foam.mu_Pa[0] / foam.Foam().mu_Pa[0]
    plate = [PlateRecord(p.depth_m, scale * p.force_N, p.y_m, p.delta_m) for p in calibration_plate()]
    replace(material, tension=calibrate_tension(plate, material)).save(folder / "foam.yaml")
    return FoamSensor.load(path)


def run_sequence(sequence: foam.Sequence, *, encoding_known: bool = False) -> dict:
    """Results of the sensor for a sequence: ``frames`` by :data:`COLUMNS`, or the reason of a rejection."""
    row: dict = {"about": sequence.about, "frames": [], "refused": "", "ends": []}
    with tempfile.TemporaryDirectory() as name:
        sensor = sensor_for(sequence.world, Path(name), encoding_known=encoding_known)
        try:
            sensor.zero([Frame(shot.image, shot.t_s, i) for i, shot in enumerate(sequence.zero())])
        except CalibrationError as error:
            # A rejected zero reads no frame.
            row["refused"] = str(error)
            row["frames"] = [[False, "refused", None, None, *_truth(shot)] for shot, _ in sequence.moments]
            return row
        for i, shot in enumerate(sequence.shots(), start=foam.ZERO_FRAMES):
            profile = sensor.read(Frame(shot.image, shot.t_s, i))
            reading = (_number(profile.force_N), _number(profile.force_sigma_N))
            row["frames"].append([bool(profile.valid), str(profile.reason), *reading, *_truth(shot)])
            if sequence.about.get("body") == "box":
                row["ends"] += segment_ends(profile, sequence, shot.depth_m)
    return row


def _truth(shot: foam.Shot) -> list:
    force, depth = round(float(shot.force_N), 5), round(float(shot.depth_m), 6)
    return [force, depth, bool(shot.counted), bool(shot.disturbed)]


def _number(value: float) -> float | None:
    return round(float(value), 5) if np.isfinite(value) else None


def frames_of(rows: list[dict]) -> dict[str, np.ndarray]:
    """All frames of some rows, column by column; invalid forces are NaN, ``seed`` identifies the sequence."""
    frames = [(i, *frame) for i, row in enumerate(rows) for frame in row["frames"]]
    columns = list(zip(*frames, strict=True)) if frames else [()] * (len(COLUMNS) + 1)
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
    """Valid frames, force error and calibration of sigma, by disturbance."""
    out = []
    for kind in DISTURBANCES:
        if mine := [row for row in rows if row["about"]["kind"] == kind]:
            f = frames_of(mine)
            wanted = f["counted"].astype(bool)
            read = _percent(f["valid"][wanted])
            note = f"{len(mine)} presses, {wanted.sum()} frames; {_honesty(f)}; unread: {_reasons(f)}"
            out.append(_row(f"{kind}: frames read", read, "%", note, floor=70, aim=90))
    return out


def force_figures(rows: list[dict]) -> list[dict]:
    """Force error and calibration of sigma, by body and by depth."""
    out = []
    bodies = sorted({row["about"]["body"] for row in rows})
    for body in bodies:
        f = frames_of([row for row in rows if row["about"]["body"] == body])
        error = _relative(f, f["depth_m"] >= 1e-3)
        out.append(_row(f"{body}: worst error from 1 mm on", _worst(error), "%", _honesty(f), floor=2, aim=1))
    f = frames_of(rows)
    for low, high in ((0.3, 1), (1, 2), (2, 3), (3, 5), (5, 7), (7, 10)):
        inside = (f["depth_m"] >= 1e-3 * low) & (f["depth_m"] < 1e-3 * high)
        part = {name: values[inside] for name, values in f.items()}
        error = _worst(_relative(part, np.ones(inside.sum(), bool)))
        out.append(
            _row(
                f"{low:g}-{high:g} mm: rms error / sigma",
                _rms(_z(part)),
                "",
                f"worst {error:.2f} %; {_honesty(part)}",
                floor="0.7-1.3",
                aim="0.85-1.15",
            )
        )
    return out


def fault_figures(rows: list[dict]) -> list[dict]:
    """Wrong frames reported as valid, by the first fault."""
    f = frames_of(rows)
    kind = np.array([rows[i]["about"]["kind"] for i in f["row"].astype(int)])
    error = np.abs(f["force_N"] - f["truth_N"])
    wrong = f["valid"].astype(bool) & (error > 4 * f["sigma_N"] + PHANTOM_N)
    by_kind = ", ".join(f"{k}: {n}" for k, n in zip(*np.unique(kind[wrong], return_counts=True), strict=True))
    worst = float(error[wrong].max(initial=0.0))
    note = (
        f"{len(rows)} presses, {len(kind)} frames, {f['valid'].sum()} valid, worst {worst:.2f} N; {by_kind}"
    )
    return [_row("valid beyond 4 sigma + 0.05 N", wrong.sum(), "frames", note, floor=0, aim=0)]


def cover_figures(rows: list[dict]) -> list[dict]:
    """Wrong frames with occluders along the whole front, and frames read of plates that press there."""
    plates = frames_of([row for row in rows if row["about"]["kind"] == "plate"])
    read = _percent(plates["valid"][plates["counted"].astype(bool)]) if len(plates["valid"]) else float("nan")
    note = _honesty(plates) if len(plates["valid"]) else "none"
    return [
        *fault_figures(rows),
        _row("plates along the whole front: frames read", read, "%", note, floor=70, aim=90),
    ]


def segment_figures(rows: list[dict]) -> list[dict]:
    """Ends of sharp-edged plates, from 2 mm on."""
    ends = np.array([end for row in rows for end in row["ends"]]).reshape(-1, 3)
    frames = sum(frame[5] >= 2e-3 for row in rows for frame in row["frames"])
    error, sigma = 1e3 * ends[:, 1], 1e3 * ends[:, 2]
    median, worst = (
        float(np.quantile(np.abs(error), q)) if len(error) else float("nan") for q in (0.5, 0.95)
    )
    note = f"median {median:.2f}, mean {np.mean(error):+.2f} (outwards positive), sigma median {np.median(sigma):.2f} mm, "
    note += f"rms error/sigma {_rms(error / sigma):.2f}; {len(ends)} ends of {2 * frames}"
    return [_row("segment ends: 95 % of errors within", worst, "mm", note, floor=1.0, aim=0.3)]


def segment_ends(profile: ForceProfile, sequence: foam.Sequence, depth_m: float) -> list[list[float]]:
    """Depth, error outwards and declared sigma [m] of both ends of the plate, if a segment is seen."""
    contact, about = profile.max_contact, sequence.about
    if not profile.valid or contact is None or depth_m < 2e-3:
        return []
    best = fit_contact(contact).best
    if best is None or best.kind != PrimitiveKind.SEGMENT:
        return []
    y, sigma = best.parameters[[1, 3]], np.sqrt(np.diag(best.covariance)[[1, 3]])
    order = np.argsort(y)
    error = (y[order] - [about["y_m"] - about["half_m"], about["y_m"] + about["half_m"]]) * [-1, 1]
    return [[depth_m, float(e), float(s)] for e, s in zip(error, sigma[order], strict=True)]


def _z(f: dict[str, np.ndarray]) -> np.ndarray:
    """Errors in declared sigmas, of valid frames of interest."""
    read = f["counted"].astype(bool) & f["valid"].astype(bool)
    return ((f["force_N"] - f["truth_N"]) / f["sigma_N"])[read]


def _relative(f: dict[str, np.ndarray], where: np.ndarray) -> np.ndarray:
    """Relative errors of the force of valid frames."""
    read = where & f["counted"].astype(bool) & f["valid"].astype(bool)
    return np.abs(f["force_N"][read] / f["truth_N"][read] - 1)


def _worst(error: np.ndarray) -> float:
    return 100 * float(error.max()) if len(error) else float("nan")


def _honesty(f: dict[str, np.ndarray]) -> str:
    """Errors of the force from 1 mm on and how they compare with their sigmas."""
    error, z = _relative(f, f["depth_m"] >= 1e-3), _z(f)
    wanted = f["counted"].astype(bool)
    return (
        f"error median {_quantile(error, 0.5)}, 90 % {_quantile(error, 0.9)}, worst {_quantile(error, 1.0)} %; rms error/sigma "
        f"{_rms(z):.2f}, 90 % interval holds {_percent(np.abs(z) < 1.645):.0f} %, beyond 4 sigma {int((np.abs(z) > 4).sum())}; "
        f"{int(f['valid'][wanted].sum())} of {int(wanted.sum())} read"
    )


def _reasons(f: dict[str, np.ndarray]) -> dict[str, int]:
    unread = f["counted"].astype(bool) & ~f["valid"].astype(bool)
    names, counts = np.unique(f["reason"][unread], return_counts=True)
    return {str(name): int(count) for name, count in zip(names, counts, strict=True)}


def _row(name: str, value: float, unit: str, note: str, **limits: float | str) -> dict:
    return {"name": name, "ours": float(value), "unit": unit, "note": note, **limits}


def _percent(flags: np.ndarray) -> float:
    return 100.0 * float(np.mean(flags)) if len(flags) else float("nan")


def _rms(values: np.ndarray) -> float:
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _quantile(values: np.ndarray, q: float) -> str:
    values = values[np.isfinite(values)]
    return f"{100 * np.quantile(values, q):.2f}" if len(values) else "-"


def _each(make: Callable[[int], foam.Sequence]) -> Callable:
    return lambda seeds: [(str(s), lambda s=s: make(s)) for s in seeds]


def _each_disturbance(seeds: list[int]) -> list[tuple[str, Callable[[], foam.Sequence]]]:
    return [(f"{kind}:{s}", lambda k=kind, s=s: disturbed(k, s)) for s in seeds for kind in DISTURBANCES]


#: By name: keys with makers of sequences, and figures of the rows.
CAMPAIGNS: dict[str, tuple[Callable, Callable]] = {
    "shadows": (_each(foam.shadows), shadow_figures),
    "pincers": (_each(foam.pincers), shadow_figures),
    "lamps": (_each(lamps), shadow_figures),
    "disturbances": (_each_disturbance, disturbance_figures),
    "force": (_each(forces), force_figures),
    "faults": (_each(faulty), fault_figures),
    "covers": (_each(covered), cover_figures),
    "segments": (_each(segments), segment_figures),
}


def campaign(
    name: str,
    *,
    seeds: str = "open",
    first: int = 0,
    count: int = 20,
    only: str = "",
    encoding_known: bool = False,
    report: Path | None = None,
    on_row: Callable[[str, dict], None] | None = None,
) -> list[dict]:
    """Rows of ``count`` seeds from the one numbered ``first`` whose keys begin with ``only``; those in ``report`` are not run again."""
    make, _ = CAMPAIGNS[name]
    header = {"campaign": f"foam_evidence {name}", "seeds": seeds, "encoding_known": encoding_known}
    journal = Journal(report, header)
    rows = []
    for key, sequence in make(seeds_of(seeds, count, first)):
        if not key.startswith(only):
            continue
        if key not in journal:
            journal.put(key, run_sequence(sequence(), encoding_known=encoding_known))
            if on_row is not None:
                on_row(key, journal.rows[key])
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
    add_seeds(parser, 20)
    parser.add_argument(
        "--only", default="", help="what a key begins with, such as 'hand' of the disturbances"
    )
    parser.add_argument(
        "--encoding-known", action="store_true", help="camera.yaml says whether grey levels are encoded"
    )
    parser.add_argument("--report", type=Path, help="JSON lines; a stopped campaign goes on where it was")
    args = parser.parse_args()
    options = vars(args)
    name = options.pop("campaign")
    for line in CAMPAIGNS[name][1](campaign(name, **options, on_row=_print_row)):
        print(f"{line['name']}: {line['ours']:.3g} {line['unit']}  ({line['note']})")


def _print_row(key: str, row: dict) -> None:
    """One line for each sequence as it is done."""
    f = frames_of([row])
    valid = f["valid"].astype(bool)
    worst = float(np.abs(f["force_N"] - f["truth_N"])[valid].max(initial=0.0))
    about = {k: round(v, 3) if isinstance(v, float) else v for k, v in row["about"].items()}
    print(
        f"{key}: read {valid.sum()}/{len(valid)}, worst error {worst:.2f} N {row['refused']} {about}",
        flush=True,
    )


if __name__ == "__main__":
    main()
