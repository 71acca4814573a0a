"""End to end: images of an independently simulated large-deflection rod, to wrenches."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from visuohaptic.cli.main import main
from visuohaptic.core import CalibrationError, InputError, Reason
from visuohaptic.core.camera import Camera, Frame
from visuohaptic.rigs import VirtualBeam
from visuohaptic.rigs.virtual_beam import push_and_twist
from visuohaptic.sensing.beam import TrackedBeam
from visuohaptic.simulation.beam import RodRig
from visuohaptic.simulation.rendering import CameraEffects

#: Half of the usual camera: a quarter of the work.
CAMERA = Camera.simple(800, 448, 900.0, distortion=np.array([-0.08, 0.03, 5e-4, -5e-4, 0.0]))


def virtual(**more) -> VirtualBeam:
    return VirtualBeam(RodRig(), CAMERA, CameraEffects(blur_px=0.7, noise_sigma=3.0), **more)


def vector(wrench):
    return np.concatenate([wrench.force_N, wrench.moment_Nm])


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """Sensor files, the renderer, and pictures at rest and under load from a moving camera."""
    beam = virtual()
    folder = tmp_path_factory.mktemp("beam")
    beam.write(folder)
    renderer, rng = beam.renderer(), np.random.default_rng(3)
    rest = list(beam.frames(np.zeros((8, 6)), rng, start_s=-0.5, renderer=renderer))
    loads = push_and_twist(12)
    return folder, rest, list(beam.frames(loads, rng, renderer=renderer)), loads


def test_a_bending_rod_and_a_moving_camera(world):
    folder, rest, frames, loads = world
    with TrackedBeam.load(folder / "sensor.yaml") as beam:
        assert beam.read(frames[0]).reading.wrench.reason is Reason.NOT_ZEROED
        beam = TrackedBeam.load(folder / "sensor.yaml")
        beam.zero(rest)
        scores = []
        for frame, load in zip(frames, loads, strict=True):
            found = beam.read(frame)
            wrench = found.reading.wrench
            assert wrench.valid, (frame.t_s, wrench.reason)
            assert [pose.name for pose in found.templates] == ["reference", "middle", "tip"]
            error = vector(wrench) - load
            assert (np.abs(error) < 5 * np.sqrt(np.diag(wrench.covariance))).all()
            # 2.8 N bend it for good; the rod is exactly that of the data sheet here.
            assert np.abs(error[1]) < 0.02 * 2.8
            scores.append(error @ np.linalg.solve(found.reading.noise + found.reading.zero, error))
        # Six degrees of freedom; the error of the zero is common to all frames.
        assert 2.0 < np.mean(scores) < 14.0


def covered(frame: Frame, folder: Path, names: set[str]) -> Frame:
    """The frame with grey over templates, where a tracker of its own finds them."""
    beam = TrackedBeam.load(folder / "sensor.yaml")
    image = frame.image.copy()
    for pose in beam.track(frame):
        if pose.name in names:
            corners = pose.alignment.corners
            middle = corners.mean(axis=0)
            cv2.fillConvexPoly(image, np.round(middle + 1.3 * (corners - middle)).astype(np.int32), 110)
    return Frame(image, frame.t_s, frame.index)


def test_covered_templates(world):
    folder, rest, frames, loads = world
    beam = TrackedBeam.load(folder / "sensor.yaml")
    beam.zero(rest)
    for k, (names, reason) in enumerate(
        [({"middle"}, None), ({"reference"}, Reason.LOST), ({"middle", "tip"}, Reason.LOST), (set(), None)]
    ):
        frame = covered(frames[2 + k], folder, names) if names else frames[2 + k]
        found = beam.read(frame)
        wrench = found.reading.wrench
        if reason is not None:
            assert not wrench.valid
            assert wrench.reason is reason
            assert np.isnan(wrench.force_N).all()
            continue
        assert wrench.valid
        assert set(found.reading.templates) == {"middle", "tip"} - names
        error = np.abs(vector(wrench) - loads[2 + k])
        assert (error < 5 * np.sqrt(np.diag(wrench.covariance))).all()


def test_zero_refuses_what_is_not_at_rest(world):
    folder, _, frames, _ = world
    beam = TrackedBeam.load(folder / "sensor.yaml")
    with pytest.raises(CalibrationError, match="moved while zeroing"):
        beam.zero(frames[:4])
    with pytest.raises(CalibrationError, match="found no frame"):
        beam.zero([])
    blank = [Frame(np.full((448, 800), 90, np.uint8), 50 + k / 30, k) for k in range(3)]
    with pytest.raises(CalibrationError, match="no frame shows the reference"):
        beam.zero(blank)


def test_a_calibration_has_a_load_for_each_frame(world):
    folder, rest, *_ = world
    beam = TrackedBeam.load(folder / "sensor.yaml")
    with pytest.raises(InputError, match="six values for each frame"):
        beam.calibrate(rest[:1], np.zeros((2, 6)))


def test_files_that_do_not_fit_together_are_refused(tmp_path):
    virtual(kind="pictures").write(tmp_path)
    assert TrackedBeam.load(tmp_path / "sensor.yaml").sensor.zero_reference is None
    text = (tmp_path / "sensor.yaml").read_text()
    (tmp_path / "bare.yaml").write_text(text.replace("camera: camera.yaml\n", ""))
    with pytest.raises(InputError, match=r"bare.yaml: camera: is needed to read from images"):
        TrackedBeam.load(tmp_path / "bare.yaml")
    (tmp_path / "other.yaml").write_text(text.replace("name: tip", "name: top"))
    with pytest.raises(InputError, match="found middle, reference, tip; top is missing"):
        TrackedBeam.load(tmp_path / "other.yaml")


def test_the_verb_reads_pictures(world, tmp_path, capsys):
    folder, rest, frames, loads = world
    for name, pictures in (("rest", rest), ("push", frames)):
        (tmp_path / name).mkdir()
        for frame in pictures:
            cv2.imwrite(str(tmp_path / name / f"{frame.index:03d}.png"), frame.image)
    words = ["sense", "beam", "--config", str(folder / "sensor.yaml"), "--rate-Hz", "30", "--source"]
    push = [*words, str(tmp_path / "push")]
    assert main(push) == 2
    assert "there is no zero reference" in capsys.readouterr().err
    assert main([*words, str(tmp_path / "rest"), "--zero"]) == 0
    out, table = tmp_path / "run.mcap", tmp_path / "run.csv"
    capsys.readouterr()
    assert main([*push, "--out", str(out), "--csv", str(table), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["reasons"] == {"ok": len(loads)}
    with table.open() as stream:
        rows = list(csv.DictReader(stream))
    read = np.array([[float(row[name]) for name in ("fx_N", "fy_N", "fz_N")] for row in rows])
    assert np.abs(read - loads[:, :3]).max() < 0.06
    from mcap_ros2.reader import read_ros2_messages

    topics = {message.channel.topic for message in read_ros2_messages(str(out))}
    assert {"/template/reference", "/template/middle", "/template/tip"} <= topics
    assert main(["sense", "beam", "--config", str(folder / "sensor.yaml"), "--poses", "x.csv", "--view"]) == 2
    assert "has no images" in capsys.readouterr().err
