"""The recorded mission: small, complete, and replayed in seconds without an extra."""

from __future__ import annotations

import importlib.util
import zipfile
from pathlib import Path

import numpy as np
import pytest

from visuohaptic.cli.main import main
from visuohaptic.core import ErrorBudget, ForceProfile, HapticTag, InputError, Pose, Reason
from visuohaptic.demo.recorded import RECORDED, replay


class Page:
    """Takes down what a page would show."""

    def __init__(self):
        self.calls = []

    def __getattr__(self, name):
        return lambda *args, **words: self.calls.append((name, args, words))


def profile(force_N, reason=Reason.OK):
    s_m = np.arange(8) * 0.01
    value = np.full(8, force_N)
    budget = ErrorBudget(0.01, 0.02, 0.0, 0.0)
    return ForceProfile(
        1.5,
        reason is Reason.OK,
        reason,
        force_N,
        budget,
        s_m,
        value,
        value,
        value,
        value,
        np.ones(8, dtype=bool),
    )


def test_the_shipped_mission_tells_the_whole_story(tmp_path):
    assert RECORDED.stat().st_size < 1_000_000
    page, said = Page(), []
    report = replay(tmp_path, on_message=said.append, page=page, pause_s=0.0)
    assert said[-1] == "all 9 chapters done"
    assert "lifted" in report.read_text()
    shown = [words["profile"] for name, _, words in page.calls if name == "update"]
    assert max(one.force_N for one in shown if one.valid) == pytest.approx(
        6.0, abs=1.0
    )  # the heavy box slides
    assert {name for name, _, _ in page.calls} == {"set_map", "set_obstacle", "set_tags", "update"}


def test_what_is_recorded_is_replayed(tmp_path):
    path = Path(__file__).resolve().parents[2] / "docs" / "mission_recorder.py"
    spec = importlib.util.spec_from_file_location("mission_recorder", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    recorder = module.MissionRecorder()
    recorder.log("once upon a time")
    recorder.set_map(np.zeros((4, 5), np.int8), 0.05, (0.0, 0.0, 0.0))
    recorder.set_obstacle("box", np.eye(3)[:, :2], Pose.identity(), fixed=False)
    picture = np.full((90, 160, 3), 70, np.uint8)
    for note in ("contact", "release"):  # events are always kept
        recorder.update(1.5, frame_bgr=picture, profile=profile(2.5), truth_N=2.4, note=note)
    recorder.update(1.6, frame_bgr=picture, profile=profile(float("nan"), Reason.LOST), note="lost")
    recorder.set_tags({"box": HapticTag(fixed=True)})
    (tmp_path / "report.html").write_text("<p>the end</p>")
    recorder.save(tmp_path / "mission.zip", tmp_path / "report.html")

    page, said = Page(), []
    report = replay(
        tmp_path / "out", on_message=said.append, page=page, recording=tmp_path / "mission.zip", pause_s=0
    )
    assert said == ["once upon a time"]
    assert report.read_text() == "<p>the end</p>"
    names = [name for name, _, _ in page.calls]
    assert names == ["set_map", "set_obstacle", "update", "update", "update", "set_tags"]
    first, last = page.calls[2][2], page.calls[4][2]
    assert (first["profile"].force_N, first["truth_N"]) == pytest.approx((2.5, 2.4))
    assert first["note"] == "contact"
    assert first["frame_bgr"].shape[1] == 480
    assert last["profile"].reason is Reason.LOST
    assert np.isnan(last["profile"].force_N)
    assert page.calls[5][1] == ({"box": "fixed"},)


def test_another_file_is_no_recorded_mission(tmp_path):
    (tmp_path / "a.zip").write_text("no")
    with pytest.raises(InputError, match="is not a recorded mission"):
        replay(tmp_path, on_message=print, recording=tmp_path / "a.zip")


def test_a_bomb_is_refused_by_what_it_declares(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("report.html", bytes(80 * 2**20))
    with pytest.raises(InputError, match="unpacks to 83886080 bytes"):
        replay(tmp_path, on_message=print, recording=tmp_path / "a.zip")


def test_the_verb_replays_it_and_takes_no_part(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("visuohaptic.demo.recorded.time.sleep", lambda seconds: None)
    assert main(["demo", "--quick", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert out.startswith("a recorded mission; visuohaptic demo computes one")
    assert str(tmp_path / "report.html") in out
    assert main(["demo", "foam", "--quick"]) == 2
    assert "--quick: found with foam" in capsys.readouterr().err
    assert main(["demo", "--map", "office.yaml", "--world", "3"]) == 2
    assert "--map: found with --world" in capsys.readouterr().err
