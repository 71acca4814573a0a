"""Every example that ``--help`` shows is run as it stands, and a number of its result is checked.

A verb has a story: what lies in the folder before (made by our own simulation and verbs, from seeds),
and what the result must say. The words are taken from the help, never repeated here; only ``--json``
is added. A new verb without a story fails ``test_every_verb_has_a_story``.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
import shlex
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import cv2
import numpy as np
import pytest
import yaml
from tests.cli.capture_camera import connected
from tests.cli.help_words import examples, recorded_imports, undeclared
from tests.explorations import explored_less
from tests.patience import PATIENCE_S

from visuohaptic.cli import _compilation
from visuohaptic.cli import main as command
from visuohaptic.cli.main import VERBS
from visuohaptic.core.camera import Camera

pytest.importorskip("av")
pytest.importorskip("mcap_ros2")

try:
    import fcntl
except ImportError:  # Windows: each worker has a folder of its own
    fcntl = None  # type: ignore[assignment]

Check = Callable[[Path, list[Any]], None]


@dataclass(frozen=True)
class Story:
    """What one verb's examples need and promise."""

    check: Check
    prepare: Callable[[Path, World], None] = lambda folder, world: None
    room: str = ""  #: folder that is shared with other verbs; by default the verb has its own
    needs: tuple[str, ...] = ()  #: verbs whose examples come first
    around: Callable[[], Any] = contextlib.nullcontext  #: what stands in for a person or a server


class World:
    """Folders in which examples were run, each once in a session.

    Parameters
    ----------
    base
        Folder of the session; workers of one session may share it.
    """

    def __init__(self, base: Path) -> None:
        self.base = base
        self._held: set[str] = set()

    def folder(self, verb: str) -> Path:
        folder = self.base / (STORIES[verb].room or verb).replace(" ", "_")
        folder.mkdir(exist_ok=True)
        return folder

    @contextlib.contextmanager
    def _alone(self, folder: Path) -> Iterator[None]:
        """Other workers wait until the examples of this folder have ended."""
        if folder.name in self._held or fcntl is None:
            yield
            return
        with folder.with_suffix(".lock").open("w") as stream:
            fcntl.flock(stream, fcntl.LOCK_EX)
            self._held.add(folder.name)
            try:
                yield
            finally:
                self._held.remove(folder.name)

    def run(self, verb: str) -> tuple[Path, list[Any]]:
        """Run a verb's examples, after those that they need; their results as JSON."""
        story, folder = STORIES[verb], self.folder(verb)
        done = self.base / f"{verb.replace(' ', '_')}.json"
        with self._alone(folder):
            if not done.exists():
                for need in story.needs:
                    self.run(need)
                story.prepare(folder, self)
                with contextlib.chdir(folder), story.around():
                    results = [_call(words) for words in examples(verb)]
                done.write_text(json.dumps(results))
            return folder, json.loads(done.read_text())

    def copy(self, verb: str, folder: Path) -> None:
        """Lay what another verb's examples wrote into a folder."""
        shutil.copytree(self.run(verb)[0], folder, dirs_exist_ok=True)

    def copy_recording(self, folder: Path | str) -> Path:
        """Lay the files of ``write_example`` into a folder: without those of the verbs that follow in its example."""
        later = shutil.ignore_patterns("run.*", "zero.yaml", "foam.*")
        shutil.copytree(self.run("example foam")[0] / "try", folder, ignore=later, dirs_exist_ok=True)
        return Path(folder)


def _call(words: list[str]) -> Any:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), recorded_imports() as imported:
        code = command.main([*words, "--json"])
    assert code == 0, f"{shlex.join(words)}: code {code}: {err.getvalue()}"
    assert not undeclared(words, imported), f"{shlex.join(words)} imports them, the verb's NEEDS lacks them"
    return json.loads(out.getvalue())


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


# What lies in the folders ------------------------------------------------------------------------------


def _flatten(name: str) -> Callable[[Path, World], None]:
    """The example's ``try`` folder, as the folder where one stands."""

    def prepare(folder: Path, world: World) -> None:
        shutil.copytree(world.run(name)[0] / "try", folder, dirs_exist_ok=True)

    return prepare


def _scaled(folder: Path, world: World) -> None:
    """The example of the foam, and a kitchen scale beside it: grams, ten a second, 0.4 s late."""
    shutil.copytree(world.run("example foam")[0] / "try", folder, dirs_exist_ok=True)
    t_s, force_N = np.array([(float(r["t_s"]), float(r["force_N"])) for r in rows(folder / "truth.csv")]).T
    with (folder / "scale.csv").open("w", newline="") as stream:
        grams = np.round(force_N / 9.80665e-3)
        csv.writer(stream).writerows([["t_s", "mass_g"], *zip(t_s[::3] + 0.4, grams[::3], strict=True)])


