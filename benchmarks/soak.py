"""Loops that run for hours, as fast as possible: do memory and handles grow?

- *chain*: a push is rendered once, compressed, and played forwards and backwards repeatedly: load, unload, rest. Every second
  frame is used on the way forwards and the others on the way backwards, because a frame that is repeated soon is rejected as stale.
  The clock of the frames runs on at 30 Hz. Every frame is decoded, its foam, surroundings and templates are read, contacts
  and events are tracked, and the measurements are written to an MCAP file, as on a robot that records.
- *bridge*: a camera publishes images to a bridge over zenoh and waits for each wrench. Every 50th time it also sends a truncated
  message, and every 100th time another node joins, subscribes and leaves.
- *page*: a live page with a connected browser is redrawn, at 10 Hz of its own clock: picture, force, strip and an obstacle; clients
  without the secret are refused in between.
- *mission*: the tasks of :mod:`benchmarks.mission_faults` under a supervisor, without a fault, each time in another world.

A node over DDS is tested by :mod:`benchmarks.ros_soak`.

    python -m benchmarks soak                   a slice of one minute of the chain
    python -m benchmarks.soak --hours 4 --report soak.jsonl
                                                slices of ten minutes of the loop's own time; resumable
    python -m benchmarks.soak --what bridge page mission --hours 0.5 --report soak.jsonl

Prints the memory growth, open files and threads, and CPU time per step.
"""

from __future__ import annotations

import argparse
import gc
import os
import queue
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import urlsplit

import numpy as np

from visuohaptic.core.camera import Frame, Pose
from visuohaptic.core.files.part_file import SYNC_S
from visuohaptic.core.measurement import ErrorBudget, ForceProfile, Reason
from visuohaptic.io.sinks import MeasurementWriter
from visuohaptic.sensing.push import ContactEvents
from visuohaptic.sensing.scene import SceneTracker
from visuohaptic.tracking.templates import TemplateTracker

from ._journal import Journal
from ._page_attacks import attack
from .chain import Recording, record

__all__ = ["FLAT_MB", "LOOPS", "Soak", "run"]

_RATE_HZ, _SEED = 30.0, 20161123
_HOUR = int(3600 * _RATE_HZ)
#: A slice that holds more memory at its end is not flat [MB].
FLAT_MB = 20.0


def resident_MB() -> float:
    """Memory of this process that is in use now [MB]."""
    gc.collect()
    _trim()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def handles() -> int:
    """Open files and threads of this process.

    Recordings are synced by a timer that ends within a second, and of which there is one or none at any moment: it is
    awaited, since otherwise a slice ends with one handle more or less than it began by chance.
    """
    for thread in threading.enumerate():
        if isinstance(thread, threading.Timer):
            thread.join(10.0 * SYNC_S)
    return len(os.listdir("/proc/self/fd")) + threading.active_count()


def _state(loop: Loop) -> tuple[int, float, int]:
    """Steps, memory in use [MB], and handles; these first, since they await threads that have memory of their own."""
    open_ = handles()
    return loop.frames, resident_MB(), open_


def _trim() -> None:
    """Return freed memory to the system, where the C library can; the remainder is in use."""
    import ctypes

    try:
        ctypes.CDLL("libc.so.6").malloc_trim(0)
    except (OSError, AttributeError):
        return


class Loop(Protocol):
    """Something that runs step by step and keeps nothing of the steps that are over."""

    warm: int  #: steps until caches, pools and adaptive models are filled
    frames: int  #: steps so far
    t_s: float  #: the loop's own time
    faults: int  #: requests that were answered, tasks that crashed
    reasons: Counter[str]  #: outcomes of the steps

    def step(self) -> None:
        """One step."""


