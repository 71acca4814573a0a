"""Typical mistakes of new users, each made with the command line; ``python -m benchmarks.first_hour misuses`` prints them."""

from __future__ import annotations

import contextlib
import csv
import io
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np
import yaml

from visuohaptic.cli.main import main
from visuohaptic.core.camera import Camera
from visuohaptic.io.maps import OccupancyMap

__all__ = ["MISUSES", "Misuse", "Response", "add_files", "respond"]

ROBOT = "{radius_m: 0.17, v_max_m_s: 0.3, v_min_m_s: 0.05, v_push_m_s: 0.05, push_force_max_N: 20.0, setup_time_s: 4.0}\n"
OBJECTS = (
    "objects:\n  - id: box\n    footprint_m: [[1.25, 1.05], [1.65, 1.05], [1.65, 1.45], [1.25, 1.45]]\n"
    "    haptic_tag: {static_friction_N: {value: 50.0, sigma: 0.6}, explored: 1}\n"
)
CALIBRATE = "calibrate foam strain_stress.csv --width 0.02 --height 0.01 --out foam.yaml"
ZERO = "sense foam --config sensor.yaml --source rest.mp4 --zero"
PUSH = "sense foam --config sensor.yaml --source push.mp4"


def edit(name: str, change: Callable[[dict], object]) -> Callable[[], None]:
    """Change a YAML file."""

    def make() -> None:
        data = yaml.safe_load(Path(name).read_text())
        change(data)
        Path(name).write_text(yaml.safe_dump(data))

    return make


def scaled(column: int, factor: float, head: str) -> Callable[[], None]:
    """The press log with a column in another unit."""

    def make() -> None:
        rows = [line.split(",") for line in Path("strain_stress.csv").read_text().splitlines()]
        for row in rows[1:]:
            row[column] = f"{factor * float(row[column]):.6g}"
        Path("strain_stress.csv").write_text("\n".join([head, *(",".join(row) for row in rows[1:])]) + "\n")

    return make


def another_batch() -> None:
    """A sensor whose foam was calibrated with a press of another batch, stiffer by a quarter."""
    scaled(1, 1.25, "strain,stress_Pa,direction")()
    assert main(CALIBRATE.split()) == main(ZERO.split()) == 0


def darkened() -> None:
    """A recording of a camera whose lens is covered."""
    from visuohaptic.io import open_source
    from visuohaptic.rigs import write_video

    with open_source("push.mp4") as source:
        write_video(
            Path("dark.mp4"), [np.zeros(frame.image.shape[:2], np.uint8) for frame in islice(source, 3)]
        )


def turned(data: dict) -> None:
    """x and y of the strip's frame exchanged: a quarter turn about z."""
    from scipy.spatial.transform import Rotation

    pose = data["T_camera_foam"]
    turn = Rotation.from_quat(pose["quaternion_xyzw"]) * Rotation.from_euler("z", 90, degrees=True)
    pose["quaternion_xyzw"] = turn.as_quat().tolist()


@dataclass(frozen=True)
class Misuse:
    """What is done, and what must be said; ``first`` are commands that succeed before."""

    command: str
    says: tuple[str, ...]
    make: Callable[[], object] = lambda: None
    first: tuple[str, ...] = field(default=(CALIBRATE,))
    code: int = 2