def _compared(folder: Path, world: World) -> None:
    """What `sense foam` wrote, and the scale."""
    written = world.run("sense foam")[0]
    shutil.copy(written / "run.csv", folder)
    shutil.copy(written / "scale.csv", folder)


def _scene(folder: Path, world: World) -> None:
    """A drive of 6 cm towards a box, told by 30 frames a second, and its wheels."""
    from tests.sensing import scenes

    from visuohaptic.core.files import save_yaml
    from visuohaptic.rigs import write_video

    scenes.RIG.camera.save(folder / "camera.yaml")
    described = scenes.RIG.T_camera_foam.fields
    save_yaml(folder / "scene.yaml", {"kind": "scene", "camera": "camera.yaml", "T_camera_foam": described})
    render, rng = scenes.renderer(scenes.RIG), np.random.default_rng(0)
    images = []
    for i in range(16):
        box = scenes.box(0.30 - 0.004 * i, 0.0, grey=180.0)
        images.append(render.render(scenes.scene(i / 30, scenes.planar(0.004 * i, 0, 0), [box]), rng=rng))
    write_video(folder / "drive.mp4", images)
    shutil.copy(folder / "drive.mp4", folder / "push.mp4")
    with (folder / "wheels.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows(
            [["t_s", "speed_m_s", "turn_rate_rad_s"], *([i / 10, 0.12, 0.0] for i in range(7))]
        )


def _first_load(folder: Path, world: World) -> None:
    """The example of the beam up to the end of its first load: the whole is read where it is made."""
    from visuohaptic.rigs import write_video

    _flatten("example beam")(folder, world)
    count = len(rows(folder / "truth.csv")) // 3
    write_video(folder / "push.mp4", _video(folder / "push.mp4")[:count])
    lines = (folder / "truth.csv").read_text().splitlines(keepends=True)
    (folder / "truth.csv").write_text("".join(lines[: count + 1]))


def _tags(folder: Path, world: World) -> None:
    from visuohaptic.rigs import write_video

    _flatten("example beam")(folder, world)
    write_video(folder / "run.mp4", _video(folder / "rest.mp4")[:8])  # a hand holds the camera


def _cover(folder: Path, world: World) -> None:
    from PIL import Image

    image = cv2.GaussianBlur(np.random.default_rng(0).uniform(0, 255, (200, 300)), (0, 0), 2)
    image = cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    Image.fromarray(image).save(folder / "cover.png", dpi=(100, 100))


def _press(folder: Path, world: World) -> None:
    """A press log, and contours under a 4 cm plate at three depths."""
    from visuohaptic.simulation.foam import FoamStripGeometry, PressShape, calibration_press, press
    from visuohaptic.simulation.foam.strip_law import write_calibration_csv

    write_calibration_csv(
        folder / "press.csv", calibration_press(geometry=FoamStripGeometry(spacing_m=0.002))
    )
    geometry = FoamStripGeometry()
    with (folder / "plate.csv").open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(["depth_m", "force_N", "s_m", "delta_m"])
        for sample in press(PressShape.PLATE_4CM, [0.003, 0.005, 0.007], geometry=geometry):
            delta_m = geometry.width_m - (sample.strip.front_m[:, 0] - sample.scene.back_m[:, 0])
            for s_m, delta in zip(sample.strip.front_m[:, 1], delta_m, strict=True):
                table.writerow([sample.depth_m, sample.force_N, s_m, delta])


def _loads(folder: Path, world: World) -> None:
    """Readings that are 3 % too high on every axis."""
    from visuohaptic.sensing.beam import Beam, save_beam

    save_beam(folder / "beam.yaml", Beam())
    axes = ["fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm"]
    loads = np.vstack([np.diag([2, 1, 1, 0.05, 0.1, 0.1]) * fraction for fraction in (-1, -0.5, 0, 0.5, 1)])
    read = loads * 1.03 + np.random.default_rng(2).normal(0, 1e-4, loads.shape)
    header = ",".join([*axes, *(f"read_{name}" for name in axes)])
    np.savetxt(folder / "loads.csv", np.hstack([loads, read]), "%.9g", ",", header=header, comments="")


def _photos(folder: Path, world: World) -> None:
    from tests.core.test_calibration import poses, render

    from visuohaptic.core.camera import Board

    (folder / "photos").mkdir()
    for i, pose in enumerate(poses(12, seed=3)):
        cv2.imwrite(str(folder / "photos" / f"{i:02d}.png"), render(Board(9, 6, 0.025, 0.018), pose))


def _gripper(folder: Path, world: World) -> None:
    from visuohaptic.rigs import GripperSensor

    rig = GripperSensor()
    rig.build(folder, np.random.default_rng(1), zero_frames=4)
    cv2.imwrite(str(folder / "rest.png"), rig.gripper(rng=np.random.default_rng(2)).frame().image)


