from __future__ import annotations

import numpy as np
import pytest
from tests.sensing import scenes

from visuohaptic.core import InputError, Reason
from visuohaptic.sensing.scene import FloorMixture, MixtureSettings, ObstacleDetector
from visuohaptic.sensing.scene._mixture_kernels import update_mixture
from visuohaptic.simulation.foam import SensorRig
from visuohaptic.simulation.rendering import Look, Surface


def mixture_twin(image, modes, held, rate, rate_foreground, background_fraction, settings):
    """The kernel's rule, pixel by pixel in plain Python with double precision."""
    gate, prior, start, smallest, largest = settings
    mask = np.zeros(image.shape[:2], np.uint8)
    for index in np.ndindex(image.shape[:2]):
        level = image[index].astype(float)
        stack = [m.copy() for m in modes[index].astype(float)]
        used = [m for m in stack if m[0] > 0]
        near = [np.sum((level - m[2:]) ** 2) < gate * len(level) * m[1] for m in used]
        found = used[near.index(True)] if any(near) else None
        before = sum(m[0] for m in used[: near.index(True)]) if any(near) else 1.0
        background = found is not None and before < background_fraction
        mask[index] = 0 if background else 255
        alpha = rate if background and not held[index] else rate_foreground
        if found is not None:
            error = np.sum((level - found[2:]) ** 2)
        for m in used:
            m[0] = (1 - alpha) * m[0] - alpha * prior
            if m is found:
                m[0] += alpha
                step = min(alpha / m[0], 1.0)
                m[2:] += step * (level - m[2:])
                m[1] = np.clip(m[1] + step * (error / len(level) - m[1]), smallest, largest)
            m[0] = max(m[0], 0.0)
        if found is None:
            found = stack[-1]
            found[:2] = alpha, start
            found[2:] = level
        total = sum(m[0] for m in stack)
        for m in stack:
            m[0] /= total
        k = next(i for i, m in enumerate(stack) if m is found)
        while k > 0 and stack[k][0] > stack[k - 1][0]:
            stack[k], stack[k - 1] = stack[k - 1], stack[k]
            k -= 1
        modes[index] = stack
    return mask


@pytest.mark.parametrize("channels", [1, 3])
def test_the_kernel_equals_its_twin(channels):
    rng = np.random.default_rng(4)
    shape = (9, 11)
    ours = np.zeros((*shape, 3, 2 + channels), np.float32)
    theirs = ours.copy()
    settings = np.array([9.0, 0.01, 64.0, 16.0, 400.0], np.float32)
    held = (rng.random(shape) < 0.2).astype(np.uint8)
    base = rng.integers(60, 180, (2, *shape, channels))
    for step in range(25):
        kind = (rng.random(shape) < 0.3).astype(int)
        image = np.where(kind[..., None] > 0, base[1], base[0]) + rng.normal(0, 5, (*shape, channels))
        image = np.clip(image, 0, 255).astype(np.uint8)
        mask = np.zeros(shape, np.uint8)
        rate = max(0.1, 1.0 / (step + 1))
        arguments = [np.float32(rate), np.float32(0.03), np.float32(0.9), settings]
        kernels = np.ascontiguousarray(np.moveaxis(ours, 1, -1))
        update_mixture(image, kernels, held, *arguments, mask)
        ours = np.ascontiguousarray(np.moveaxis(kernels, -1, 1))
        expected = mixture_twin(image, theirs, held, *arguments)
        np.testing.assert_array_equal(mask, expected)
        # The twin's state is rounded to single precision each step; weights are of order 1.
        np.testing.assert_allclose(ours, theirs, rtol=2e-4, atol=2e-5)
        theirs[:] = ours
    np.testing.assert_allclose(ours[..., 0].sum(axis=-1), 1.0, atol=1e-5)
    assert np.all(np.diff(ours[..., 0], axis=-1) <= 1e-6), "heaviest first"


