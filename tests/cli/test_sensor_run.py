"""The loop of all verbs that read frames, with a sensor that records its calls."""

from __future__ import annotations

from argparse import Namespace
from contextlib import contextmanager

import numpy as np
import pytest

from visuohaptic.cli._console import Console
from visuohaptic.cli._sensor_run import Outputs, force_text, is_live, run_sensor
from visuohaptic.cli.main import main
from visuohaptic.core import ErrorBudget, Event, EventKind, ForceProfile, InputError, Reason
from visuohaptic.core.camera import Frame
from visuohaptic.io import TableWriter
from visuohaptic.sensing import SensorReader, SensorReading


class Counting(SensorReader[int]):
    """Measures the number of the frame; every third one cannot be trusted."""

    kind, camera, zeroed = "foam", None, False

    def __init__(self):
        super().__init__("counting")
        self.zero_of = []

    def zero(self, frames):
        self.zero_of = [frame.index for frame in frames]
        self.zeroed = True

    def read(self, frame, sink=None):
        events = (Event(EventKind.CONTACT, frame.t_s),) if frame.index == 5 else ()
        return SensorReading(frame.index, Reason.OK if frame.index % 3 else Reason.OCCLUDED, events)

    def blank(self, t_s, sink):
        raise AssertionError("a recording never falls silent")


class Table(list):
    write = list.append


def run(count, *, zero=0, reader=None):
    """Frames, zero and table; returns the run, the rows, what was read and what was said."""
    rows, said, read = Table(), [], []

    @contextmanager
    def table(path):
        rows.append(path)
        yield rows

    frames = iter(Frame(np.zeros((2, 2), np.uint8), 0.1 * i, i) for i in range(count))
    args = Namespace(out=None, csv="t.csv", zero_frames=zero, source="video", report=said.append)
    outputs = Outputs(table, rows=lambda number: (number, -number), describe=lambda number: f"at {number}")
    done = run_sensor(
        args, reader or Counting(), frames, outputs, lambda reading: read.append(reading.measured)
    )
    return done, rows, read, said


def test_every_frame_after_the_zero_is_read_written_and_counted():
    reader = Counting()
    done, rows, read, said = run(8, zero=2, reader=reader)
    assert reader.zero_of == [0, 1]
    assert read == [2, 3, 4, 5, 6, 7]
    assert rows == ["t.csv", 2, -2, 3, -3, 4, -4, 5, -5, 6, -6, 7, -7]
    assert done.reasons == {"ok": 4, "occluded": 2}
    assert done.text(", 1 lucky") == "6 frames, 4 valid, 1 lucky, 2 occluded"
    assert done.events == [{"t_s": 0.5, "event": "contact"}]
    assert said == ["     0.500 s  contact   at 5"]
    assert done.out == ["t.csv"]


def test_no_zero_and_no_frames_are_refused():
    with pytest.raises(InputError, match=r"no zero reference.*sense foam \.\.\. --zero.*--zero-frames N"):
        run(3)
    with pytest.raises(InputError, match="video: no frames are left to measure"):
        run(2, zero=2)


def test_files_of_an_earlier_run_stay_where_no_frame_can_be_read(tmp_path):
    """A source of another encoding fails at its first frame: the earlier table is not replaced by a header."""
    table = tmp_path / "run.csv"
    table.write_text("t_s,valid\n0.0,True\n")

    def frames():
        raise InputError("bag", "another encoding")
        yield

    args = Namespace(out=tmp_path / "run.mcap", csv=table, source="bag", report=print)
    reader = Counting()
    reader.zero([])
    with pytest.raises(InputError, match="another encoding"):
        run_sensor(args, reader, frames(), Outputs(TableWriter, rows=lambda number: ()))
    assert table.read_text() == "t_s,valid\n0.0,True\n"
    assert list(tmp_path.iterdir()) == [table]


def test_a_number_of_frames_is_none_or_more(capsys):
    assert main(["sense", "foam", "--config", "f.yaml", "--source", "v.mp4", "--zero-frames", "-1"]) == 2
    assert "--zero-frames: found -1" in capsys.readouterr().err