class Soak:
    """The chain and its counters; stores nothing that grows with the number of frames."""

    warm = 420  # six pushes forwards and backwards

    def __init__(self, recording: Recording, writer: MeasurementWriter) -> None:
        self._recording, self._writer = recording, writer
        self.sensor = recording.sensor
        self.sensor.reset()
        self._scene = SceneTracker.of_sensor(self.sensor.setup, rng=np.random.default_rng(_SEED))
        self._templates = TemplateTracker(recording.templates, self.sensor.setup.camera, threaded=False)
        self._events = ContactEvents()
        self.reasons: Counter[str] = Counter()
        self.events = self.frames = self.faults = 0

    @property
    def t_s(self) -> float:
        """Time of the next frame."""
        return self.frames / _RATE_HZ

    def step(self) -> None:
        """Next frame, from its JPEG to the file."""
        import cv2

        files, states = self._recording.files, self._recording.states
        place = 2 * self.frames % (2 * len(files))
        place = place if place < len(files) else 2 * len(files) - 1 - place
        t_s = self.t_s
        image = np.asarray(cv2.imdecode(files[place], cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
        frame = Frame(image, t_s, self.frames)
        profile = self.sensor.read(frame)
        self._templates.update(frame)
        self._scene.update(frame, profile, states[place])
        self._writer.write_force(profile)
        for event in self._events.update(profile, speed_m_s=states[place].speed_m_s):
            self._writer.write_event(event)
            self.events += 1
        self.reasons[profile.reason.value] += 1
        self.frames += 1


class BridgeLoop:
    """A bridge, and a camera that waits for each answer."""

    warm = 232  # four presses forwards and backwards

    def __init__(self, camera: Any, images: list[np.ndarray], join: Callable[[], Any]) -> None:
        from visuohaptic.ros.wire import message_type

        from .ros_latency import KIND, TOPIC, WRENCH

        self._images, self._join, self._kind = [*images, *images[-2:0:-1]], join, message_type(KIND)
        self._rng, self._wrench = np.random.default_rng(_SEED), WRENCH
        self._answers: queue.Queue[tuple[int, bool]] = queue.Queue()
        camera.subscribe("/foam/wrench", WRENCH, self._hear)
        self._camera = camera.advertise(TOPIC, KIND, wait=True)
        self._camera.wait_until_heard(30.0)
        self.reasons: Counter[str] = Counter()
        self.frames = self.faults = 0

    def _hear(self, received: Any) -> None:
        force_N = received.message.wrench.force.x
        self._answers.put((round(received.t_s * _RATE_HZ), bool(np.isfinite(force_N))))

    @property
    def t_s(self) -> float:
        """Time of the next frame."""
        return self.frames / _RATE_HZ

    def step(self) -> None:
        """Next image, from the camera to its wrench."""
        from visuohaptic.io.ros import ros_messages as messages
        from visuohaptic.ros.wire.cdr import encode

        image = self._images[self.frames % len(self._images)]
        # New noise: an identical image would be stale.
        image[0] ^= self._rng.integers(0, 2, image.shape[1], np.uint8)
        self.frames += 1
        data = encode(messages.image(self.t_s, image, "bumper"), self._kind)
        if self.frames % 50 == 0:
            self._camera.send(data[: self._rng.integers(4, 1000)])
        if self.frames % 100 == 0:
            with self._join() as peer:
                peer.subscribe("/foam/wrench", self._wrench, lambda received: None)
        self._camera.send(data)
        try:
            while (answer := self._answers.get(timeout=10.0))[0] != self.frames:
                pass
            self.reasons["valid" if answer[1] else "not valid"] += 1
        except queue.Empty:
            self.faults += 1


class PageLoop:
    """A live page; a browser is connected."""

    warm = 1500  # more than the plot keeps

    def __init__(self, page: Any) -> None:
        self._page, self._rng = page, np.random.default_rng(_SEED)
        self.reasons: Counter[str] = Counter()
        self.frames = self.faults = 0
        self.t_s = 0.0

    def step(self) -> None:
        """A redraw, and every hundredth time a client that is refused."""
        s_m = np.linspace(-0.1, 0.1, 41)
        delta_m = np.abs(self._rng.normal(0.0, 2e-3, len(s_m)))
        ones, valid = np.ones(len(s_m)), self.frames % 7 > 0
        profile = ForceProfile(
            t_s=self.t_s, valid=valid, reason=Reason.OK if valid else Reason.OCCLUDED, force_N=float(delta_m.sum()),
            budget=ErrorBudget(image_N=0.01), s_m=s_m, delta_m=delta_m, delta_sigma_m=1e-5 * ones,
            pressure_Pa=5e5 * delta_m, pressure_sigma_Pa=50 * ones, point_valid=np.ones(len(s_m), bool),
        )  # fmt: skip
        pose = Pose(np.eye(3), np.array([self.t_s % 3.0, 0.0, 0.0]))
        self._page.set_obstacle("box", np.array([[0.0, 0.0], [0.2, 0.0], [0.2, 0.2], [0.0, 0.2]]), pose)
        image = self._rng.integers(0, 256, (120, 200, 3), np.uint8)
        drawn = self._page.update(
            frame_bgr=image, profile=profile, T_world_foam=pose, note=f"frame {self.frames}"
        )
        self.reasons["redrawn" if drawn else "not redrawn"] += 1
        if self.frames % 100 == 0:
            self.faults += attack(self._page.url, 4, self._rng)
        self.frames += 1
        self.t_s += 0.1


class MissionLoop:
    """The tasks, one after the other."""

    def __init__(self) -> None:
        from ._task_rigs import TASKS

        self._tasks, self.warm = TASKS, 3 * len(TASKS)
        self.reasons: Counter[str] = Counter()
        self.frames = self.faults = 0
        self.t_s = 0.0

    def step(self) -> None:
        """The next task."""
        from .mission_faults import try_task

        round_, number = divmod(self.frames, len(self._tasks))
        row = try_task(self._tasks[number], "none", 2 * round_, 0.0)
        self.reasons[f"{row['task']}: {row.get('outcome', 'crash')}"] += 1
        self.faults += "crash" in row
        self.frames += 1
        self.t_s += row.get("duration_s", 0.0)


@contextmanager
def _chain() -> Iterator[Soak]:
    import cv2

    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        recording = record(folder)
        with MeasurementWriter(Path(folder) / "soak.mcap", chunk_bytes=1 << 16) as writer:
            yield Soak(recording, writer)


@contextmanager
def _bridge() -> Iterator[BridgeLoop]:
    from tests.ports import free_port

    from visuohaptic.core.files import save_yaml
    from visuohaptic.ros import Bridge, RosNode, RosOptions

    from .ros_latency import TOPIC, pictures

    place = f"tcp/127.0.0.1:{free_port()}"
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        images = pictures(folder, 30)
        section = {"name": "foam", "config": "sensor.yaml", "image": TOPIC, "queue": 4}
        node = {"connect": [place], "listen": []}
        save_yaml(folder / "bridge.yaml", {"node": node, "sensors": [section], "stale_s": 60.0})
        camera = stack.enter_context(RosNode("camera", RosOptions(connect=(), listen=(place,))))
        stack.enter_context(Bridge.load(folder / "bridge.yaml"))
        yield BridgeLoop(camera, images, lambda: RosNode("peer", RosOptions(connect=(place,), listen=())))


@contextmanager
def _page() -> Iterator[PageLoop]:
    import viser
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    from visuohaptic.viewer import LivePage

    def listen(browser: Any) -> None:
        try:
            for _ in browser:
                pass
        except ConnectionClosed:
            return

    with ExitStack() as stack:
        page = stack.enter_context(LivePage(port=0, rate_hz=1e6))
        address = urlsplit(page.url)
        browser = stack.enter_context(
            connect(
                f"ws://{address.netloc}{address.path}",
                origin=f"http://{address.netloc}",
                subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
                max_size=None,
            )
        )
        threading.Thread(target=listen, args=(browser,), daemon=True).start()
        yield PageLoop(page)


@contextmanager
def _mission() -> Iterator[MissionLoop]:
    yield MissionLoop()


#: The loops by name.
LOOPS: dict[str, Callable[[], Any]] = {"chain": _chain, "bridge": _bridge, "page": _page, "mission": _mission}


def soak(
    what: str = "chain", *, loop_s: float | None = None, seconds: float | None = None
) -> tuple[Loop, list[tuple[int, float, int]], float]:
    """Run for a time of the loop's own, or of the clock; returns the loop, (step, MB, handles) over time, and CPU time per step [s]."""
    with LOOPS[what]() as loop:
        for _ in range(loop.warm):
            loop.step()
        path = [_state(loop)]
        begin_s, cpu_s, own_s = time.monotonic(), time.process_time(), loop.t_s
        every = loop.warm // 2
        while (loop_s is None or loop.t_s < own_s + loop_s) and (
            seconds is None or time.monotonic() - begin_s < seconds
        ):
            loop.step()
            if loop.frames % every == 0:
                path.append(_state(loop))
        path.append(_state(loop))
        spent_s = (time.process_time() - cpu_s) / max(1, loop.frames - loop.warm)
    return loop, path, spent_s


def rows(chain: Soak, path: list[tuple[int, float, int]], spent_s: float) -> list[dict[str, Any]]:
    """Growth of the memory, and its linear extrapolation to an hour."""
    number, memory, _ = np.array(path).T
    growth = float(memory.max() - memory[0])
    frames = chain.frames - chain.warm
    slope = float(np.polyfit(number, memory, 1)[0]) if len(path) > 2 else 0.0
    reasons = ", ".join(f"{count} {reason}" for reason, count in chain.reasons.most_common())
    return [
        {
            "name": f"memory growth, {frames} frames ({frames / _RATE_HZ / 60:.1f} min of the camera)",
            "ours": growth,
            "unit": "MB",
            "floor": FLAT_MB,
            "higher_is_better": False,
            "note": f"largest less first, of {memory[0]:.0f} MB; {reasons}; {chain.events} events; "
            f"{1e3 * spent_s:.1f} ms CPU time a frame",
        },
        {
            "name": "memory growth carried on to an hour",
            "ours": max(0.0, slope * _HOUR) if frames < _HOUR else growth,
            "unit": "MB",
            "floor": FLAT_MB,
            "higher_is_better": False,
            "note": "slope of a straight line; of a slice of minutes it is mostly noise"
            if frames < _HOUR
            else "measured",
        },
    ]


def run() -> list[dict[str, Any]]:
    """A slice of one minute."""
    return rows(*soak(seconds=60.0))


def one_slice(task: tuple[str, float]) -> dict[str, Any]:
    """Growth during a slice of a loop, as a row of the report."""
    what, minutes = task
    loop, path, spent_s = soak(what, loop_s=60.0 * minutes)
    _, memory, open_ = np.array(path).T
    return {
        "frames": loop.frames - loop.warm,
        "hours": minutes / 60.0,
        "growth_MB": float(memory.max() - memory[0]),
        "handles": int(open_[-1] - open_[0]),
        "reasons": dict(loop.reasons),
        "faults": loop.faults,
        "cpu_s_per_frame": spent_s,
    }


def main() -> None:
    """Run, or continue, the slices."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--what", nargs="+", choices=LOOPS, default=["chain"])
    parser.add_argument("--hours", type=float, default=1.0, help="of the loop's own time (1)")
    parser.add_argument("--slice-minutes", type=float, default=10.0, help="of the same (10)")
    parser.add_argument("--report", type=Path, help="JSON lines; a stopped campaign goes on where it was")
    args = parser.parse_args()
    journal = Journal(args.report, {"campaign": "soak", "slice_minutes": args.slice_minutes})
    tasks = {
        f"{what}, slice {number}": (what, args.slice_minutes)
        for number in range(
            max(1, round(60 * args.hours / args.slice_minutes))
        )  # a shorter time is one slice
        for what in args.what
    }
    journal.fill(one_slice, tasks)
    for key, row in journal.rows.items():
        print(key, row)


if __name__ == "__main__":
    main()