def _office(folder: Path, world: World) -> None:
    """The dissertation's figure 4.6, rebuilt: rooms, a stool, a table, a tower and bins."""
    from tests.navigation.plan_scenes import office

    problem = office()
    problem.map.save(folder / "office.yaml")
    problem.map.save(folder / "map.yaml")
    listed = []
    for item in problem.objects:
        names = ("static_friction_N", "dynamic_friction_N", "drift", "fixed", "explored")
        values = {name: getattr(item.tag, name) for name in names}
        tag = {name: getattr(value, "value", value) for name, value in values.items()}
        listed.append({"id": item.id, "footprint_m": item.footprint_m.tolist(), "haptic_tag": tag})
    (folder / "objects.yaml").write_text(yaml.safe_dump({"objects": listed}))
    robot = {"radius_m": 0.17, "v_max_m_s": 0.3, "v_min_m_s": 0.05, "v_push_m_s": 0.05}
    robot |= {"push_force_max_N": 20.0, "setup_time_s": 4.0}
    (folder / "robot.yaml").write_text(yaml.safe_dump(robot))


def _scans(folder: Path, world: World) -> None:
    """A laser in a room of 6 m by 4 m, 5 cm further with every scan."""
    from tests.io.test_laser_scans import odometry_message, room_scan, scan_message

    from visuohaptic.io.sinks import MeasurementWriter

    with MeasurementWriter(folder / "run.mcap") as writer:
        for i in range(12):
            scan, odometry = (
                scan_message(room_scan(0.1 * i, 0.05 * i)),
                odometry_message(0.1 * i, 0.05 * i, 0.0),
            )
            writer.write("/scan", "sensor_msgs/msg/LaserScan", 0.1 * i, scan)
            writer.write("/odom", "nav_msgs/msg/Odometry", 0.1 * i, odometry)
    for floor in (1, 2):
        shutil.copy(folder / "run.mcap", folder / f"floor-{floor}.mcap")


def _glass(folder: Path, world: World) -> None:
    """Every third view of the example's: 14, in which each part is seen often enough."""
    shutil.copytree(world.run("example glass")[0] / "try" / "scan", folder / "scan")
    views = sorted((folder / "scan" / "depth").iterdir())
    for view in set(views) - set(views[::3]):
        view.unlink()
    poses = (folder / "scan" / "poses.txt").read_text().splitlines(keepends=True)
    (folder / "scan" / "poses.txt").write_text("".join([poses[0], *poses[1::3]]))


def _robot_arm(folder: Path, world: World) -> None:
    """Five depth pictures of a wall 0.5 m away, in the layout of a published data set."""
    source = folder / "d435i_robot_arm"
    (source / "depth").mkdir(parents=True)
    camera = {
        "width": 64,
        "height": 48,
        "fx": 60.0,
        "fy": 60.0,
        "cx": 31.5,
        "cy": 23.5,
        "depth_unit_m": 0.001,
    }
    (source / "camera.json").write_text(json.dumps(camera))
    poses = []
    for number in range(1, 6):
        cv2.imwrite(str(source / "depth" / f"{number}.png"), np.full((48, 64), 500, np.uint16))
        pose = np.eye(4)
        pose[0, 3] = 0.01 * number
        poses.append(" ".join([str(number), *(f"{v:g}" for v in pose.ravel())]))
    (source / "base_T_cam.txt").write_text("\n".join(poses) + "\n")


def _holed(folder: Path, world: World) -> None:
    """A bottle of which the belly is not seen."""
    from tests.reconstruction.test_completion import bellied, scene

    visible, region, _ = scene(bellied())
    visible.save(folder / "surface.ply")
    cluster = {"hull": region.hull_m.tolist(), "centroid": [0, 0, 0.1], "size": [0.1] * 3, "score": 0.9}
    (folder / "regions.json").write_text(json.dumps({"clusters": [cluster]}))


def _more_objects(folder: Path, world: World) -> None:
    """Three cups with features; cup-1 is between the others, nearer to cup-2."""
    from visuohaptic.core import FeatureVector, VisuoHapticObject
    from visuohaptic.database import open_database

    with open_database(folder / "objects.db") as database:
        for name, value in (("cup-1", 1.0), ("cup-2", 1.2), ("cup-3", 0.0)):
            features = {"stiffness": FeatureVector(np.full(4, value))}
            database.add(VisuoHapticObject(name, features=features))


def _classes(folder: Path, world: World) -> None:
    plan = {"seed": 1, "around": 32, "states": [{"closed": False}]}
    plan["classes"] = [{"class": "bottle", "variants": 2}, {"class": "cup", "variants": 1}]
    (folder / "classes.yaml").write_text(yaml.safe_dump(plan))


