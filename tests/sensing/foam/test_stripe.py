"""The colour stripe in the sensor: force through its edge, cover by its colour, training, refusals."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from visuohaptic.core import CalibrationError, InputError, Reason
from visuohaptic.core.camera import Frame, PlaneView
from visuohaptic.sensing.foam import FingerSensor
from visuohaptic.sensing.foam.strip import FoamSensorConfig, stripe_masks, train_stripe
from visuohaptic.simulation.rendering import Occluder, Surface
from visuohaptic.simulation.tabletop import GraspObject
from visuohaptic.tracking.contours import PointReason


def pressed(maker, sensor, item, *, at_s, seed=3, **more):
    """Reading and truth of one frame with the gripper at rest on an object, after one at rest."""
    gripper = maker.gripper(item, rng=np.random.default_rng(seed), **more)
    reader = FingerSensor(sensor.setup, sensor.zero_reference)
    gripper.move(0.0, 0.08)
    gripper.skip_to(at_s)
    gripper.stop()
    gripper.skip_to(at_s + 0.05)
    for _ in range(2):  # the speed is known from the second frame on
        reading = reader.read_finger(gripper.frame())
    return reading, gripper.truth(), reader


def test_strain_is_that_of_the_foam_behind_the_stripe(striped, grippers) -> None:
    """The tracked foam is 12 of 15 mm wide; without the effective width force would be some 20 % low."""
    maker, sensor = striped
    assert sensor.optics.rest_width_m == pytest.approx(0.012)
    reading, truth, _ = pressed(maker, sensor, grippers.bottle(), at_s=0.58)
    assert truth.force_N > 10
    assert reading.profile.valid
    assert reading.profile.force_N == pytest.approx(truth.force_N, rel=0.02)
    deepest = sensor.setup.geometry.width_m - truth.front_m[:, 0].min()
    # Straight from the law: 0.1 mm less strain behind the stripe of a curved body.
    assert np.nanmax(reading.profile.delta_m) == pytest.approx(deepest, abs=1.2e-4)


def test_texture_of_the_object_does_not_pull_the_contour(striped, grippers) -> None:
    """A bottle with strong stripes and edges: the edge of the stripe stays where it is."""
    maker, sensor = striped
    loud = GraspObject(
        grippers.bottle().outline, 2e4, surface=Surface(110.0, 60.0, "wood", (90.0, 110.0, 130.0))
    )
    reading, truth, _ = pressed(maker, sensor, loud, at_s=0.58)
    assert reading.profile.valid
    assert reading.profile.force_N == pytest.approx(truth.force_N, rel=0.02)


def test_a_hand_over_the_foam_is_occlusion(striped, grippers) -> None:
    maker, sensor = striped
    # 2 cm wide, over stripe and foam but not the tag: near the right end of the contact.
    hand = Occluder(np.array([[870.0, 0], [990, 0], [990, 460], [870, 460]]))
    reading, truth, reader = pressed(maker, sensor, grippers.bottle(), at_s=0.58, occluders=(hand,))
    assert truth.force_N > 10
    assert not reading.profile.valid
    assert reading.profile.reason is Reason.OCCLUDED
    reasons = reader.strip.front.reason
    assert (reasons == PointReason.OCCLUDED).sum() >= 3
    assert not reading.profile.point_valid.all()


def test_colours_of_points_are_looked_up_where_the_edge_is(striped) -> None:
    """No point of a free strip is called hidden, also while it moves by 8 px a frame."""
    maker, sensor = striped
    reader = FingerSensor(sensor.setup, sensor.zero_reference)
    gripper = maker.gripper(rng=np.random.default_rng(4))
    gripper.move(0.0, 0.08)
    gripper.skip_to(0.3)
    for _ in range(4):
        assert reader.read_finger(gripper.frame()).profile.point_valid.all()


def test_grey_frames_are_refused(striped) -> None:
    maker, sensor = striped
    frame = maker.gripper(rng=np.random.default_rng(5)).frame()
    reader = FingerSensor(sensor.setup, sensor.zero_reference)
    with pytest.raises(InputError, match=r"frame 7: stripe: found a grey image, expected colour"):
        reader.read(Frame(frame.grey, 0.0, 7))


def test_training_from_the_geometric_model(striped, tmp_path) -> None:
    maker, sensor = striped
    setup = FoamSensorConfig.load(sensor.setup.folder / "sensor.yaml")
    plane = PlaneView(setup.camera, setup.T_camera_foam)
    frame = maker.gripper(rng=np.random.default_rng(6)).frame()
    stripe, rest = stripe_masks(setup, plane)
    assert not (stripe & rest).any()
    # Blur and a model that is a pixel off mix the colours of three pixels along every edge; corners are rounded to pixels.
    geometry = setup.geometry
    back_m = geometry.front_m - setup.config.stripe.width_m * geometry.outward
    outline = shapely.Polygon(plane.project(np.concatenate([back_m, geometry.front_m[::-1]])))
    inside = shapely.points(np.argwhere(stripe)[:, ::-1].astype(float))
    assert shapely.contains(outline, inside).all()
    assert 2.4 < shapely.distance(outline.exterior, inside).min() < 3.6
    # 3 mm by 9.8 cm at 6 px/mm and 20 degrees of slant, less 3 px along every edge.
    assert 4000 < stripe.sum() < 9000
    model = train_stripe(setup, frame.image, plane, rng=np.random.default_rng(0))
    assert model.likelihood(frame.image[stripe]).mean() > 0.95
    assert model.likelihood(frame.image[rest]).mean() < 0.02
    # Neither side of the edge may clip: a mixture of the two has to stay one.
    levels = model.axis @ np.array([[36.0, 38, 40], [70, 170, 55]]).T + model.offset
    assert (levels > 15).all()
    assert (levels < 240).all()


def test_training_refuses_a_strip_that_is_elsewhere(striped) -> None:
    maker, sensor = striped
    setup = sensor.setup
    frame = maker.gripper(rng=np.random.default_rng(7)).frame()
    plane = PlaneView(setup.camera, setup.T_camera_foam)
    with pytest.raises(CalibrationError, match="look like the stripe"):
        train_stripe(setup, np.roll(frame.image, -25, axis=0), plane, rng=np.random.default_rng(0))
    with pytest.raises(InputError, match="found 800 x 448 px, expected 1600 x 896"):
        train_stripe(setup, frame.image[::2, ::2], plane, rng=np.random.default_rng(0))


def test_files_that_cannot_work(striped) -> None:
    _, sensor = striped
    folder = sensor.setup.folder
    text = (folder / "sensor.yaml").read_text()
    (folder / "wide.yaml").write_text(text.replace("width_m: 0.003", "width_m: 0.012"))
    with pytest.raises(InputError, match=r"stripe.width_m.*at most 60 %"):
        FingerSensor.load(folder / "wide.yaml")
    (folder / "absent.yaml").write_text(text.replace("stripe.npz", "absent.npz"))
    with pytest.raises(InputError, match=r"absent.npz: cannot be read"):
        FingerSensor.load(folder / "absent.yaml")
