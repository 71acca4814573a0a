"""``visuohaptic start``: set up a foam sensor step by step; every file is written for you.

Asks for what is not given: the camera, the size of the strip, and known loads from a kitchen scale.

reads
  --source   a camera (0, /dev/video0, rtsp://..., realsense:, orbbec:), or a recording of the same steps
writes, into --out
  tag.pdf        to print: the tag that shows the camera where the strip is
  camera.yaml, sensor.yaml, foam.yaml, zero.yaml   the sensor; used later by: visuohaptic sense foam --config sensor.yaml
steps
  1  lay the tag on the strip: gives the pose of the strip
  2  remove the tag: gives the zero reference, and checks the declared width
  3  press the strip against a kitchen scale: gives the stiffness of the foam
  4  measure until Ctrl-C

example
  visuohaptic start --source 0 --length 250 --width 40 --height 50 --out bumper
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
from collections import deque
from collections.abc import Iterator
from itertools import islice
from math import nan
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from .... import core, io, sensing, tracking
from ....core import files
from ....core.errors import CalibrationError, DeviceError, InputError
from ....sensing import foam
from ....tracking import templates
from ..._sensor_run import force_outputs, is_live, run_sensor

TAG_ID = 7
#: Frames of each step: of the tag, of the zero reference, and of a load that is held still.
TAG_FRAMES, ZERO_FRAMES, HOLD_FRAMES = 5, 20, 8
#: A load is held still when the force within its frames stays within this fraction: half of what creep may do.
_STILL = 0.03
#: No hand presses harder [g].
_HEAVIEST_g = 1e5
#: Minimum relative difference of a new load from the previous ones: nearer loads are uninformative.
_NEW_LOAD = 0.2


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("--source", str, "camera or recording (default: the connected camera, or a question)")
    add("--camera", Path, "camera.yaml of `calibrate camera` (default: a typical webcam)")
    for name, text in (
        ("length", "of the back contour, along the robot"),
        ("width", "w, thickness of the foam in the direction of pushing"),
        ("height", "h, extent of the foam across, which the camera cannot see"),
    ):
        add(f"--{name}", float, f"{text} [mm]", metavar="MM")
    add("--foam", Path, "foam.yaml of the same foam; replaces the known loads")
    add("--tag", 30.0, "side of the printed tag [mm] (30)", metavar="MM")
    add("--out", Path("sensor"), "folder to write to (sensor)")
    add("--csv", Path, "CSV table of the forces to write")
    add(
        "--view",
        str,
        "show the force in the browser (default: if viser is installed)",
        action=argparse.BooleanOptionalAction,
    )


def run(args: Any) -> dict[str, Any]:
    """Run the verb; returns the mapping that ``--json`` prints."""
    folder: Path = args.out
    args.source = args.source or _choose_camera(args)
    size_m = {name: 1e-3 * _size_mm(args, name) for name in ("length", "width", "height")}
    material = _given_foam(args.foam, size_m)
    with io.open_source(args.source) as source:
        frames = iter(source)
        folder.mkdir(parents=True, exist_ok=True)
        _print_tag(args, folder / "tag.pdf")
        config = folder / "sensor.yaml"
        # Until all steps are done, an earlier sensor in the folder remains as it is.
        with TemporaryDirectory(dir=folder, prefix=".unfinished-") as unfinished:
            measured_mm, loads = _set_up(args, source, frames, Path(unfinished), material, size_m)
            _keep(Path(unfinished), folder)
        sensor = foam.FoamSensor.load(config)
        args.report(
            f"4/4  {'Press the strip' if is_live(args.source) else 'The rest of the recording'}; stop with Ctrl-C"
        )
        done, max_N = _measure(args, sensing.FoamReader(sensor), frames)
    args.report(
        f"the sensor is in {folder}; to use it again: visuohaptic sense foam --config {config} --source {args.source}"
    )
    return {
        "config": str(config),
        "width_m": size_m["width"],
        "measured_width_m": 1e-3 * measured_mm,
        "loads": loads,
        "frames": done.frames,
        "reasons": dict(done.reasons),
        "max_force_N": max_N,
    }


def _set_up(
    args: Any,
    source: core.FrameSource,
    frames: Iterator[core.Frame],
    folder: Path,
    material: foam.FoamMaterial,
    size_m: dict[str, float],
) -> tuple[float, int]:
    """Steps 1 to 3 into an empty folder: the measured width of the strip [mm], and the number of known loads."""
    _step(
        args,
        "1/4  Lay the tag flat on the middle of the strip, the lower edge of its black border on the back edge.",
    )
    seen = _take(frames, TAG_FRAMES, args.source)
    camera = _camera(args, source, seen[0])
    pose = _pose_of_foam(seen, camera, 1e-3 * args.tag)
    config = _write_sensor(folder, camera, size_m["length"], pose)
    material.save(folder / "foam.yaml")
    _step(args, "2/4  Remove the tag. Nothing may touch the strip.")
    sensor, zero = _zeroed(config, _take(frames, ZERO_FRAMES, args.source))
    measured_mm = 1e3 * float(zero.width_m.mean())
    args.report(f"     measured width of the strip: {measured_mm:.1f} mm, given: {args.width:g} mm")
    if args.foam:
        return measured_mm, 0
    loads = _known_loads(args, sensor, frames)
    _fit(args, loads, size_m).save(folder / "foam.yaml")
    return measured_mm, len(loads)


def _keep(made: Path, folder: Path) -> None:
    """Move a complete sensor into its folder; at no moment does a sensor.yaml stand beside files of another one."""
    (folder / "sensor.yaml").unlink(missing_ok=True)
    for path in sorted(made.iterdir(), key=lambda path: path.name == "sensor.yaml"):
        path.replace(folder / path.name)


def _measure(args: Any, reader: Any, frames: Iterator[core.Frame]) -> tuple[Any, float]:
    """Forces in the terminal and on the page until the source ends."""
    if args.view is None:
        args.view = sys.stdout.isatty() and importlib.util.find_spec("viser") is not None
    args.out = None  # no recording
    forces = [0.0]
    outputs = force_outputs()
    done = run_sensor(
        args, reader, frames, outputs, lambda reading: forces.append(reading.measured.force_N), live=True
    )
    return done, max(force for force in forces if force == force)


def _ask(args: Any, question: str, flag: str) -> str:
    """One answer of the user; without one the error names the flag that replaces it."""
    sys.stderr.write(f"     {question}: ")
    sys.stderr.flush()
    answer = sys.stdin.readline()
    if not sys.stdin.isatty():
        sys.stderr.write(answer or "\n")  # as a terminal shows it
    if not answer:
        raise InputError(flag or "stdin", "no answer was given", remedy=f"give {flag}" if flag else "")
    return answer.strip()


def _step(args: Any, text: str) -> None:
    args.report(text)
    if is_live(args.source):
        _ask(args, "then press Enter", "")


def _choose_camera(args: Any) -> str:
    found = io.find_cameras()
    if not found:
        raise DeviceError("no camera found; connect one, or give --source a file or the address of a stream")
    for camera in found:
        args.report(f"     {camera.address:<24}{camera.name}")
    return found[0].address if len(found) == 1 else _ask(args, "which camera", "--source")


def _size_mm(args: Any, name: str) -> float:
    value = getattr(args, name)
    if value is None:
        words = {"length": "length along the robot", "width": "thickness in the direction of pushing"}
        text = _ask(args, f"{words.get(name, 'height across')} of the strip [mm]", f"--{name}")
        try:
            value = float(text)
        except ValueError:
            raise InputError(f"--{name}", f"found {text!r}, expected a number of millimetres") from None
    if not 2.0 <= value <= 1000.0:
        raise InputError(
            f"--{name}", f"found {value:g} mm, expected 2 to 1000 mm", remedy="sizes are given in millimetres"
        )
    setattr(args, name, value)
    return float(value)


def _print_tag(args: Any, path: Path) -> None:
    templates.save_sheet(path, [templates.tag_item(TAG_ID, 1e-3 * args.tag)])
    args.report(f"print {path} at 100 %, check the bar on it with a ruler, and cut the tag out")


def _take(frames: Iterator[core.Frame], count: int, source: str) -> list[core.Frame]:
    taken = list(islice(frames, count))
    if len(taken) < count:
        raise InputError(source, f"ended after {len(taken)} of {count} frames of this step")
    return taken


def _camera(args: Any, source: core.FrameSource, frame: core.Frame) -> core.Camera:
    """The calibrated camera, its maker's model, or a webcam as most are: 53 degrees wide, without distortion."""
    if args.camera is not None:
        return core.Camera.load(args.camera)
    if source.camera is not None:
        return source.camera
    rows, columns = frame.image.shape[:2]
    args.report(
        "     no --camera: a field of view of 53 degrees is assumed; a calibrated camera improves forces by some "
        "per cent if it views the strip obliquely"
    )
    return core.Camera.simple(columns, rows, focal_px=float(columns))