def _build(folder: Path, world: World) -> None:
    """Six classes as ``objects build`` lists them, but drawn: each has a stiffness of its own at the top."""
    rng = np.random.default_rng(0)
    (folder / "objects").mkdir()
    listed = []
    for k, name in enumerate(("bottle", "cup", "elliptic", "isana", "cien", "cleaner")):
        for i in range(6):
            line = np.exp(np.interp(np.linspace(0, 1, 16), [0, 0.5, 1], [9, 7, 4 + k]) + rng.normal(0, 0.05))
            grid = np.repeat(line[:, None], 4, axis=1)
            points = np.zeros((16, 4, 3))
            points[:, 0, 0] = points[:, 2, 1] = 0.03
            points[:, 1, 0] = points[:, 3, 1] = -0.03
            file = f"{name}-{i:05d}.npz"
            features = np.stack([grid, grid, 0 * grid], axis=-1)[None]
            np.savez(
                folder / "objects" / file,
                states=np.zeros((1, 2)),
                features=features,
                feature_points_m=points,
            )
            listed.append({"file": file, "class": name})
    (folder / "objects" / "manifest.json").write_text(json.dumps({"objects": listed}))
    with (folder / "squeezes.csv").open("w") as stream:
        stream.write("label,object,at,side,force_N,deformation_m\n")
        for k, name in enumerate(("bottle", "cup")):
            for i, at in enumerate((0.4, 0.5, 0.6)):
                stiffness = 1000.0 * (1 + 3 * k) * (1 + 0.02 * i)
                for depth_m in np.arange(1, 19) / 6000:
                    for side in ("x+", "x-"):
                        stream.write(f"{name},{name}{i},{at},{side},{stiffness * depth_m},{depth_m}\n")


def _curves(folder: Path, world: World) -> None:
    """What a finger feels on one of the bottles, at all heights."""
    with np.load(folder / "objects" / "isana-00000.npz") as data:
        stiffness = data["features"][0, :, :, 0]
    with (folder / "curves.csv").open("w") as stream:
        stream.write("height,side,force_N,deformation_m,width_m\n")
        for height in range(1, 17):
            for column, side in enumerate(("x+", "x-", "y+", "y-")):
                for depth_m in np.arange(1, 19) / 6000:
                    force_N = stiffness[height - 1, column] * depth_m
                    stream.write(f"{height},{side},{force_N},{depth_m},0.06\n")


def _recording(folder: Path, world: World) -> None:
    shutil.copy(world.run("sense foam")[0] / "run.mcap", folder)


def _killed(folder: Path, world: World) -> None:
    from visuohaptic.core import Event, EventKind
    from visuohaptic.io import MeasurementWriter

    with MeasurementWriter(folder / "run.mcap") as writer:
        writer.write_event(Event(EventKind.CONTACT, 1.0))
        left = (folder / "run.mcap.part").read_bytes()
    (folder / "run.mcap").unlink()
    (folder / "run.mcap.part").write_bytes(left)


def _to_view(folder: Path, world: World) -> None:
    _office(folder, world)
    _, (plan,) = world.run("plan")
    (folder / "plan.json").write_text(json.dumps(plan))
    shutil.copy(world.run("complete")[0] / "completed.ply", folder)


@contextlib.contextmanager
def _shorter() -> Iterator[None]:
    """Loads that rise and fall in half the time: whatever an example does with the frames, it does with half of them."""
    from visuohaptic.rigs import foam_example, gripper_example, virtual_beam

    with (
        mock.patch.object(foam_example, "_FRAMES", 22),
        mock.patch.object(gripper_example, "_OPENING", 8),
        mock.patch.object(virtual_beam.push_and_twist, "__defaults__", (48,)),
    ):
        yield


@contextlib.contextmanager
def _ctrl_c() -> Iterator[None]:
    """A person who looks, and ends it at once."""

    def sleep(seconds: float) -> None:
        raise KeyboardInterrupt

    with mock.patch(
        "visuohaptic.cli.verbs.system.view.time", SimpleNamespace(sleep=sleep, monotonic=time.monotonic)
    ):
        yield


@contextlib.contextmanager
def _answers() -> Iterator[None]:
    """A person who says the same of every touch, looks at the page, and ends it."""
    with _ctrl_c(), mock.patch("sys.stdin", io.StringIO("5200 5150 0.071\n" * 100)):
        yield


@contextlib.contextmanager
def _server() -> Iterator[None]:
    """The shared database of the example's address is a folder: no server runs here."""
    from visuohaptic.database import open_database as real

    def stand_in(where: Any, **more: Any) -> Any:
        return real("shared.db" if str(where).startswith("postgresql:") else where, **more)

    with mock.patch("visuohaptic.database.open_database", stand_in):
        yield


def _disc(folder: Path, world: World) -> None:
    (folder / "robot.yaml").write_text("radius_m: 0.31\n")


def _own_robot(folder: Path, world: World) -> None:
    """The example's parts, under the name in the help."""
    (folder / "my_robot.py").write_text(
        "from tests.tasks.example_robot import connect\n\n__all__ = ['connect']\n"
    )


