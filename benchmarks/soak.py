"""One hour of frames through the whole sensing chain, as fast as possible: does the memory grow?

A push is rendered once, compressed, and played forwards and backwards repeatedly: load, unload, rest. Every second
frame is used on the way forwards and the others on the way backwards, because a frame that is repeated soon is rejected as stale.
The clock of the frames runs on at 30 Hz. Every frame is decoded, its foam, surroundings and templates are read, contacts
and events are tracked, and the measurements are written to an MCAP file, as on a robot that records.

    python -m benchmarks soak                   a slice of one minute
    python -m benchmarks.soak --hours 4 --report soak.jsonl
                                                slices of ten minutes of camera time, 18,000 frames each; resumable

Prints the memory growth, open files and threads, and CPU time per frame.
"""

from __future__ import annotations

import argparse
import gc
import os
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from visuohaptic.core.camera import Frame
from visuohaptic.io.sinks import MeasurementWriter
from visuohaptic.sensing.push import ContactEvents
from visuohaptic.sensing.scene import SceneTracker
from visuohaptic.tracking.templates import TemplateTracker

from ._journal import Journal
from .chain import Recording, record

__all__ = ["Soak", "run"]

_RATE_HZ, _SEED = 30.0, 20161123
#: Frames until caches, pools and adaptive models are filled: six pushes forwards and backwards.
_WARM = 420
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
    """Open files and threads of this process."""
    return len(os.listdir("/proc/self/fd")) + threading.active_count()


def _trim() -> None:
    """Return freed memory to the system, where the C library can; the remainder is in use."""
    import ctypes

    try:
        ctypes.CDLL("libc.so.6").malloc_trim(0)
    except (OSError, AttributeError):
        return


class Soak:
    """The chain and its counters; stores nothing that grows with the number of frames."""

    def __init__(self, recording: Recording, writer: MeasurementWriter) -> None:
        self._recording, self._writer = recording, writer
        self.sensor = recording.sensor
        self.sensor.reset()
        self._scene = SceneTracker.of_sensor(self.sensor.setup, rng=np.random.default_rng(_SEED))
        self._templates = TemplateTracker(recording.templates, self.sensor.setup.camera, threaded=False)
        self._events = ContactEvents()
        self.reasons: Counter[str] = Counter()
        self.events = self.frames = 0

    def step(self) -> None:
        """Next frame, from its JPEG to the file."""
        import cv2

        files, states = self._recording.files, self._recording.states
        place = 2 * self.frames % (2 * len(files))
        place = place if place < len(files) else 2 * len(files) - 1 - place
        t_s = self.frames / _RATE_HZ
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


def soak(
    frames: int | None = None, seconds: float | None = None
) -> tuple[Soak, list[tuple[int, float, int]], float]:
    """Run a number of frames, or for a time; returns the chain, (frame, MB, handles) over time, and CPU time per frame [s]."""
    import cv2

    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        recording = record(folder)
        with MeasurementWriter(Path(folder) / "soak.mcap", chunk_bytes=1 << 16) as writer:
            chain = Soak(recording, writer)
            for _ in range(_WARM):
                chain.step()
            path = [(chain.frames, resident_MB(), handles())]
            begin_s, cpu_s = time.monotonic(), time.process_time()
            every = 200 if frames is None else max(200, frames // 100)
            while (frames is None or chain.frames < _WARM + frames) and (
                seconds is None or time.monotonic() - begin_s < seconds
            ):
                chain.step()
                if chain.frames % every == 0:
                    path.append((chain.frames, resident_MB(), handles()))
            path.append((chain.frames, resident_MB(), handles()))
            spent_s = (time.process_time() - cpu_s) / max(1, chain.frames - _WARM)
    return chain, path, spent_s


def rows(chain: Soak, path: list[tuple[int, float, int]], spent_s: float) -> list[dict[str, Any]]:
    """Growth of the memory, and its linear extrapolation to an hour."""
    number, memory, _ = np.array(path).T
    growth = float(memory.max() - memory[0])
    frames = chain.frames - _WARM
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


def one_slice(frames: int) -> dict[str, Any]:
    """Growth during a slice, as a row of the report."""
    chain, path, spent_s = soak(frames=frames)
    _, memory, open_ = np.array(path).T
    return {
        "frames": chain.frames - _WARM,
        "growth_MB": float(memory.max() - memory[0]),
        "handles": int(open_[-1] - open_[0]),
        "reasons": dict(chain.reasons),
        "cpu_s_per_frame": spent_s,
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=float, default=1.0, help="of the camera's time (1)")
    parser.add_argument("--slice-minutes", type=float, default=10.0, help="of the camera's time (10)")
    parser.add_argument("--report", type=Path, help="JSON lines; a stopped campaign goes on where it was")
    args = parser.parse_args()
    frames = int(args.slice_minutes * 60 * _RATE_HZ)
    journal = Journal(args.report, {"campaign": "soak", "frames": frames})
    journal.fill(
        one_slice,
        {f"slice {number}": frames for number in range(round(60 * args.hours / args.slice_minutes))},
    )
    for key, row in journal.rows.items():
        print(key, row)


if __name__ == "__main__":
    main()
