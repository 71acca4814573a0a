"""An hour of a node over DDS: memory, handles and threads, with peers that are killed and malformed messages.

    python -m benchmarks.ros_soak                                  a slice of two minutes
    python -m benchmarks.ros_soak --minutes 60 --report hour.jsonl

The node is a separate process (``visuohaptic ros node foam``), fed with rendered raw images of 1600 x 896 at 10 Hz, which is
sufficient for the sensor to distinguish a contact from an occluder. Killed peers and malformed messages are spread evenly over the
time. Before the first minute the node gets images faster than it reads them, and is stopped for a second, several times: it keeps
the memory of as many images as its queue and those of the middleware have held at once, and the memory that a camera shares with the node (33.6 MB) becomes part of
the node's memory as far as images have ever waited in it. A row per minute is stored with the number of the node's process; an
interrupted run continues with a new process, and growth is reported for each process separately. The figures start after the
first two minutes of a process, when its buffers and adaptive models are filled.

The memory of the node's own is called flat if the upper 95 % limit of its slope is below one image (1.43 MB) an hour: an image is
the smallest amount that a leak of images loses, and by which fragmentation grows. The slope is that of a line through the second half
of a process's minutes: a leak continues, while queues and caches are filled once. Its standard error follows from the residuals. Memory that is shared with cameras is apart: it has a fixed size for each camera, and
that of a killed one is released when DDS has missed it for 20 s.
"""

from __future__ import annotations

import argparse
import itertools
import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from visuohaptic.io.ros import ros_messages as messages
from visuohaptic.ros.transports import RclpyNode, RosOptions
from visuohaptic.ros.wire import Qos

from ._journal import Journal
from .ros_latency import KIND, PATIENCE_S, TOPIC, Heard, Malformed, Node, kill_a_peer, pictures
from .soak import FLAT_MB

__all__ = ["IMAGE_MB", "STOPS", "campaign", "run"]

RATE_HZ = 10.0
#: How often the node is stopped before the first minute.
STOPS = 10
#: Images that arrive before and meanwhile: more than its queue of ten, and 23 fill the memory that the camera shares with it (``fastdds.xml``).
BURST = 30
#: Minutes of a process before its figures count.
WARM = 2
#: Memory of one image [MB].
IMAGE_MB = 1600 * 896 / 1e6


class Campaign:
    """A node, its camera and its adversaries."""

    def __init__(self, folder: Path, domain: int, camera: RclpyNode, rate_Hz: float) -> None:
        self.rate_Hz = rate_Hz
        self.images = pictures(folder, 30)
        self.node = Node(folder, domain)
        self.domain = domain
        self.heard = Heard(camera)
        self._camera = camera.advertise(TOPIC, KIND, Qos(reliable=False, depth=5))
        self.heard.wait(1, PATIENCE_S)  # stale: it runs
        self._camera.wait_until_heard(PATIENCE_S)
        self._malformed = Malformed(camera)
        self._rng = np.random.default_rng(3)
        self._number = 0
        self._fill_queues()

    def _publish(self) -> int:
        """The next image; returns its time stamp [ns]."""
        now_s = time.time()
        order = [*range(len(self.images)), *range(len(self.images) - 2, 0, -1)]  # forwards and backwards
        image = self.images[order[self._number % len(order)]]
        # New noise: an identical image would be stale.
        image[0] ^= self._rng.integers(0, 2, image.shape[1], np.uint8)
        self._camera.publish(messages.image(now_s, image, "bumper"))
        self._number += 1
        return messages.stamp_ns(now_s)

    def _fill_queues(self) -> None:
        """Send images faster than the node reads them, to it and while it is stopped: its queue and the middleware's are full at once."""
        for _ in range(STOPS):
            for signal_, pause_s in ((signal.SIGCONT, 0.02), (signal.SIGSTOP, 0.05)):
                self.node.process.send_signal(signal_)
                for _ in range(BURST):
                    self._publish()
                    time.sleep(pause_s)
            self.node.process.send_signal(signal.SIGCONT)
            time.sleep(1.0)

    def images_of(self, seconds: float, malformed: int = 0) -> list[int]:
        """Publish images, and malformed ones evenly between them; returns the time stamps [ns]."""
        ticks, sent, spoilt = round(seconds * self.rate_Hz), [], 0
        begin = time.perf_counter()
        for tick in range(ticks):
            time.sleep(max(0.0, begin + tick / self.rate_Hz - time.perf_counter()))
            sent.append(self._publish())
            while spoilt < malformed * (tick + 1) // ticks:
                self._malformed.send()
                spoilt += 1
        return sent

    def minute(self, kills: int, malformed: int) -> dict[str, Any]:
        """One minute of images with its fraction of the faults; returns the received wrenches and the node's resource usage."""

        def kill() -> None:
            for _ in range(kills):
                kill_a_peer(self.domain)

        killer = threading.Thread(target=kill)
        killer.start()
        sent = self.images_of(60.0, malformed)
        killer.join()
        time.sleep(1.0)
        answered = [self.heard.take(stamp) for stamp in sent]
        alive = self.node.alive()
        return {
            "process": self.node.process.pid,
            "sent": len(sent),
            "answered": sum(found is not None for found in answered),
            "valid": sum(found is not None and found.valid for found in answered),
            "killed": kills,
            "malformed": malformed,
            "alive": alive,
            **(
                self.node.use()
                if alive
                else dict.fromkeys(("memory_MB", "shared_MB", "handles", "threads", "cpu_s"), 0)
            ),
        }


