"""``start`` from a camera to newtons, on a recording of all its steps and with scripted answers."""

from __future__ import annotations

import io
import json
import sys
from itertools import pairwise

import cv2
import numpy as np
import pytest

from visuohaptic.cli.main import main
from visuohaptic.io.frames import open_source
from visuohaptic.rigs.foam_example import write_video
from visuohaptic.rigs.virtual_sensor import VirtualSensor, rest_scene
from visuohaptic.simulation.foam import FoamStripGeometry, PressShape, SensorRig, StripLaw, press
from visuohaptic.tracking.templates import Template

pytest.importorskip("av")

SIDE_M = 0.03
#: Not of the family that is fitted: two exponents, and 12 % hysteresis.
LAW = StripLaw(mu_Pa=(9000.0, 2500.0), alpha=(14.0, 3.0), loss=(0.02, 0.04), loss_strain=(0.002, 0.02))
LOADS_M, LAST_M = (0.0015, 0.004, 0.008), 0.006


def with_tag(image: np.ndarray, virtual: VirtualSensor) -> np.ndarray:
    """The strip with the printed tag on it: its lower edge on the back contour, its top ahead."""
    tag = Template.from_tag(7, size_m=SIDE_M)
    rows, columns = tag.image.shape
    corners = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], float)
    right_m, down_m = ((corners - [columns / 2, rows / 2]) * tag.pixel_m).T
    on_strip_m = np.column_stack([SIDE_M / 2 - down_m, -right_m, np.zeros(4)])
    rig = virtual.rig
    seen_px = rig.camera.project(rig.T_camera_foam.apply(on_strip_m)).astype(np.float32)
    warp = cv2.getPerspectiveTransform((corners - 0.5).astype(np.float32), seen_px)
    size = image.shape[1::-1]
    over = cv2.warpPerspective(tag.image, warp, size, flags=cv2.INTER_AREA)
    there = cv2.warpPerspective(np.full_like(tag.image, 255), warp, size, flags=cv2.INTER_AREA)
    blend = there[..., None].squeeze() / 255.0
    return (image * (1 - blend) + over * blend).astype(np.uint8)