def _pose_of_foam(frames: list[core.Frame], camera: core.Camera, side_m: float) -> core.Pose:
    """Pose of the strip's frame F in the camera: that of the tag on it, turned and moved to its back edge."""
    import numpy as np

    # The tag's x is to the right and y towards the robot; the strip's x is ahead and y to the left.
    tag_from_foam = core.Pose(
        np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]]), np.array([0.0, side_m / 2, 0.0])
    )
    with tracking.TemplateTracker(
        [tracking.Template.from_tag(TAG_ID, size_m=side_m)], camera, threaded=False
    ) as tracker:
        seen = [pose for frame in frames for pose in tracker.update(frame)]
    if not seen[-1].valid or seen[-1].T_camera_template is None:
        raise CalibrationError(
            "tag",
            f"the tag {TAG_ID} of tag.pdf was not detected ({seen[-1].reason}{seen[-1].detail and ': '}{seen[-1].detail})",
            remedy="place it where the whole tag with its white border is visible, in even light",
        )
    return seen[-1].T_camera_template @ tag_from_foam


def _write_sensor(folder: Path, camera: core.Camera, length_m: float, pose: core.Pose) -> Path:
    camera.save(folder / "camera.yaml")
    files.save_yaml(
        folder / "sensor.yaml",
        {
            "kind": "foam",
            "camera": "camera.yaml",
            "foam": "foam.yaml",
            "strip": {"length_m": length_m},
            "T_camera_foam": pose.fields,
        },
    )
    return folder / "sensor.yaml"