def test_a_camera_is_live_and_a_file_is_not():
    assert is_live("camera:0")
    assert is_live("uvc:0")
    assert not is_live("camera.mp4")
    assert is_live("0")
    assert is_live("/dev/video0")
    assert is_live("rtsp://robot/front")
    assert not is_live("0.mp4")


def test_ctrl_c_ends_a_live_run_with_its_rows_and_its_summary(capsys):
    """A camera never ends by itself: what was measured until then is kept."""
    rows = Table()

    @contextmanager
    def table(path):
        yield rows
        rows.append("closed")

    def frames():
        for index in range(3):
            yield Frame(np.zeros((2, 2), np.uint8), 1.0 * index, index)
        raise KeyboardInterrupt

    args = Namespace(out=None, csv="t.csv", source="0", report=print, console=Console())
    reader = Counting()
    reader.zeroed = True
    outputs = Outputs(table, rows=lambda number: (number,), describe=lambda number: f"{number} N")
    done = run_sensor(args, reader, frames(), outputs)
    assert (done.frames, rows) == (3, [0, 1, 2, "closed"])
    assert "0 N" in capsys.readouterr().err
    args.source = "push.mp4"
    with pytest.raises(KeyboardInterrupt):
        run_sensor(args, reader, frames(), outputs)


@pytest.mark.parametrize("zero_frames", [0, 3])
def test_ctrl_c_before_the_first_frame_says_that_the_camera_sent_none(zero_frames):
    def frames():
        yield from ()
        raise KeyboardInterrupt

    class Zeroing(Counting):
        def zero(self, found):
            list(found)

    args = Namespace(
        out=None, csv="t.csv", source="0", report=print, console=Console(), zero_frames=zero_frames
    )
    reader = Zeroing()
    reader.zeroed = True
    outputs = Outputs(None, rows=lambda number: (number,), describe=str)
    with pytest.raises(InputError, match=r"^0: was stopped before its first frame was measured; check"):
        run_sensor(args, reader, frames(), outputs)
    args.source = "push.mp4"
    with pytest.raises(KeyboardInterrupt):
        run_sensor(args, reader, frames(), outputs)


def test_the_recording_that_import_writes_is_known_to_info(tmp_path, capsys):
    import json

    from visuohaptic.cli.main import main
    from visuohaptic.core.camera import Camera, Pose
    from visuohaptic.io.depth import DepthFrame, write_sequence

    camera = Camera.simple(32, 24, 30.0)
    frames = [
        DepthFrame(0.5 * k, np.full((24, 32), 0.8, np.float32), None, Pose.identity(), camera, k)
        for k in range(3)
    ]
    write_sequence(tmp_path / "scan", frames)
    assert main(["recording", "info", str(tmp_path / "scan"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["kind"], found["frames"], found["duration_s"]) == ("depth sequence", 3, 1.0)
    assert (found["width"], found["height"]) == (32, 24)


@pytest.mark.parametrize(("force_N", "blocks"), [(2.0, 8), (9.9, 40), (200.0, 40)])
def test_a_bar_has_a_block_per_quarter_newton_up_to_ten_newtons(force_N, blocks):
    k = np.zeros(3)
    budget = ErrorBudget(0.01, 0.0, 0.0, 0.0)
    profile = ForceProfile(0.0, True, Reason.OK, force_N, budget, k, k, k, k, k, np.ones(3, bool))
    assert force_text(profile).count("\u2588") == blocks


@pytest.mark.parametrize("verb", ["foam", "beam"])
def test_what_zero_would_not_write_is_refused(verb, tmp_path, capsys):
    words = ["--config", str(tmp_path / "sensor.yaml"), "--source", str(tmp_path / "rest.mp4"), "--zero"]
    assert main(["sense", verb, *words, "--csv", str(tmp_path / "run.csv")]) == 2
    assert "--csv: found with --zero, which ends after the zero reference" in capsys.readouterr().err