MISUSES = {
    "no size": Misuse("calibrate foam strain_stress.csv --out f.yaml", ("--width", "--height", "required"), first=()),
    "wrong size": Misuse(
        ZERO, ("mm wide, expected 40.0 mm", "calibrate the foam again"),
        first=(CALIBRATE.replace("0.02", "0.04"),),
    ),
    "size in millimetres": Misuse(CALIBRATE.replace("0.02", "20"), ("--width", "expected 0.001 to 1 m", "20 mm is 0.02"), first=()),
    "strain in per cent": Misuse(
        CALIBRATE, ("strain_percent",), scaled(0, 100, "strain,stress_Pa,direction"), ()
    ),
    "stress in kilopascals": Misuse(CALIBRATE, ("kPa",), scaled(1, 1e-3, "strain,stress_Pa,direction"), ()),
    "swapped axes": Misuse(ZERO, ("T_camera_foam",), edit("sensor.yaml", turned)),
    "length in millimetres": Misuse(
        ZERO, ("250.0 m",), edit("sensor.yaml", lambda d: d["strip"].update(length_m=250.0))
    ),
    "wrong camera file": Misuse(
        ZERO, ("1600 x 896", "640 x 480"), lambda: Camera.simple(640, 480, 600.0).save("camera.yaml")
    ),
    "foam of another strip": Misuse(
        "start --source rest.mp4 --length 250 --width 40 --height 50 --foam foam.yaml --out mine",
        ("foam 20 mm, expected 40 mm", "known loads"), lambda: shutil.copy("tagged.mp4", "rest.mp4"),
    ),
    "foam of another batch": Misuse(
        PUSH + " --against scale.csv", ("by a factor of 1.2", "calibrate again (foam of another batch"), another_batch,
        first=(), code=0,
    ),
    "zero while something touches": Misuse(PUSH + " --zero", ("moved", "nothing touches"),),
    "no zero": Misuse(PUSH, ("there is no zero reference", "--zero")),
    "field misspelt": Misuse(
        ZERO, ("strip.length", "did you mean length_m?"),
        edit("sensor.yaml", lambda d: d["strip"].update(length=d["strip"].pop("length_m"))),
    ),
    "text for a number": Misuse(
        ZERO, ("strip.length_m", "found 'long', expected a number"),
        edit("sensor.yaml", lambda d: d["strip"].update(length_m="long")),
    ),
    "recorded demo of a house": Misuse(
        "demo --quick --world 4", ("--quick: found with --world", "recorded mission"), first=()
    ),
    "verb misspelt": Misuse("sens foam", ("did you mean 'sense foam'?",), first=()),
    "flag misspelt": Misuse(PUSH + " --zero-frame 3", ("did you mean --zero-frames?",), first=()),
    "flag misspelt that must be": Misuse("sense foam --confg sensor.yaml --source push.mp4", ("did you mean --config?",), first=()),
    "file misspelt": Misuse("sense foam --config senor.yaml --source push.mp4", ("did you mean sensor.yaml?",), first=()),
    "source misspelt": Misuse("sense foam --config sensor.yaml --source psh.mp4", ("did you mean push.mp4?",)),
    "a foam for a sensor": Misuse("sense foam --config foam.yaml --source push.mp4", ("visuohaptic-foam", "a file of another kind")),
    "a video for a map": Misuse("map inspect push.mp4", ("is not UTF-8 text",), first=()),
    "the folder above a sequence": Misuse(
        "reconstruct views --out model", ("has no sequence.yaml", "did you mean views/scan?"),
        lambda: (Path("views/scan").mkdir(parents=True), Path("views/scan/sequence.yaml").touch()), first=(),
    ),
    "no such camera": Misuse("sense foam --config sensor.yaml --source 17", ("no camera camera:17; found:",)),
    "a stream that is not there": Misuse(
        "sense foam --config sensor.yaml --source rtsp://127.0.0.1:9/x", ("does not answer", "address")
    ),
    "a closed map": Misuse(
        "plan rooms.yaml --robot robot.yaml --start 0.6 1.2 --goal 2.6 1.2", ("no plan", "walls separate start and goal"), first=(), code=3
    ),
    "an object that is too heavy": Misuse(
        "plan rooms.yaml --robot robot.yaml --objects objects.yaml --start 0.6 1.2 --goal 2.6 1.2",
        ("box is not pushed: needs 50.0 N, the platform has 20.0 N",), first=(), code=3,
    ),
    "a goal off the map": Misuse(
        "plan rooms.yaml --robot robot.yaml --start 0.6 1.2 --goal 12 1", ("goal",), first=(), code=2
    ),
    "a tag in millimetres": Misuse("template sheet --ids 1 --size-m 40 --out t.pdf", ("does not fit on A4",), first=()),
    "a map's picture for a map": Misuse(
        "plan rooms.pgm --robot robot.yaml --start 1 1 --goal 2 1", ("is an image", "image: rooms.pgm, resolution:"), first=()
    ),
    "an output that is the input": Misuse(
        CALIBRATE.replace("foam.yaml", "strain_stress.csv"), ("--out would overwrite strain_stress.csv, which is read",), first=()
    ),
    "two outputs of one name": Misuse(
        CALIBRATE + " --plot foam.yaml", ("--plot would overwrite foam.yaml, which --out writes",), first=()
    ),
    "a turned map in degrees": Misuse(
        "map inspect rooms.yaml", ("found a yaw of 90, expected -6.28 to 6.28 rad", "1.5708 rad"),
        edit("rooms.yaml", lambda data: data.update(origin=[0.0, 0.0, 90.0])), first=(),
    ),
    "cells of a map in centimetres": Misuse(
        "map inspect rooms.yaml", ("a cell has 5 m, more than a door",),
        edit("rooms.yaml", lambda data: data.update(resolution=5.0)), first=(), code=0,
    ),
    "a dark recording": Misuse(
        "sense foam --config sensor.yaml --source dark.mp4", ("0 valid",),
        darkened, first=(CALIBRATE, ZERO), code=3,
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Response:
    """What the command line did."""

    code: int  #: exit code of the misuse
    said: str  #: what it printed where it belongs: on stderr for a refusal, on stdout otherwise
    faults: tuple[str, ...]  #: why this is neither a refusal nor a report that helps; empty if it is one


def add_files(folder: Path) -> None:
    """Add what the misuses need to the recording of ``example foam``."""
    from tests.cli.test_start import with_tag

    from visuohaptic.rigs.foam_example import write_video
    from visuohaptic.rigs.virtual_sensor import VirtualSensor, rest_scene

    virtual, rng = VirtualSensor(), np.random.default_rng(0)
    rest = virtual.renderer().render(rest_scene(virtual.geometry), rng=rng)
    write_video(folder / "tagged.mp4", [with_tag(rest, virtual) for _ in range(5)])
    cells = np.zeros((50, 60), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    cells[:, 28:30] = 100
    cells[21:29, 25:33] = 100  # a box before what would be a door
    OccupancyMap(cells, 0.05).save(folder / "rooms.yaml")
    (folder / "robot.yaml").write_text(ROBOT)
    (folder / "objects.yaml").write_text(OBJECTS)
    truth = list(csv.DictReader((folder / "truth.csv").open(newline="")))
    lines = [f"{row['t_s']},{float(row['force_N']) / 9.80665e-3:.0f}" for row in truth]
    (folder / "scale.csv").write_text("\n".join(["t_s,mass_g", *lines]) + "\n")


def respond(misuse: Misuse, files: Path, folder: Path) -> Response:
    """Make a misuse with the command line in a new copy of the files."""
    shutil.copytree(files, folder, dirs_exist_ok=True)
    out, err = io.StringIO(), io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        before = [main(command.split()) for command in misuse.first]
        misuse.make()
        for stream in (out, err):
            stream.truncate(stream.seek(0))
        code = main(misuse.command.split())
    said = err.getvalue() if misuse.code == 2 else out.getvalue() + err.getvalue()
    faults = [f"'{command}' fails before" for command, code in zip(misuse.first, before, strict=True) if code]
    faults += [] if code == misuse.code else [f"exit code {code}"]
    faults += [f"'{words}' is not said" for words in misuse.says if words not in said]
    faults += ["a traceback"] if "Traceback" in err.getvalue() else []
    lines = err.getvalue().splitlines()
    if code == 2 and [line for line in lines if line.startswith("visuohaptic: error: ")] != lines[-1:]:
        faults.append("not one error line at the end")
    return Response(code, said, tuple(faults))