def test_a_new_floor_is_learnt_within_a_few_frames_and_called_settling_until_then():
    rng = np.random.default_rng(1)

    def floor(level):
        return np.clip(rng.normal(level, 6, (60, 80)), 0, 255).astype(np.uint8)

    mixture = FloorMixture()
    for _ in range(20):
        mask = mixture.update(floor(90))
    assert mixture.foreground_fraction < 0.01
    assert not mixture.settling
    mixture.update(floor(150))
    assert mixture.foreground_fraction > 0.95
    assert mixture.settling
    for _ in range(6):
        mask = mixture.update(floor(150))
    assert not mixture.settling
    assert np.count_nonzero(mask) < 0.02 * mask.size
    # The old floor is still known.
    assert np.count_nonzero(mixture.update(floor(90))) < 0.1 * mask.size


def test_an_obstacle_that_stays_is_not_learnt_for_seconds():
    rng = np.random.default_rng(2)
    mixture, held = FloorMixture(), None
    for frame in range(110):
        image = np.clip(rng.normal(100, 5, (60, 80)), 0, 255).astype(np.uint8)
        if frame >= 20:
            image[:, 20:40] = np.clip(rng.normal(180, 5, (60, 20)), 0, 255).astype(np.uint8)
        held = mixture.update(image, held)
    assert np.count_nonzero(held[:, 20:40]) > 0.95 * 60 * 20
    assert np.count_nonzero(held) < 1.05 * 60 * 20


@pytest.mark.parametrize("colour", [False, True])
def test_proximity_of_a_box_that_comes_nearer(colour):
    rig = SensorRig()
    # No contact shadow: it is darker than the floor and belongs to the obstacle as the detector sees it.
    look = Look(
        floor=Surface(112.0, 10.0, "concrete", (100.0, 112.0, 120.0)), face_contrast=0.3, colour=colour
    )
    render = scenes.renderer(rig, look)
    detector = ObstacleDetector(scenes.floor_view(rig), scenes.FRONT_M)
    rng = np.random.default_rng(0)
    errors = []
    for i in range(24):
        driven = 0.005 * i
        x = 0.23 - driven
        things = [scenes.box(x, 0.02, bgr=(40.0, 60.0, 160.0))]
        image = render.render(scenes.scene(0.0, scenes.planar(driven, 0, 0), things), rng=rng)
        found = detector.update(image)
        assert found.valid == (i >= 2)
        if i >= 3 and x - scenes.FRONT_M < 0.14:
            errors.append(found.proximity_m - (x - scenes.FRONT_M))
    assert len(errors) > 3
    # Bins are 2 px = 0.4 mm, the majority filter and blur add about one; the box is 100 mm away.
    assert np.abs(errors).max() < 0.002


def test_a_free_floor_stays_free_while_the_platform_drives():
    rig = SensorRig()
    render = scenes.renderer(rig)
    detector = ObstacleDetector(scenes.floor_view(rig), scenes.FRONT_M)
    rng = np.random.default_rng(0)
    for i in range(20):
        found = detector.update(render.render(scenes.scene(0.0, scenes.planar(0.006 * i, 0, 0)), rng=rng))
    assert found.valid
    assert found.reason is Reason.OK
    assert found.proximity_m == np.inf


def test_what_cannot_be_used_is_refused():
    with pytest.raises(InputError, match=r"memory_frames: found 1\.0, expected at least 2"):
        MixtureSettings(memory_frames=1.0)
    with pytest.raises(InputError, match="binning: found 9, expected 1 to 8"):
        MixtureSettings(binning=9)
    mixture = FloorMixture()
    mixture.update(np.zeros((8, 8), np.uint8))
    with pytest.raises(InputError, match=r"expected \(8, 8\) as before"):
        mixture.update(np.zeros((8, 9), np.uint8))
    detector = ObstacleDetector(scenes.floor_view())
    with pytest.raises(InputError, match="expected 800 x 448"):
        detector.update(np.zeros((100, 100), np.uint8))
