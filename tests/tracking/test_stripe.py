"""The colour stripe: trained once, then a table; position of the edge and occlusion."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from visuohaptic.core import CalibrationError, InputError
from visuohaptic.tracking.contours import (
    ConstraintLines,
    ContourSettings,
    ContourTracker,
    StripeModel,
)

pytest.importorskip("sklearn")

BLACK, GREEN, WOOD = np.array([30.0, 30, 32]), np.array([60.0, 170, 50]), np.array([90.0, 140, 190])
EDGE, FRONT = 60.3, 80.0


def picture(rng, *, hidden=None):
    """Foam (black), stripe (green) from row EDGE to FRONT, wood behind; blur 1 px, noise 3."""
    y = np.arange(120.0)[:, None, None]
    image = BLACK + (GREEN - BLACK) * ndtr(y - EDGE) + (WOOD - GREEN) * ndtr(y - FRONT)
    image = np.broadcast_to(image, (120, 400, 3)).copy()
    if hidden is not None:
        image[50:, hidden[0] : hidden[1]] = WOOD * 1.1
    return np.clip(np.rint(image + 3 * rng.standard_normal(image.shape)), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def model():
    stripe = np.zeros((120, 400), bool)
    stripe[63:77] = True
    rest = np.ones((120, 400), bool)
    rest[57:83] = False
    return StripeModel.train(picture(np.random.default_rng(0)), stripe, rest, rng=np.random.default_rng(1))


def lines(count=21):
    x = 200 + 17.0 * (np.arange(count) - (count - 1) / 2)
    return ConstraintLines(
        np.stack([x, np.full(count, 20.0)], 1),
        np.tile([0.0, 1.0], (count, 1)),
        np.full(count, 15.0),
        np.full(count, 70.0),
    )


def test_colours_are_told_apart(model):
    colours = np.rint([GREEN, BLACK, WOOD, [255, 0, 255]]).astype(np.uint8)
    probability = model.likelihood(colours)
    assert probability[0] > 0.9
    assert (probability[1:] < 0.1).all()


def test_edge_of_the_stripe_is_found_without_bias(model):
    rng = np.random.default_rng(2)
    settings = ContourSettings(polarity=1, plateau_px=6.0)
    error = []
    for _ in range(10):
        c = ContourTracker(settings).track(model.edge_image(picture(rng), lines()), lines())
        assert c.valid.all()
        error.append(c.position_px - (EDGE - 20))
    # 210 errors of about 0.02 px
    assert abs(np.mean(error)) < 0.02
    assert np.std(error) < 0.04


def test_hidden_points_are_occluded(model):
    image = picture(np.random.default_rng(3), hidden=(140, 220))
    clear = model.clear(image, lines(), np.full(21, EDGE - 20))
    x = lines().origin_px[:, 0]
    inside = (x > 140) & (x < 219)
    assert not clear[inside].any()
    assert clear[(x < 130) | (x > 230)].all()


def test_file_round_trip_and_damage(model, tmp_path):
    path = tmp_path / "stripe.npz"
    model.save(path)
    again = StripeModel.load(path)
    np.testing.assert_array_equal(again.table, model.table)
    np.testing.assert_array_equal(again.axis, model.axis)
    assert again.offset == model.offset
    whole = path.read_bytes()
    for damaged in (b"", b"text", whole[:200], whole[:300] + bytes(50) + whole[350:]):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="stripe"):
            StripeModel.load(path)
    with pytest.raises(InputError, match="cannot be read"):
        StripeModel.load(tmp_path / "absent.npz")


def test_training_refuses_what_cannot_work():
    rng = np.random.default_rng(4)
    image = picture(rng)
    few = np.zeros((120, 400), bool)
    few[63, :10] = True
    with pytest.raises(CalibrationError, match="10 pixels, expected at least 150"):
        StripeModel.train(image, few, rng=rng)
    same = np.zeros((120, 400), bool)
    same[20:40] = True
    with pytest.raises(CalibrationError, match="of the rest look like the stripe"):
        StripeModel.train(image, same, rng=rng)
