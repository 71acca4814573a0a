"""The moving pictures of the README, and the recorded mission of ``visuohaptic demo --quick``, from our own renders.

python docs/pictures.py mission    src/visuohaptic/demo/mission.zip: the whole demo of seed 2, some minutes
python docs/pictures.py push       docs/images/push.webp: a push, its force and pressure, from that recording
python docs/pictures.py force      docs/images/force.png: the README's five lines compared with the truth
python docs/pictures.py glass      docs/images/glass.webp: a glass bottle detected, touched and completed
"""

from __future__ import annotations

import io
import json
import sys
import zipfile
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

from visuohaptic.core import ForceProfile, from_dict
from visuohaptic.core.files import decode_image

IMAGES = Path(__file__).with_name("images")
#: Object whose push is shown, and how long a picture stays [ms].
OBJECT, FRAME_MS = "heavy box", 120


def record_mission() -> Path:
    """Run the demo with a recorder in place of page and terminal."""
    from mission_recorder import MissionRecorder

    from visuohaptic.demo.chapters import run_mission
    from visuohaptic.demo.recorded import RECORDED
    from visuohaptic.demo.report import write_story
    from visuohaptic.demo.story import Mission

    recorder, grid = MissionRecorder(), Mission(2, Path()).house.grid
    recorder.set_map(grid.cells, grid.resolution_m, grid.origin)
    with TemporaryDirectory() as folder:
        page: Any = recorder
        story = run_mission(folder, seed=2, on_message=recorder.log, page=page)
        recorder.log("")
        recorder.log(story.summary())
        recorder.save(RECORDED, write_story(story, Path(folder) / "report.html"))
    return RECORDED


def push() -> Path:
    """Camera, force over time and pressure along the strip, state by state."""
    from visuohaptic.demo.recorded import RECORDED

    with zipfile.ZipFile(RECORDED) as archive:
        events = json.loads(archive.read("events.json"))
        pictures = iter(sorted(name for name in archive.namelist() if name.endswith(".webp")))
        states, at_object = [], False
        for event in events:
            if event[0] == "line" and not event[1].startswith("   "):
                at_object = event[1].strip() == OBJECT or (at_object and "seen" in event[1])
            if event[0] == "update":
                name = next(pictures)
                if at_object:
                    image = decode_image(archive.read(name), name)
                    states.append((event[1], from_dict(ForceProfile, event[2], where=name), image))
    touched = next(k for k, (_, profile, _) in enumerate(states) if profile.force_N > 0.05)
    return save(IMAGES / "push.webp", _push_frames(states[max(0, touched - 6) :]))


def _push_frames(states: list[tuple[float, ForceProfile, np.ndarray]]) -> Iterable[np.ndarray]:
    from visuohaptic.report.style import COLOURS, draw_axes

    t_s = np.array([state[0] for state in states]) - states[0][0]
    force_N, sigma_N = np.array([(profile.force_N, profile.force_sigma_N) for _, profile, _ in states]).T
    top_Pa = max(np.nanmax(profile.pressure_Pa) for _, profile, _ in states if profile.valid)
    for index, (_, profile, image) in enumerate(states):

        def draw(
            camera: Any, force: Any, pressure: Any, k: int = index, p: Any = profile, seen: Any = image
        ) -> None:
            camera.imshow(seen[:, :, ::-1])
            camera.set_axis_off()
            past = slice(0, k + 1)
            force.fill_between(
                t_s[past], (force_N - 2 * sigma_N)[past], (force_N + 2 * sigma_N)[past],
                color=COLOURS["blue"], alpha=0.25, lw=0,
            )  # fmt: skip
            force.plot(t_s[past], force_N[past], color=COLOURS["blue"])
            force.set(
                xlim=(0, t_s[-1]),
                ylim=(-0.3, 1.15 * np.nanmax(force_N)),
                xlabel="time [s]",
                ylabel="force [N]",
            )
            force.set_title(f"{force_N[k]:.2f} N ± {sigma_N[k]:.2f} N" if np.isfinite(force_N[k]) else "")
            if p.valid:
                pressure.fill_between(
                    1e3 * p.s_m,
                    1e-3 * p.pressure_Pa,
                    color=COLOURS["orange"],
                )
            pressure.set(ylim=(0, 1.1e-3 * top_Pa), xlabel="along the strip [mm]", ylabel="pressure [kPa]")

        yield drawn(draw_axes(1, 3, draw, size=(11.0, 2.5)))


def glass() -> Path:
    """Depth views around the table; what is transparent; touch by touch; the completed outline."""
    from visuohaptic.demo import probe_chapters
    from visuohaptic.demo.bottle import PLACE
    from visuohaptic.demo.chapters import run_mission

    touches: list[np.ndarray] = []
    original = probe_chapters._radial

    def listen(told: tuple[Any, ...], foot_m: np.ndarray) -> Any:
        contacts = [one.contact_m for one in told if one.contact_m is not None]
        touches[:] = PLACE.inverse().apply(np.array(contacts).reshape(-1, 3))
        return original(told, foot_m)

    probe_chapters._radial = listen
    with TemporaryDirectory() as folder:
        mission = run_mission(folder, part="glass", seed=2).mission
    return save(IMAGES / "glass.webp", _glass_frames(mission, np.array(touches)))