@contextlib.contextmanager
def _few_libraries() -> Iterator[None]:
    """Three processes instead of thirty: tests/cli/test_doctor.py compares the whole table."""
    from visuohaptic.cli.verbs.system import doctor

    with mock.patch.object(doctor, "CORE", doctor.CORE[:2]), mock.patch.object(doctor, "OPTIONAL", ()):
        yield


@contextlib.contextmanager
def _few_kernels() -> Iterator[None]:
    """One small kernel of each package that the examples name: tests/cli/test_warmup.py compiles the whole list."""
    names = (
        "navigation.graph.tracing._skeleton_kernels:survey",
        "sensing.foam._profile_kernels:shared_variance",
        "tracking.templates.alignment._esm_kernels:exponential",
    )
    lines = [line for line in _compilation.signature_lines() if line.partition(" ")[0].endswith(names)]
    assert len(lines) == len(names)
    path = Path("signatures.txt")
    path.write_text("\n".join(lines) + "\n")
    with mock.patch.object(_compilation, "SIGNATURES", path.resolve()):
        yield


@contextlib.contextmanager
def _robot() -> Iterator[None]:
    """A robot on this machine whose camera shows the strip at rest and pushed; it listens, and then Ctrl-C comes."""
    pytest.importorskip("zenoh")
    from tests.ros.conftest import free_endpoint

    from visuohaptic.core.files import save_yaml
    from visuohaptic.io.ros import ros_messages as messages
    from visuohaptic.ros import RosNode, RosOptions

    endpoint, image = free_endpoint(), "/bumper/image/compressed"
    zero, pushed = _video(Path("rest.mp4"))[:8], _video(Path("push.mp4"))[::4]
    section = {"name": "foam", "config": "sensor.yaml", "image": image, "queue": 40, "zero_frames": len(zero)}
    node = {"connect": [endpoint], "listen": [], "patience_s": PATIENCE_S}
    save_yaml(Path("bridge.yaml"), {"node": node, "sensors": [section], "stale_s": 30.0})
    heard: list[float] = []

    def speak(robot: RosNode) -> None:
        camera = robot.advertise(image, "sensor_msgs/msg/CompressedImage", wait=True)
        camera.wait_until_heard()
        for number, picture in enumerate([*zero, *pushed]):
            camera.publish(messages.compressed_image(10.0 + number / 30, picture, "bumper", 98))
        end = time.monotonic() + PATIENCE_S
        while len(heard) < len(pushed) and time.monotonic() < end:
            time.sleep(0.01)
        Path("heard.json").write_text(json.dumps(heard))
        os.kill(os.getpid(), signal.SIGINT)

    with RosNode("robot", RosOptions(connect=(), listen=(endpoint,))) as robot:
        robot.subscribe(
            "/foam/wrench",
            "geometry_msgs/msg/WrenchStamped",
            lambda r: heard.append(r.message.wrench.force.x),
        )
        speaker = threading.Thread(target=speak, args=(robot,))
        speaker.start()
        try:
            yield
        finally:
            speaker.join(PATIENCE_S)


def _video(path: Path) -> list[np.ndarray]:
    """Its pictures in grey."""
    import av

    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="gray") for frame in container.decode(video=0)]


# What the results must say -----------------------------------------------------------------------------


def _sense_foam(folder: Path, results: list[Any]) -> None:
    truth = max(float(row["force_N"]) for row in rows(folder / "truth.csv"))
    read = max(float(row["force_N"]) for row in rows(folder / "run.csv") if row["valid"] in {"1", "true"})
    assert read == pytest.approx(truth, rel=0.03)  # the sensor's figure is 2.5 % of a force
    assert (folder / "force.png").stat().st_size > 5000
    _compare(folder, [results[-1]["against"]])
    assert (folder / "scale.html").stat().st_size > 20_000


def _compare(folder: Path, results: list[Any]) -> None:
    (found,) = results
    assert found["offset_s"] == pytest.approx(0.4, abs=0.03)  # a frame is 0.033 s
    assert found["gain"] == pytest.approx(1.0, abs=0.03)
    assert found["read"] > 0.9


def _sense_scene(folder: Path, results: list[Any]) -> None:
    for result in results:
        assert result["frames"] == 16
        assert result["pose"]["x_m"] == pytest.approx(0.06, abs=0.002)  # of a compressed video
    assert (folder / "scene.png").stat().st_size > 5000


def _sense_beam(folder: Path, results: list[Any]) -> None:
    truth = [float(row["fy_N"]) for row in rows(folder / "truth.csv")]
    read = [float(row["fy_N"]) for row in rows(folder / "run.csv")]
    assert len(read) == len(truth)
    assert np.nanmax(np.abs(np.subtract(read, truth))) < 0.1 * np.max(np.abs(truth))
    assert (folder / "run.png").stat().st_size > 5000