def _zeroed(config: Path, frames: list[core.Frame]) -> tuple[foam.FoamSensor, foam.ZeroReference]:
    """The sensor with its zero reference, whose measured width has to be the declared one."""
    try:
        sensor = foam.FoamSensor.load(config)
        zero = sensor.zero(frames)
    except InputError as error:
        raise CalibrationError(
            "the strip",
            error.problem,
            remedy="measure strip and printed tag with a ruler (--length, --width, --tag), and place the tag again",
        ) from error
    zero.save(sensor.setup.zero_path)
    return sensor, zero


def _given_foam(path: Path | None, size_m: dict[str, float]) -> foam.FoamMaterial:
    from ._known_loads import typical_foam

    if path is None:
        return typical_foam(size_m["width"], size_m["height"])
    material = foam.FoamMaterial.load(path)
    for name in ("width", "height"):
        # Another piece of the same foam may be cut by a ruler's millimetre, not by a tenth.
        if abs(getattr(material, f"{name}_m") - size_m[name]) > 0.1 * size_m[name]:
            raise CalibrationError(
                path,
                f"is of foam {1e3 * getattr(material, f'{name}_m'):g} mm, expected {1e3 * size_m[name]:g} mm",
                field=f"{name}_m",
                remedy="calibrate this strip, or omit --foam and use known loads",
            )
    return material


def _known_loads(args: Any, sensor: foam.FoamSensor, frames: Iterator[core.Frame]) -> list[foam.PlateRecord]:
    """Measurements of the camera under loads read from a scale."""
    import numpy as np

    args.report("3/4  Press the strip against a kitchen scale, hold it still, and type what the scale shows.")
    loads: list[foam.PlateRecord] = []
    held_N: list[float] = []
    while True:
        profile = _held(sensor, frames, held_N)
        if profile is None:
            if not loads:
                raise InputError(args.source, "no load was held still", remedy="hold each load for a second")
            return loads
        enough = " (Enter: enough loads)" if loads else ""
        grams = _asked_g(args, f"load {len(loads) + 1}: the scale shows [g]{enough}", may_end=bool(loads))
        if grams is None:
            return loads
        held_N.append(profile.force_N)
        delta_m = np.where(profile.point_valid, profile.delta_m, 0.0)
        loads.append(foam.PlateRecord(float(delta_m.max()), 9.81e-3 * grams, profile.s_m, delta_m))


def _asked_g(args: Any, question: str, *, may_end: bool) -> float | None:
    """A load typed by the user, who may correct a typing error; ``None``: enough loads."""
    while True:
        answer = _ask(args, question, "")
        if not answer and may_end:
            return None
        try:
            grams = float(answer.replace(",", "."))
        except ValueError:
            grams = nan
        if 0 < grams <= _HEAVIEST_g:
            return grams
        problem = InputError(
            "known load", f"found {answer!r}, expected a number of grams up to {_HEAVIEST_g:g}"
        )
        if not sys.stdin.isatty():  # answers of a script belong to one load each
            raise problem
        args.report(f"     {problem}")


def _held(
    sensor: foam.FoamSensor, frames: Iterator[core.Frame], before_N: list[float]
) -> core.ForceProfile | None:
    """The next load that is new and constant; ``None`` at the end of the frames."""
    recent: deque[float] = deque(maxlen=HOLD_FRAMES)
    for frame in frames:
        profile = sensor.read(frame)
        if not (profile.valid and profile.contacts):
            recent.clear()
            continue
        recent.append(profile.force_N)
        still = len(recent) == HOLD_FRAMES and max(recent) - min(recent) < _STILL * max(recent)
        if still and all(abs(profile.force_N - known) > _NEW_LOAD * known for known in before_N):
            return profile
    return None


def _fit(args: Any, loads: list[foam.PlateRecord], size_m: dict[str, float]) -> foam.FoamMaterial:
    import numpy as np

    from ._known_loads import fit_known_loads

    material = fit_known_loads(loads, size_m["width"], size_m["height"])
    deepest = np.array([max(load.delta_m.max() for load in loads) / material.width_m])
    sigma = float(material.stress_sigma(deepest)[0] / material.stress(deepest)[0])
    args.report(
        f"     {len(loads)} known loads: uncertainty of the foam's curve {100 * sigma:.0f} % at the maximum deflection"
    )
    return material
