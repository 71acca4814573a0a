"""Every reason for an invalid frame, and seeded faults compared with the true force of the foam."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from benchmarks._fault_world import KINDS, make_trial
from benchmarks.foam_faults import calibrated_folder, run_trial, violations

from visuohaptic.core import InputError, Reason
from visuohaptic.core.camera import Frame
from visuohaptic.sensing.foam import FoamSensor

#: One seed of each family of faults; no light and saturation have tests of their own below.
SEEDS = [KINDS.index(kind) + 22 * 400 for kind in (
    "hand over the front", "hand over the base", "hot spot", "dropped frames", "bump", "vibration", "defocus",
    "textured object",
)]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return calibrated_folder(tmp_path_factory.mktemp("foam"))


@pytest.fixture(scope="module")
def zeroed(folder):
    return make_trial(3, ()).sensor(folder)


@pytest.fixture
def sensor(zeroed):
    return deepcopy(zeroed)


@pytest.fixture(scope="module")
def rest():
    """Frames of the untouched strip, from time zero on."""
    return [Frame(f.image, i / 30, i) for i, f in enumerate(make_trial(3, ()).zero_frames())]


def _darker(frame: Frame, rows: slice, columns: slice, factor: float) -> Frame:
    image = frame.image.copy()
    image[rows, columns] = (image[rows, columns] * factor).astype(np.uint8)
    return replace(frame, image=image)


@pytest.mark.parametrize("seed", SEEDS)
def test_no_fault_is_silently_wrong(folder, seed) -> None:
    outcome = run_trial(make_trial(seed), folder)
    assert violations([outcome], 4.0) == 0
    assert any(outcome.valid[:4]), "valid before the fault"


def test_without_a_fault_all_frames_are_valid(folder) -> None:
    outcome = run_trial(make_trial(8800, ()), folder)
    assert all(outcome.valid)
    assert outcome.excess.max() == 0.0


def test_stale(sensor, rest) -> None:
    assert sensor.read(rest[0]).reason is Reason.OK
    assert sensor.read(replace(rest[0], t_s=0.1)).reason is Reason.STALE, "the same image again"
    assert sensor.read(rest[3]).reason is Reason.OK
    profile = sensor.read(rest[2])
    assert profile.reason is Reason.STALE, "out of order"
    assert not profile.valid
    assert np.isnan(profile.force_N)
    assert not profile.point_valid.any()
    assert sensor.read(replace(rest[0], t_s=0.3)).reason is Reason.STALE, "an old buffer"


def test_lost_in_the_dark_and_back(sensor, rest) -> None:
    assert sensor.read(rest[0]).valid
    dark = _darker(rest[1], slice(None), slice(None), 0.02)
    assert sensor.read(dark).reason is Reason.LOST
    assert sensor.read(rest[2]).valid


def test_occluded(sensor, rest) -> None:
    sensor.read(rest[0])
    points = sensor.strip.reference_points_px[30:40], sensor.strip.front_points_px[30:40]
    columns = slice(int(points[0][:, 0].min()), int(points[0][:, 0].max()))
    front, back = int(points[1][:, 1].min()), int(points[0][:, 1].max())
    # What lies over the foam behind its front hides nothing of it.
    assert sensor.read(_darker(rest[1], slice(front + 40, back - 20), columns, 0.4)).valid
    covered = rest[2].image.copy()
    covered[front - 40 : front + (back - front) // 2, columns] = np.random.default_rng(5).normal(
        60, 8, (40 + (back - front) // 2, columns.stop - columns.start)
    )
    profile = sensor.read(replace(rest[2], image=covered))
    assert profile.reason is Reason.OCCLUDED
    assert profile.evidence
    assert np.isnan(profile.force_N)
    assert sensor.read(rest[3]).valid


def test_moved(sensor, rest) -> None:
    sensor.read(rest[0])
    shifted = replace(rest[1], image=np.roll(rest[1].image, 6, axis=0))
    assert sensor.read(shifted).reason is Reason.MOVED


def test_not_zeroed(sensor, rest) -> None:
    assert FoamSensor(sensor.setup).read(rest[0]).reason is Reason.NOT_ZEROED


def test_saturated(folder) -> None:
    trial = make_trial(3, ())
    trial.depths_m = np.concatenate([np.linspace(-0.001, 0.016, 12), np.full(2, 0.016)])
    trial.slide_m = np.zeros(14)
    assert "saturated" in run_trial(trial, folder).reason


def test_wrong_size(sensor, rest) -> None:
    with pytest.raises(InputError, match=r"found 800 x 896 px, expected 1600 x 896"):
        sensor.read(replace(rest[0], image=np.ascontiguousarray(rest[0].image[:, ::2])))


def test_point_sigma_is_true_at_rest(sensor) -> None:
    trial = make_trial(3, ())
    frames = [f for seed in range(4) for f in _rest_frames(trial, seed)]
    deltas, sigmas = [], []
    for i, frame in enumerate(frames):
        profile = sensor.read(Frame(frame.image, i / 30, i))
        deltas.append(profile.delta_m)
        sigmas.append(profile.delta_sigma_m)
    # Zero and frames alike are random: the scatter about zero against the declared sigma, 40 x 83 draws.
    ratio = np.sqrt(np.mean(np.square(sigmas)) / np.mean(np.square(deltas)))
    # Noise of the levels beside an edge and of its place are in part the same, which half of the encoding takes out.
    assert 0.8 < ratio < 1.3


def _rest_frames(trial, seed: int) -> list[Frame]:
    """Rest frames of the same world with other noise."""
    from visuohaptic.rigs import rest_scene
    from visuohaptic.simulation.rendering import SceneRenderer

    rng = np.random.default_rng([77, seed])
    renderer = SceneRenderer(trial.rig.camera, trial.rig.T_camera_foam, trial.look, trial.effects)
    return [Frame(image, 0.0, 0) for image in renderer.repeated(rest_scene(trial.geometry), 10, rng=rng)]