@contextmanager
def campaign(domain: int, rate_Hz: float) -> Iterator[Campaign]:
    with tempfile.TemporaryDirectory() as folder, RclpyNode("camera", RosOptions(domain=domain)) as camera:
        made = Campaign(Path(folder), domain, camera, rate_Hz)
        try:
            yield made
        finally:
            code = made.node.end()
        if code:
            raise SystemExit(f"the node has ended with exit code {code}")


def run(
    minutes: int = 2,
    kills: int = 4,
    malformed: int = 60,
    report: Path | None = None,
    domain: int = 101,
    rate_Hz: float = RATE_HZ,
) -> list[dict[str, Any]]:
    """Rows of the table; kills and malformed messages are those of the whole time."""
    about = {
        "campaign": "ros soak",
        "minutes": minutes,
        "rate_Hz": rate_Hz,
        "kills": kills,
        "malformed": malformed,
    }
    journal = Journal(report, about)
    missing = [number for number in range(minutes) if str(number) not in journal]
    if missing:
        with campaign(domain, rate_Hz) as running:
            for number in missing:
                part = [
                    total * (number + 1) // minutes - total * number // minutes
                    for total in (kills, malformed)
                ]
                journal.put(str(number), running.minute(*part))
                if not running.node.alive():
                    break
    return _rows(list(journal.rows.values()))


def _rows(found: list[dict[str, Any]]) -> list[dict[str, Any]]:
    total = {
        name: sum(row[name] for row in found) for name in ("sent", "answered", "valid", "killed", "malformed")
    }
    processes = {row["process"] for row in found}
    rows = [
        {"name": "crashes of the node", "ours": sum(not row["alive"] for row in found), "unit": "1", "floor": 0,
         "higher_is_better": False,
         "note": f"{len(found)} min in {len(processes)} process(es), {total['killed']} peers killed, "
         f"{total['malformed']} malformed messages"},
        {"name": "images without a wrench", "ours": total["sent"] - total["answered"], "unit": "1",
         "note": f"of {total['sent']}; {total['valid']} wrenches valid"},
    ]  # fmt: skip
    for name, said, unit, floor in (
        ("memory_MB", "memory", "MB", FLAT_MB),
        ("shared_MB", "memory shared with cameras", "MB", None),
        ("handles", "handles", "1", None),
        ("threads", "threads", "1", None),
    ):
        growth, ends = 0.0, []
        for process in sorted(processes):
            path = [row[name] for row in found if row["process"] == process][WARM:]
            if path:
                growth = max(growth, max(path) - path[0])
                ends.append(f"{path[0]:.0f} -> {path[-1]:.0f}, at most {max(path):.0f}")
        rows.append(
            {"name": f"growth of {said}", "ours": growth, "unit": unit, "floor": floor,
             "higher_is_better": False, "note": "; ".join(ends)}
        )  # fmt: skip
    paths = [
        [row["memory_MB"] - row["shared_MB"] for row in found if row["process"] == process]
        for process in processes
    ]
    steady = [path[max(WARM, len(path) // 2) :] for path in paths]
    if slopes := [slope_MB_h(path) for path in steady if len(path) > 2]:
        upper, slope, error = max((upper, slope, error) for slope, error, upper in slopes)
        rows.append(
            {"name": "slope of its own memory, upper 95 % limit", "ours": upper, "unit": "MB/h", "floor": IMAGE_MB,
             "higher_is_better": False,
             "note": f"{slope:.2f} +- {error:.2f} (standard error): {'flat' if upper < IMAGE_MB else 'not shown to be flat'}, "
             f"the limit is an image an hour ({IMAGE_MB:.2f} MB/h)"}
        )  # fmt: skip
    spent = [b["cpu_s"] - a["cpu_s"] for a, b in itertools.pairwise(found) if a["process"] == b["process"]]
    if spent:
        rows.append(
            {"name": "CPU time of a minute", "ours": float(np.median(spent)), "unit": "s", "note": "median"}
        )
    return rows


def slope_MB_h(memory_MB: list[float]) -> tuple[float, float, float]:
    """Slope of a line through the minutes, its standard error, and its one-sided upper 95 % limit [MB/h]."""
    line = stats.linregress(np.arange(len(memory_MB)) / 60.0, memory_MB)
    upper = line.slope + stats.t.ppf(0.95, len(memory_MB) - 2) * line.stderr
    return float(line.slope), float(line.stderr), float(upper)


def main() -> int:
    """Run it and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=int, default=2)
    parser.add_argument("--kill", type=int, metavar="N", help="peers that are killed (100 an hour)")
    parser.add_argument("--malformed", type=int, metavar="N", help="messages that are none (2000 an hour)")
    parser.add_argument("--report", type=Path, help="JSON lines; a stopped run goes on where it was")
    parser.add_argument("--rate", type=float, default=RATE_HZ, help="images a second")
    parser.add_argument("--domain", type=int, default=101)
    args = parser.parse_args()
    kills = -(-100 * args.minutes // 60) if args.kill is None else args.kill
    malformed = -(-2000 * args.minutes // 60) if args.malformed is None else args.malformed
    rows = run(args.minutes, kills, malformed, args.report, args.domain, args.rate)
    for row in rows:
        print(f"{row['name']:42s} {row['ours']:8.1f} {row['unit']:4s} {row.get('note', '')}")
    return int(rows[0]["ours"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