def _glass_frames(mission: Any, touches_m: np.ndarray) -> Iterable[np.ndarray]:
    from visuohaptic.demo.bottle import table_views
    from visuohaptic.demo.results import counted
    from visuohaptic.report.style import COLOURS, draw_axes
    from visuohaptic.simulation.tabletop.depth_camera import DepthCamera

    rng = np.random.default_rng(0)
    camera, region = DepthCamera.kinect(240), mission.scan.regions[0]
    poses = list(table_views(60, rng))[:15]
    views = [(camera.render(mission.bottle.scene, pose, rng), pose) for pose in poses]
    foot_m, outline_mm, true_mm = (
        mission.known.bottle_at_m, 1e3 * mission.known.outline_m, 1e3 * mission.bottle.outline_m
    )  # fmt: skip
    radial_mm = 1e3 * np.column_stack([np.hypot(*(touches_m[:, :2] - foot_m).T), touches_m[:, 2]])
    steps = [(k, 0, False) for k in range(15)] + [(14, 0, True)] * 3
    steps += [(14, n, True) for n in range(1, len(touches_m) + 1) for _ in range(2)] + [(14, 99, True)] * 12
    for view, count, found in steps:

        def draw(scene: Any, side: Any, view: int = view, count: int = count, found: bool = found) -> None:
            depth_m, pose = views[view]
            scene.imshow(
                np.where(np.isfinite(depth_m), depth_m, np.nan), cmap="viridis_r", vmin=0.5, vmax=1.4
            )
            scene.set_facecolor("black")
            scene.set(xticks=[], yticks=[], xlim=(40, 200), ylim=(150, 30))
            scene.set_title(
                "depth: what the camera sees" if not found else "the views contradict each other: glass"
            )
            T_camera_world = pose.inverse()
            if found:
                seen_px = camera.camera.project(T_camera_world.apply(region.hull_m)).astype(np.float32)
                scene.fill(*cv2.convexHull(seen_px)[:, 0].T, fill=False, ec=COLOURS["orange"], lw=2)
            if count:
                scene.plot(
                    *camera.camera.project(T_camera_world.apply(touches_m[:count])).T,
                    "o",
                    color=COLOURS["orange"],
                )
            for sign in (1, -1):
                side.plot(sign * true_mm[:, 0], true_mm[:, 1], color=COLOURS["grey"], lw=0.8)
                if count > len(touches_m):
                    side.plot(sign * outline_mm[:, 0], outline_mm[:, 1], color=COLOURS["blue"], lw=2.5)
            side.plot(*radial_mm[:count].T, "o", color=COLOURS["orange"])
            side.set(
                aspect="equal",
                xlim=(-75, 75),
                ylim=(-5, 210),
                xlabel="distance from the axis [mm]",
                ylabel="height [mm]",
            )
            side.set_title(
                "completed"
                if count > len(touches_m)
                else counted(count, "touch", "touches")
                if count
                else "truth (grey)"
            )

        yield drawn(draw_axes(1, 2, draw, size=(9.0, 4.2)))


def force() -> Path:
    """Force of the example over time."""
    import visuohaptic as vh
    from visuohaptic.cli.main import main
    from visuohaptic.rigs import write_example

    with TemporaryDirectory() as folder:
        write_example(folder)
        main(
            f"calibrate foam {folder}/strain_stress.csv --width 0.02 --height 0.01 --out {folder}/foam.yaml -q".split()
        )
        sensor = vh.FoamSensor.load(f"{folder}/sensor.yaml")
        sensor.zero(vh.open_source(f"{folder}/rest.mp4"))
        profiles = [sensor.read(frame) for frame in vh.open_source(f"{folder}/push.mp4")]
        truth_N = np.loadtxt(f"{folder}/truth.csv", delimiter=",", skiprows=1)[:, 1]
    figure = vh.force_over_time(
        *np.array([(p.t_s, p.force_N, p.force_sigma_N) for p in profiles]).T,
        truth_N=truth_N,
        valid=np.array([p.valid for p in profiles]),
        reasons=[p.reason.value for p in profiles],
    )
    figure.savefig(IMAGES / "force.png", dpi=100)
    return IMAGES / "force.png"


def drawn(figure: Any) -> np.ndarray:
    """Pixels (rows, columns, 3) of a figure."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=80)
    return decode_image(stream.getvalue(), "figure")[:, :, :3]


def save(path: Path, images: Iterable[np.ndarray]) -> Path:
    """Write an endless moving picture."""
    from PIL import Image

    first, *others = [Image.fromarray(image[:, :, ::-1]) for image in images]
    first.save(path, save_all=True, append_images=others, duration=FRAME_MS, loop=0, quality=60, method=4)
    return path


if __name__ == "__main__":
    for word in sys.argv[1:] or ["mission", "push", "force", "glass"]:
        made = {"mission": record_mission, "push": push, "force": force, "glass": glass}[word]()
        print(f"{made}: {made.stat().st_size / 1e6:.2f} MB")