def _example_files(axis: str, video: str = "push.mp4") -> Check:
    def check(folder: Path, results: list[Any]) -> None:
        names = {path.name for path in (folder / "try").iterdir()}
        assert {"rest.mp4", video, "sensor.yaml", "run.csv", "run.mcap", "zero.yaml"} <= names
        truth = [float(row[axis]) for row in rows(folder / "try" / "truth.csv")]
        read = [float(row[axis]) for row in rows(folder / "try" / "run.csv")]
        assert np.nanmax(read) == pytest.approx(max(truth), rel=0.03)

    return check


def _example_office(folder: Path, results: list[Any]) -> None:
    """The stool is pushed out of the gap, as in the dissertation's figure; the tower, which is fixed, is not."""
    pushed = [task["object"] for task in results[1]["tasks"] if task["kind"] == "push"]
    assert pushed == ["stool"]
    assert (folder / "try" / "plan.png").stat().st_size > 10_000


def _example_task(folder: Path, results: list[Any]) -> None:
    """The claim is true, and the decisions can be made again from the trace alone."""
    assert [result["outcome"] for result in results] == ["opened", "mapped"]
    assert results[0]["truly_open"]
    assert results[1]["correct_flags"] > 0.8 * results[1]["contacts"]
    from visuohaptic.tasks.framework import Trace

    for name, ending in (("cap", "opened"), ("room", "mapped")):
        trace = Trace.load(folder / name / "trace.jsonl")
        assert trace.ending is not None
        assert trace.ending.outcome == ending
    assert yaml.safe_load((folder / "room" / "map.yaml").read_text())["resolution"] == pytest.approx(0.025)


def _example_glass(folder: Path, results: list[Any]) -> None:
    """A bottle is found within its radius, and the surface around it is completed."""
    written, model, completed = results
    assert written["views"] > 20
    truth = np.array([[float(row["x_m"]), float(row["y_m"])] for row in rows(folder / "try" / "truth.csv")])
    centroids = np.array([region["centroid_m"] for region in model["regions"]])[:, :2]
    # Bottles have radii of 3 cm and more; at least half of them are found.
    gaps = np.linalg.norm(truth[:, None] - centroids, axis=2).min(axis=1)
    assert np.median(gaps) < 0.03
    assert completed["supports"] > 50
    assert completed["next"]["sigma_m"] > 0


def _template_check(folder: Path, results: list[Any]) -> None:
    assert len(results) == 2
    assert (folder / "sheet.pdf").stat().st_size > 1000


def _calibrate_foam(folder: Path, results: list[Any]) -> None:
    card = yaml.safe_load((folder / "foam.yaml").read_text())
    assert card["width_m"] == pytest.approx(0.02)
    assert (folder / "foam.png").stat().st_size > 5000


def _calibrate_camera(folder: Path, results: list[Any]) -> None:
    found = Camera.load(folder / "camera.yaml").matrix
    assert found[[0, 1], [0, 1]] == pytest.approx([610.0, 606.0], rel=0.01)


def _map_graph(folder: Path, results: list[Any]) -> None:
    (found,) = results
    graph = json.loads((folder / "office_graph" / "graph.geojson").read_text())
    points = [one for one in graph["features"] if one["geometry"]["type"] == "Point"]
    assert found["nodes"] == len(points) > 3


def _map_build(folder: Path, results: list[Any]) -> None:
    from visuohaptic.io.maps import OccupancyMap

    grid = OccupancyMap.load(folder / "map.yaml")
    walls = grid.world_from_cell(np.argwhere(grid.occupied))
    np.testing.assert_allclose([walls.min(axis=0), walls.max(axis=0)], [[-3, -2], [3, 2]], atol=0.06)
    assert [one["map"] for one in results[1]["floors"]] == ["maps/floor-1.yaml", "maps/floor-2.yaml"]
    for floor in (1, 2):
        assert (folder / "maps" / f"floor-{floor}.pgm").read_bytes() == (folder / "map.pgm").read_bytes()


def _plan(folder: Path, results: list[Any]) -> None:
    (found,) = results
    assert found["reachable"]
    assert found["cost_s"] == pytest.approx(sum(task["cost_s"] for task in found["tasks"]), abs=1e-3)


def _stiffness(folder: Path, results: list[Any]) -> None:
    with np.load(folder / "map.npz") as data:
        stiffness = data["stiffness_N_per_m"]
    free = stiffness[np.isfinite(stiffness)]
    assert 10 < np.median(free) < 1e5  # a finger dents a PET bottle by millimetres


def _squeeze(folder: Path, results: list[Any]) -> None:
    (found,) = results
    assert found["force_N"] == pytest.approx(np.linspace(1.25, 10, 8).tolist(), rel=1e-3)
    assert len(rows(folder / "curve.csv")) == 9


def _grasp(folder: Path, results: list[Any]) -> None:
    (found,) = results
    assert found["grasps"][0]["first_m"][2] > 0.09  # at the stiff rim
    assert [grasp["rim"] for grasp in found["grasps"]] == sorted(grasp["rim"] for grasp in found["grasps"])


