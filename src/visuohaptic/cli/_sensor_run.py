"""The loop of every verb that reads frames: source, sensor, sinks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import dataclass, field
from itertools import chain, islice
from math import nan
from pathlib import Path
from typing import Any, Generic, TypeVar

from .. import core, io, report, sensing, viewer
from ..core import files
from ..core.errors import InputError
from ._console import NO_RESULT

Measured = TypeVar("Measured")

#: Longest bar of a force [characters].
_BAR = 40


def add_run_arguments(add: Any, *, parquet: str = "", zero_frames: str = "") -> None:
    """Options of a run: outputs, the part of a recording to read, and the frames of the zero reference.

    Parameters
    ----------
    add
        Of the verb.
    parquet, zero_frames
        Help of ``--parquet`` and ``--zero-frames``, for verbs that have them.
    """
    add("--out", Path, "MCAP recording to write")
    add("--csv", Path, "CSV table to write")
    add("--plot", Path, "plot over time to write: .png, .pdf or .svg")
    if parquet:
        add("--parquet", Path, parquet)
    if zero_frames:
        add("--zero-frames", 0, zero_frames, metavar="N", low=0)
    add("--start", 0.0, "skip the first S seconds", metavar="S")
    add("--stop", float("inf"), "stop after S seconds", metavar="S")
    add("--rate-Hz", float, "frame rate of an image folder without time stamps")


def check_zero_alone(args: Any) -> None:
    """Refuse files that ``--zero`` would not write, since it stops before the measurement.

    Parameters
    ----------
    args
        With ``zero``.
    """
    if args.zero:
        said = "found with --zero, which ends after the zero reference"
        args.refuse(
            "--out --csv --parquet --plot --page --against", said, "measure without --zero afterwards"
        )


def is_live(source: str) -> bool:
    """Whether ``--source`` names a live camera, which has no end and loses frames if reading is delayed.

    Parameters
    ----------
    source
        Text of ``--source``.
    """
    from ..io.frames.live import camera_of

    return camera_of(source) is not None


def opened_frames(args: Any, camera: core.Camera | None, *, grey: bool = False) -> core.FrameSource:
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

    return io.open_source(
        args.source, camera=camera, start_s=args.start, stop_s=args.stop, rate_Hz=args.rate_Hz, grey=grey
    )


def shown_frames(args: Any, source: core.FrameSource, doing: str) -> Iterator[core.Frame]:
    """Frames of a recording with a progress display, or of a camera.

    Parameters
    ----------
    args
        With ``source``.
    source
        From :func:`opened_frames`.
    doing
        The activity, in one word.
    """
    return iter(source if is_live(str(args.source)) else args.progress(source, doing))


@dataclass(frozen=True, slots=True)
class Outputs(Generic[Measured]):
    """How a verb displays and tabulates its measurements."""

    open_table: Callable[[Path], AbstractContextManager[Any]]  #: of --csv and --parquet; has ``write(row)``
    rows: Callable[[Measured], tuple[Any, ...]]  #: what a measurement is in the table
    page_title: str = "visuohaptic"
    #: keywords of :meth:`visuohaptic.viewer.LivePage.update` for a frame
    show: Callable[[core.Frame, Measured], Mapping[str, Any]] | None = None
    describe: Callable[[Measured], str] = lambda measured: ""  #: text beside an event
    #: what --plot draws of a measurement: by the label of the axes and the name of the line, value and sigma,
    #: NaN where they are not known
    chart: Callable[[Measured], Mapping[str, Mapping[str, tuple[float, float]]]] = lambda measured: {}


@dataclass(slots=True)
class SensorRun:
    """Result of a run over frames."""

    reasons: Counter[str] = field(default_factory=Counter)
    events: list[dict[str, Any]] = field(default_factory=list)
    out: list[str] = field(default_factory=list)  #: files that were written

    @property
    def frames(self) -> int:
        """Number of frames that were read."""
        return sum(self.reasons.values())

    def text(self, also: str = "") -> str:
        """One line: number of frames, valid frames, and reasons of invalid ones.

        Parameters
        ----------
        also
            Text after the number of valid frames.
        """
        others = "".join(f", {count} {reason}" for reason, count in self.reasons.items() if reason != "ok")
        return f"{self.frames} frames, {self.reasons['ok']} valid{also}{others}"


def run_sensor(
    args: Any,
    reader: sensing.SensorReader[Measured],
    frames: Iterator[core.Frame],
    outputs: Outputs[Measured],
    on_reading: Callable[[sensing.SensorReading[Measured]], None] = lambda reading: None,
    *,
    live: bool = False,
) -> SensorRun:
    """Read every frame, record it, write its rows, display it and print its events.

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
        Called with every reading, for the verb's own summary.
    live
        Show every reading on one line of the terminal, and let Ctrl-C end the run like the end of a recording.
        Implied for a camera.

    Raises
    ------
    InputError
        There is no zero reference, or no frame.
    """
    live = live or is_live(str(args.source or ""))
    # Before any file is opened: none is replaced by an empty one.
    first = _first_frame(args, reader, frames, live)
    tables = [path for name in ("csv", "parquet") if (path := getattr(args, name, None))]
    plot: Path | None = getattr(args, "plot", None)
    run = SensorRun(out=[str(path) for path in (args.out, *tables, plot) if path])
    drawn: list[tuple[float, Mapping[str, Any], str]] = []
    events: list[core.Event] = []
    with ExitStack() as stack:
        recording, page = _opened(args, stack, outputs)
        writers = [stack.enter_context(outputs.open_table(path)) for path in tables]
        line = stack.enter_context(args.console.line()) if live else None
        stack.enter_context(suppress(*([KeyboardInterrupt] if live else [])))
        for frame in chain([first], frames):
            reading = reader.read(frame, recording)
            if recording is not None and reader.camera is not None and not run.frames:
                recording.write_camera(reader.camera, frame.t_s)
            run.reasons[reading.reason.value] += 1
            for writer in writers:
                for row in outputs.rows(reading.measured):
                    writer.write(row)
            for event in reading.events:
                described = f"{event.t_s:10.3f} s  {event.kind.value:8}  {outputs.describe(reading.measured)}"
                if line is not None:
                    line.end()
                args.report(described.rstrip())
                run.events.append({"t_s": event.t_s, "event": event.kind.value})
            if line is not None:
                line.show(f"{frame.t_s:10.1f} s  {outputs.describe(reading.measured)}")
            if page is not None and outputs.show is not None:
                page.update(frame.t_s, **outputs.show(frame, reading.measured))
            if plot is not None:
                drawn.append((frame.t_s, outputs.chart(reading.measured), reading.reason.value))
                events.extend(reading.events)
            on_reading(reading)
        if page is not None and not live and run.frames:
            _hold_open(args)
    if drawn and plot is not None:
        _save_plot(plot, drawn, events, outputs.page_title)
    if not run.reasons["ok"]:
        args.exit_code = NO_RESULT
    return run


def _first_frame(
    args: Any, reader: sensing.SensorReader[Measured], frames: Iterator[core.Frame], live: bool
) -> core.Frame:
    """The first frame after those of the zero reference."""
    source = args.source or "--poses"
    try:
        if count := getattr(args, "zero_frames", 0):  # not every verb has it
            reader.zero(islice(frames, count))
        reader.require_zero("give --zero-frames N")
        first = next(frames, None)
    except KeyboardInterrupt as stopped:
        if not live:
            raise
        text = "was stopped before its first frame was measured"
        raise InputError(source, text, remedy="check that the camera sends images") from stopped
    if first is None:
        remedy = "check --zero-frames, --start, --stop"
        raise InputError(source, "no frames are left to measure", remedy=remedy)
    return first


def _hold_open(args: Any) -> None:
    """Keep the page of a finished recording until Ctrl-C, if a person can press it."""
    import sys
    import threading

    if sys.stdin.isatty() and sys.stdout.isatty():
        args.report("end of the recording; press Ctrl-C to close the page")
        with suppress(KeyboardInterrupt):
            threading.Event().wait()


def _save_plot(
    path: Path,
    drawn: Sequence[tuple[float, Mapping[str, Any], str]],
    events: Sequence[core.Event],
    title: str,
) -> None:
    """Time, quantities and reason of each frame as a figure."""
    import numpy as np

    times_s, charts, reasons = zip(*drawn, strict=True)
    panels = {
        label: [
            report.TimeSeries(name, *np.array([chart[label][name] for chart in charts]).T) for name in names
        ]
        for label, names in charts[0].items()
    }
    figure = report.traces_over_time(np.array(times_s), panels, reasons=reasons, events=events, title=title)
    files.save_figure(path, figure, dpi=150)


def force_text(profile: core.ForceProfile) -> str:
    """Force with its sigma and a bar, or why there is none.

    Parameters
    ----------
    profile
        Of a foam sensor.
    """
    if not profile.valid:
        return f"no force: {profile.reason.value}"
    blocks = min(_BAR, round(4 * profile.force_N))  # 0.25 N each
    return f"{profile.force_N:7.3f} N +- {profile.force_sigma_N:.3f} N  {blocks * chr(0x2588)}"


def force_outputs() -> Outputs[core.ForceProfile]:
    """Table, page and text of a foam sensor."""
    return Outputs(
        io.TableWriter,
        rows=lambda profile: (profile,),
        page_title="foam sensor",
        show=lambda frame, profile: {"frame_bgr": frame.image, "profile": profile},
        describe=lambda profile: force_text(profile).rstrip(),
        chart=lambda profile: {
            "force [N]": {"force": (profile.force_N if profile.valid else nan, profile.force_sigma_N)}
        },
    )


def _opened(args: Any, stack: ExitStack, outputs: Outputs[Any]) -> tuple[Any, Any]:
    """Recording and live page, each ``None`` when it was not asked for."""
    recording = page = None
    if args.out:
        recording = stack.enter_context(io.MeasurementWriter(args.out))
    if getattr(args, "view", False):
        page = stack.enter_context(viewer.LivePage(title=outputs.page_title))
        args.report(f"live page: {page.url}")
        page.show()
    return recording, page
