"""The one loop of every verb that reads frames: source, sensor, sinks."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from ..core.errors import InputError

if TYPE_CHECKING:
    from ..core.camera.frame import Frame
    from ..core.camera.model import Camera
    from ..core.robots import FrameSource
    from ..sensing.readers.sensor_reader import SensorReader, SensorReading

__all__ = ["Outputs", "SensorRun", "add_part", "is_live", "opened_frames", "run_sensor", "zero_frames"]

Measured = TypeVar("Measured")


def add_part(parser: argparse.ArgumentParser) -> None:
    """Options for a part of a recording, and for the times of a folder that has none.

    Parameters
    ----------
    parser
        Of the verb.
    """
    parser.add_argument("--start", type=float, default=0.0, metavar="S", help="skip the first S seconds")
    parser.add_argument("--stop", type=float, default=float("inf"), metavar="S", help="stop after S seconds")
    parser.add_argument("--rate-Hz", type=float, dest="rate_Hz", help="rate of an image folder without times")


def is_live(source: str) -> bool:
    """Whether ``--source`` names a camera: it never ends, and must not wait for slow work.

    Parameters
    ----------
    source
        Text of ``--source``.
    """
    return source.startswith(("camera:", "uvc:"))


def opened_frames(args: Any, camera: Camera | None, *, grey: bool = False) -> FrameSource:
    """The frames of ``--source``, to be used as a context.

    Parameters
    ----------
    args
        With ``source``, ``start``, ``stop`` [s] and ``rate_Hz``.
    camera
        Model of the camera; the images must have its size.
    grey
        Deliver grey images, which is faster.
    """
    from ..io.frames.frames import open_source

    return open_source(
        args.source, camera=camera, start_s=args.start, stop_s=args.stop, rate_Hz=args.rate_Hz, grey=grey
    )


def zero_frames(args: Any) -> int:
    """``--zero-frames``, which not every verb has.

    Parameters
    ----------
    args
        As parsed.

    Raises
    ------
    InputError
        It is negative.
    """
    count: int = getattr(args, "zero_frames", 0)
    if count < 0:
        raise InputError("--zero-frames", f"found {count}, expected 0 or more")
    return count


@dataclass(frozen=True, slots=True)
class Outputs(Generic[Measured]):
    """How a verb shows what it measures; a recording needs nothing of it."""

    open_table: Callable[[Path], AbstractContextManager[Any]]  #: of --csv and --parquet; has ``write(row)``
    rows: Callable[[Measured], tuple[Any, ...]]  #: what a measurement is in the table
    page_title: str = "visuohaptic"
    #: keywords of :meth:`visuohaptic.viewer.LivePage.update` for a frame
    show: Callable[[Frame, Measured], Mapping[str, Any]] | None = None
    describe: Callable[[Measured], str] = lambda measured: ""  #: what is said beside an event


@dataclass(slots=True)
class SensorRun:
    """What became of the frames of a run."""

    reasons: Counter[str] = field(default_factory=Counter)
    events: list[dict[str, Any]] = field(default_factory=list)
    out: list[str] = field(default_factory=list)  #: files that were written

    @property
    def frames(self) -> int:
        """How many were read."""
        return sum(self.reasons.values())

    def text(self, also: str = "") -> str:
        """One line: frames, how many are valid, and why others are not.

        Parameters
        ----------
        also
            What else is said behind the number of valid frames.
        """
        others = "".join(f", {count} {reason}" for reason, count in self.reasons.items() if reason != "ok")
        return f"{self.frames} frames, {self.reasons['ok']} valid{also}{others}"


def run_sensor(
    args: Any,
    reader: SensorReader[Measured],
    frames: Iterator[Frame],
    outputs: Outputs[Measured],
    on_reading: Callable[[SensorReading[Measured]], None] = lambda reading: None,
) -> SensorRun:
    """Read every frame, record it, write its rows, show it and say its events.

    Parameters
    ----------
    args
        With ``out``, ``csv``, ``parquet``, ``view`` and ``zero_frames``, as far as the verb has them.
    reader
        The sensor.
    frames
        Of its camera; the first ``--zero-frames`` of them make the zero reference.
    outputs
        Table, rows and page of the verb.
    on_reading
        Told of every reading, for the verb's own summary.

    Raises
    ------
    InputError
        There is no zero reference, or no frame.
    """
    if count := zero_frames(args):
        reader.zero(islice(frames, count))
    reader.require_zero("give --zero-frames N")
    tables = [path for name in ("csv", "parquet") if (path := getattr(args, name, None))]
    run = SensorRun(out=[str(path) for path in (args.out, *tables) if path])
    with ExitStack() as stack:
        recording, page = _opened(args, stack, outputs)
        writers = [stack.enter_context(outputs.open_table(path)) for path in tables]
        for frame in frames:
            reading = reader.read(frame, recording)
            if recording is not None and reader.camera is not None and not run.frames:
                recording.write_camera(reader.camera, frame.t_s)
            run.reasons[reading.reason.value] += 1
            for writer in writers:
                for row in outputs.rows(reading.measured):
                    writer.write(row)
            for event in reading.events:
                described = f"{event.t_s:10.3f} s  {event.kind.value:8}  {outputs.describe(reading.measured)}"
                args.report(described.rstrip())
                run.events.append({"t_s": event.t_s, "event": event.kind.value})
            if page is not None and outputs.show is not None:
                page.update(frame.t_s, **outputs.show(frame, reading.measured))
            on_reading(reading)
    if not run.frames:
        raise InputError(
            args.source or "--poses",
            "no frames are left to measure",
            remedy="check --zero-frames, --start, --stop",
        )
    return run


def _opened(args: Any, stack: ExitStack, outputs: Outputs[Any]) -> tuple[Any, Any]:
    """Recording and live page, each ``None`` when it was not asked for."""
    recording = page = None
    if args.out:
        from ..io.sinks.mcap_out import MeasurementWriter

        recording = stack.enter_context(MeasurementWriter(args.out))
    if getattr(args, "view", False):
        from ..viewer.page import LivePage

        page = stack.enter_context(LivePage(title=outputs.page_title))
        args.report(f"live page: {page.url}")
        page.show()
    return recording, page