def _reconstruct(folder: Path, results: list[Any]) -> None:
    told = json.loads((folder / "model" / "regions.json").read_text())["clusters"]
    assert len(told) >= 1
    assert (folder / "model" / "surface.ply").stat().st_size > 10_000


def _complete(folder: Path, results: list[Any]) -> None:
    (found,) = results
    target = np.asarray(found["next"]["target_m"])
    assert 0.05 < target[2] < 0.15  # in the hole, on the wall
    assert 0.01 < np.hypot(*target[:2]) < 0.08


def _objects_add(folder: Path, results: list[Any]) -> None:
    assert results[0]["material"]["wall_thickness_m"]["value"] == pytest.approx(0.8e-3)


def _classify_train(folder: Path, results: list[Any]) -> None:
    assert results[0]["classes"] == ["bottle", "cup", "elliptic"]
    assert "elliptic" in results[1]["classes"]
    assert results[2]["classes"] == ["bottle", "cup"]
    assert results[3]["scheme"] in ("norm", "centre", "point")
    assert results[4]["states"] == ["open", "closed", "closed, 50 % full"]
    assert max(results[4]["places"].values()) > 2 / 3  # by chance one of three is right


def _classify_run(folder: Path, results: list[Any]) -> None:
    found, asked = results
    assert sum(found["probabilities"].values()) == pytest.approx(1)
    assert found["answer"] == "elliptic"  # the group that isana is in
    assert asked["touches"]


def _said(**expected: Any) -> Check:
    """The first result has these values."""

    def check(folder: Path, results: list[Any]) -> None:
        assert {name: results[0][name] for name in expected} == expected

    return check


def _ros_bridge(folder: Path, results: list[Any]) -> None:
    (sensor,) = results[0]["sensors"]
    truth = [float(row["force_N"]) for row in rows(folder / "truth.csv")][::4]
    assert (sensor["name"], sensor["frames"], sensor["damaged"]) == ("foam", len(truth), 0)
    heard = json.loads((folder / "heard.json").read_text())
    assert max(heard) == pytest.approx(max(truth), rel=0.04)  # 2.5 % of a force, and a little for the JPEG


def _demo(folder: Path, results: list[Any]) -> None:
    for result in results:
        assert len(result["objects"]) == 3
        assert (folder / result["report"]).stat().st_size > 100_000


STORIES: dict[str, Story] = {
    "defaults": Story(lambda f, r: _defaults(f, r), _disc),
    "cameras": Story(lambda f, r: _cameras(r)),
    "sense foam": Story(_sense_foam, _scaled),
    "compare": Story(_compare, _compared),
    "sense scene": Story(_sense_scene, _scene),
    "track": Story(lambda f, r: _all_seen(r), _tags),
    "template check": Story(_template_check, _cover),
    "template sheet": Story(lambda f, r: _pdf(f / "tags.pdf")),
    "sense beam": Story(_sense_beam, _first_load),
    "calibrate foam": Story(_calibrate_foam, _press),
    "calibrate beam": Story(_said(rows=30), _loads),
    "calibrate camera": Story(_calibrate_camera, _photos),
    "calibrate stripe": Story(lambda f, r: _stripe(r), _gripper),
    "example foam": Story(_example_files("force_N"), around=_shorter),
    "example beam": Story(_example_files("fy_N"), around=_shorter),
    "example gripper": Story(_example_files("force_N", "grip.mp4"), around=_shorter),
    "example glass": Story(_example_glass),
    "example office": Story(_example_office),
    "example task": Story(_example_task),
    "map inspect": Story(lambda f, r: _office_size(r), _office),
    "map build": Story(_map_build, _scans),
    "map graph": Story(_map_graph, _office),
    "plan": Story(_plan, _office),
    "stiffness": Story(_stiffness),
    "squeeze": Story(_squeeze),
    "grasp": Story(_grasp),
    "reconstruct": Story(_reconstruct, _glass),
    "complete": Story(_complete, _holed),
    "objects add": Story(_objects_add, room="kitchen"),
    "objects show": Story(_said(id="cup-1"), room="kitchen", needs=("objects add",)),
    "objects list": Story(lambda f, r: _first(r, "objects"), room="kitchen", needs=("objects add",)),
    "objects search": Story(lambda f, r: _first(r, "found"), _more_objects, "search"),
    "objects export": Story(_said(exported=1), room="kitchen", needs=("objects add",)),
    "objects import": Story(_said(imported=1), room="kitchen", needs=("objects export",)),
    "objects sync": Story(_said(sent=1), room="kitchen", needs=("objects import",), around=_server),
    "objects build": Story(lambda f, r: _built(f), _classes),
    "reproduce": Story(lambda f, r: _reproduced(f)),
    "classify train": Story(_classify_train, _build, "classify", around=explored_less),
    "classify plan": Story(lambda f, r: _planned(r), room="classify", needs=("classify train",)),
    "classify run": Story(_classify_run, _curves, "classify", ("classify train",), around=_answers),
    "recording info": Story(lambda f, r: _recorded(r), _recording),
    "recording recover": Story(_said(recovered=1), _killed),
    "recording capture": Story(_said(frames=60), around=connected),
    "recording import": Story(_said(frames=5), _robot_arm),
    "view": Story(lambda f, r: _viewed(r), _to_view, around=_ctrl_c),
    "ros bridge": Story(_ros_bridge, _flatten("example foam"), around=_robot),
    "ros node": Story(lambda f, r: _nodes(r)),
    "ros launch": Story(lambda f, r: _launched(r)),
    "warmup": Story(lambda f, r: _warm(r), around=_few_kernels),
    "completion": Story(_said(shell="bash")),
    "doctor": Story(lambda f, r: _healthy(r), _own_robot, around=_few_libraries),
}

