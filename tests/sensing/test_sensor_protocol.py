"""One loop reads every kind of sensor: loaded from its file, zeroed, read, reset, closed."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks._fault_world import make_trial
from benchmarks.foam_faults import calibrated_folder

from visuohaptic.core import InputError, Reason
from visuohaptic.core.camera import Camera, Frame
from visuohaptic.rigs import VirtualBeam
from visuohaptic.sensing import Measurement, Sensor, load_sensor
from visuohaptic.sensing.beam import TrackedBeam
from visuohaptic.sensing.foam import FoamSensor
from visuohaptic.sensing.scene import SceneSensor
from visuohaptic.simulation.beam import RodRig
from visuohaptic.simulation.rendering import CameraEffects

SMALL = Camera.simple(640, 360, 720.0)


def foam_world(folder):
    trial = make_trial(3, ())
    calibrated_folder(folder)
    trial.sensor(folder)  # writes sensor.yaml; its zero is not saved
    frames = trial.zero_frames()
    return (
        folder / "sensor.yaml",
        FoamSensor,
        frames,
        [Frame(f.image, f.t_s + 1.0, f.index) for f in frames[:2]],
    )


def scene_world(folder):
    _, _, rest, frames = foam_world(folder)
    (folder / "scene.yaml").write_text("kind: scene\nsensor: sensor.yaml\n")
    return folder / "scene.yaml", SceneSensor, rest, frames


def beam_world(folder):
    beam = VirtualBeam(RodRig(), SMALL, CameraEffects(blur_px=0.7, noise_sigma=3.0))
    beam.write(folder)
    rng, renderer = np.random.default_rng(3), beam.renderer()
    rest = list(beam.frames(np.zeros((8, 6)), rng, start_s=-1.0, renderer=renderer))
    return (
        folder / "sensor.yaml",
        TrackedBeam,
        rest,
        list(beam.frames(np.zeros((2, 6)), rng, renderer=renderer)),
    )


@pytest.mark.parametrize("world", [foam_world, beam_world, scene_world])
def test_one_loop_for_every_sensor(world, tmp_path):
    path, kind, rest, frames = world(tmp_path)
    sensor = load_sensor(path)
    assert type(sensor) is kind
    assert isinstance(sensor, Sensor)
    assert (sensor.camera.height, sensor.camera.width) == frames[0].image.shape[:2]
    assert not sensor.zeroed
    sensor.zero(rest).save(tmp_path / "zero.yaml")
    assert sensor.zeroed
    first = [sensor.read(frame) for frame in frames]
    assert all(isinstance(reading, Measurement) for reading in first)
    assert [reading.t_s for reading in first] == [frame.t_s for frame in frames]
    # After a reset the same frames are new again, and the zero is still there.
    assert sensor.read(frames[1]).reason is Reason.STALE
    sensor.reset()
    assert sensor.zeroed
    assert [sensor.read(frame).reason for frame in frames] == [reading.reason for reading in first]
    sensor.close()
    sensor.close()


def test_an_unknown_kind_is_refused(tmp_path):
    (tmp_path / "sensor.yaml").write_text("kind: nose\n")
    with pytest.raises(InputError, match="kind: found 'nose', expected one of foam, beam, scene"):
        load_sensor(tmp_path / "sensor.yaml")