def presses(depths_m: tuple[float, ...], shape: PressShape, geometry: FoamStripGeometry):
    """Each depth at 1 cm/s and 30 frames per second, held for 12 frames, and back; samples of the physics."""
    path = [0.0]
    for start, end in pairwise((0.0, *depths_m, 0.0)):
        path += list(np.linspace(start, end, max(2, int(abs(end - start) / 0.01 * 30))))
        path += [end] * 12
    return press(shape, path, geometry=geometry, law=LAW)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Video of tag, zero, three known loads and a cylinder; grams of the loads, and the largest true force."""
    folder = tmp_path_factory.mktemp("start")
    virtual, rng = VirtualSensor(law=LAW, rig=SensorRig().half_size()), np.random.default_rng(2)
    renderer = virtual.renderer()
    images = list(renderer.repeated(rest_scene(virtual.geometry), 25, rng=rng))
    images[:5] = [with_tag(image, virtual) for image in images[:5]]
    known: dict[float, float] = {}
    for sample in presses(LOADS_M, PressShape.LARGE_PLATE, virtual.geometry):
        known[round(sample.depth_m, 6)] = sample.force_N
        images.append(renderer.render(sample.scene, rng=rng))
    truth_N = 0.0
    for sample in presses((LAST_M,), PressShape.CYLINDER_12CM, virtual.geometry):
        truth_N = max(truth_N, sample.force_N)
        images.append(renderer.render(sample.scene, rng=rng))
    write_video(folder / "bumper.mp4", images)
    virtual.rig.camera.save(folder / "camera.yaml")
    return folder, [1e3 * known[depth] / 9.81 for depth in LOADS_M], truth_N


def start(monkeypatch, capsys, folder, answers, *words):
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "stdin", io.StringIO("".join(f"{answer}\n" for answer in answers)))
    code = main(["start", "--source", "bumper.mp4", "--no-view", "--json", *words])
    captured = capsys.readouterr()
    return code, json.loads(captured.out) if code == 0 else None, captured.err


SIZE = ("--length", "250", "--width", "20", "--height", "10")


@pytest.mark.parametrize(("camera", "accuracy"), [(["--camera", "camera.yaml"], 0.05), ([], 0.08)])
def test_from_a_recording_and_a_kitchen_scale_to_newtons(recording, monkeypatch, capsys, camera, accuracy):
    """A gram of the scale and 2 % of shape that two parameters cannot follow; without camera.yaml its tilt, too."""
    folder, grams, truth_N = recording
    answers = [f"{value:.0f}" for value in grams] + [""]
    code, found, said = start(monkeypatch, capsys, folder, answers, *SIZE, *camera, "--out", "bumper")
    assert code == 0, said
    assert found["loads"] == 3
    assert found["measured_width_m"] == pytest.approx(0.02, rel=0.04)
    assert found["max_force_N"] == pytest.approx(truth_N, rel=accuracy)
    assert {"tag.pdf", "camera.yaml", "sensor.yaml", "foam.yaml", "zero.yaml"} <= {
        path.name for path in (folder / "bumper").iterdir()
    }
    assert " N +- " in said, "newtons in the terminal"
    with open_source(folder / "bumper.mp4") as source:
        assert found["frames"] < source.frame_count


def test_sizes_are_asked_for_and_checked(recording, monkeypatch, capsys):
    folder, grams, _ = recording
    code, found, said = start(monkeypatch, capsys, folder, ["250", "20", "10", f"{grams[0]:.0f}", ""])
    assert (code, found["loads"]) == (0, 1), said
    assert (
        said.index("length along the robot") < said.index("thickness in the direction") < said.index("height")
    )


@pytest.mark.parametrize(
    ("answers", "words", "problem"),
    [
        ([], ["--length", "250", "--width", "25", "--height", "10"], "mm wide, expected 25.0 mm"),
        ([], ["--length", "0.25", "--width", "20", "--height", "10"], "found 0.25 mm, expected 2 to 1000 mm"),
        ([], [*SIZE[:4]], "--height: no answer was given; give --height"),
        (["wide"], [*SIZE[:4]], "--height: found 'wide', expected a number of millimetres"),
        (["lots"], SIZE, "known load: found 'lots', expected a number of grams"),
        (["nan"], SIZE, "known load: found 'nan', expected a number of grams"),
        (["0"], SIZE, "known load: found '0', expected a number of grams"),
        ([""], SIZE, "known load: found '', expected a number of grams"),
        (["{0}", "{1}", "{0}", ""], SIZE, "contradicts the others"),
        (
            [],
            [*SIZE, "--tag", "9"],
            "outside the image, expected less than half; measure strip and printed tag with a ruler",
        ),
    ],
)
def test_what_cannot_be_right_is_refused(recording, monkeypatch, capsys, answers, words, problem):
    """And an earlier sensor in the folder remains, whole, with its own zero reference."""
    folder, grams, _ = recording
    earlier = folder / "earlier"
    earlier.mkdir(exist_ok=True)
    for name in ("camera.yaml", "sensor.yaml", "foam.yaml", "zero.yaml"):
        (earlier / name).write_text(f"{name} of last week")
    answers = [answer.format(*(f"{value:.0f}" for value in grams)) for answer in answers]
    code, _, said = start(
        monkeypatch, capsys, folder, answers, *words, "--camera", "camera.yaml", "--out", "earlier"
    )
    assert code == 2, said
    assert problem in said.splitlines()[-1]
    assert {path.name: path.read_text() for path in earlier.glob("*.yaml")} == {
        name: f"{name} of last week" for name in ("camera.yaml", "sensor.yaml", "foam.yaml", "zero.yaml")
    }
    assert not list(earlier.glob(".*")), "nothing unfinished is left"


class Terminal(io.StringIO):
    """Answers that are typed."""

    def isatty(self) -> bool:
        return True


def test_a_mistyped_load_is_asked_for_again(monkeypatch):
    from types import SimpleNamespace

    from visuohaptic.cli.verbs.system.start import _asked_g

    told: list[str] = []
    args = SimpleNamespace(report=told.append)
    monkeypatch.setattr(sys, "stdin", Terminal("\n12o\n-3\n120,5\n\n"))
    assert _asked_g(args, "load 1", may_end=False) == pytest.approx(120.5)
    assert [line.split("found ")[1].split(",")[0] for line in told] == ["''", "'12o'", "'-3'"]
    assert _asked_g(args, "load 2", may_end=True) is None


def test_cameras_are_listed(monkeypatch, capsys):
    from visuohaptic import io
    from visuohaptic.io import FoundCamera

    monkeypatch.setattr(io, "find_cameras", lambda: [FoundCamera("camera:2", "Wide Cam", "/sys/video2")])
    assert main(["cameras"]) == 0
    assert capsys.readouterr().out.split(maxsplit=1) == ["camera:2", "Wide Cam\n"]
    monkeypatch.setattr(io, "find_cameras", list)
    assert main(["cameras"]) == 0
    assert "no camera found" in capsys.readouterr().out
    assert main(["start"]) == 2
    assert "no camera found" in capsys.readouterr().err