#: Verbs whose examples are run elsewhere, and where.
ELSEWHERE = {
    "demo": "make demo; the part that takes seconds below, the others longer than all examples here may",
    "start": "tests/cli/test_start.py, on a recording of its steps: a camera of this machine would see no foam",
    "ros echo": "tests/ros/test_topics.py, over zenoh: rclpy is not installed everywhere",
    "objects recognise": "tests/cli/test_objects_verbs.py, on rendered views of a small database",
}


def _all_seen(results: list[Any]) -> None:
    assert set(results[0]["seen"].values()) == {results[0]["frames"]}


def _cameras(results: list[Any]) -> None:
    assert isinstance(results[0]["cameras"], list)


def _defaults(folder: Path, results: list[Any]) -> None:
    assert (folder / "sensor.yaml").read_text().startswith("kind: foam")
    assert results[0]["kinds"]["robot"] == {"file": "robot.yaml", "verb": "plan"}
    settings = results[2]["settings"]
    assert [settings["radius_m"], settings["setup_time_s"]] == pytest.approx([0.31, 4.0])


def _pdf(path: Path) -> None:
    assert path.read_bytes().startswith(b"%PDF")


def _stripe(results: list[Any]) -> None:
    assert results[0]["mean_probability_on_stripe"] > 0.9


def _office_size(results: list[Any]) -> None:
    assert results[0]["components"] >= 1
    assert results[0]["share_unknown"] == 0
    assert min(results[0]["size_m"]) > 2


def _launched(results: list[Any]) -> None:
    assert {"foam", "platform"} <= results[0]["files"].keys()


def _nodes(results: list[Any]) -> None:
    assert {"foam", "beam", "scene"} <= results[0]["nodes"].keys()


def _first(results: list[Any], name: str) -> None:
    assert results[0][name][0]["id"] == "cup-1"


def _built(folder: Path) -> None:
    listed = json.loads((folder / "objects" / "manifest.json").read_text())["objects"]
    assert sorted(one["class"] for one in listed) == ["bottle", "bottle", "cup"]


def _reproduced(folder: Path) -> None:
    (found,) = (folder / "results" / "dissertation").glob("*/result.json")
    assert json.loads(found.read_text())


def _planned(results: list[Any]) -> None:
    assert results[0]["nodes"]


def _recorded(results: list[Any]) -> None:
    assert results[0]["topics"]


def _viewed(results: list[Any]) -> None:
    assert len(results[0]["views"]) == 3  # the plan is drawn on the map


def _warm(results: list[Any]) -> None:
    chosen = ["visuohaptic.sensing.foam", "visuohaptic.tracking.templates.alignment"]
    assert sorted(results[0]["seconds"]) == ["visuohaptic.navigation.graph.tracing", *chosen]
    assert sorted(results[1]["seconds"]) == chosen


def _healthy(results: list[Any]) -> None:
    assert results[0]["libraries"]["numpy"]["version"] == np.__version__
    assert len(results[1]["rules"]) > len(results[2]["rules"]) > 4


def test_every_verb_has_a_story() -> None:
    assert set(STORIES) | set(ELSEWHERE) == set(VERBS)


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_shows_an_example(verb: str) -> None:
    shown = examples(verb)
    assert shown
    assert all(
        " ".join(words).startswith(("example", verb, "calibrate", "sense", "reconstruct", "complete", "plan"))
        for words in shown
    )


@pytest.mark.parametrize("verb", STORIES)
def test_the_examples_run_and_their_numbers_hold(world: World, verb: str) -> None:
    folder, results = world.run(verb)
    assert len(results) == len(examples(verb))
    STORIES[verb].check(folder, results)


def test_the_short_example_of_the_demo_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the demo's examples the one that tells a part of a few seconds: the bottle."""
    monkeypatch.chdir(tmp_path)
    (words,) = (words for words in examples("demo") if words[:2] == ["demo", "bottle"])
    found = _call(words)
    assert found["complete"]
    assert [one["claim_is_true"] for one in found["chapters"]] == [True, True]
    assert (tmp_path / found["report"]).stat().st_size > 10_000
