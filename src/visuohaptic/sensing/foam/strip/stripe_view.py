"""Front of the strip from the edge of a colour stripe, and occlusions of the stripe (Alt 2016, Sec. 3.3.1)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, UInt8

from ....core import Frame, InputError, PlaneView
from ....tracking import ConstraintLines, Contour, ContourSettings, ContourTracker, PointReason, StripeModel
from .config import FoamSetup

#: Pixels next to the edges of the stripe, with mixed colours: not used for training.
_MIXED_PX = 3
#: Pixels on either side of the edge that determine its levels: a deeply pressed stripe is not much wider.
_PLATEAU_PX = 5.0


class StripeView:
    """Tracks the edge between foam and stripe.

    Parameters
    ----------
    model
        Colours of the stripe.
    width_m
        Width of the stripe at rest; the tracked edge is this far behind the front. The foam
        behind the edge is narrower than the strip by this width, and its strain refers to the narrower width.
    """

    def __init__(self, model: StripeModel, width_m: float) -> None:
        self.model = model
        self.width_m = width_m
        self._tracker = ContourTracker(ContourSettings(polarity=1, plateau_px=_PLATEAU_PX))

    @classmethod
    def of(cls, setup: FoamSetup) -> StripeView | None:
        """Create the view that ``sensor.yaml`` describes; ``None`` without a stripe.

        Parameters
        ----------
        setup
            Configuration of the sensor.

        Raises
        ------
        InputError
            The model is missing or damaged, or the stripe is as wide as the foam.
        """
        section = setup.config.stripe
        if section is None:
            return None
        _check_width(setup)
        return cls(StripeModel.load(setup.folder / section.model), section.width_m)

    def reset(self) -> None:
        """Discard the previous frame."""
        self._tracker.reset()

    def track(self, frame: Frame, lines: ConstraintLines) -> Contour:
        """The edge in one frame; points without the stripe's colour in front of them are occluded.

        The colour is evaluated in front of the detected edge, not of the expected one:
        a fast finger moves the edge by more than the width of the stripe.

        Parameters
        ----------
        frame
            The next frame in chronological order.
        lines
            One constraint line per point.

        Raises
        ------
        InputError
            The frame is grey.
        """
        if frame.image.ndim != 3:
            raise InputError(
                f"frame {frame.index}",
                "found a grey image, expected colour (blue, green, red)",
                field="stripe",
                remedy="give colour frames, or take 'stripe' out of sensor.yaml",
            )
        contour = self._tracker.track(self.model.edge_image(frame.image, lines), lines)
        hidden = ~self.model.clear(frame.image, lines, contour.position_px)
        hidden &= contour.reason != PointReason.OUT_OF_RANGE
        if not hidden.any():
            return contour
        reason = np.where(hidden, np.uint8(PointReason.OCCLUDED), contour.reason)
        return replace(contour, valid=contour.valid & ~hidden, reason=reason)


def stripe_masks(
    setup: FoamSetup, plane: PlaneView
) -> tuple[Bool[np.ndarray, "rows columns"], Bool[np.ndarray, "rows columns"]]:
    """Pixels of the stripe, and pixels that are certainly outside it, from the geometric model.

    More than half of the latter are foam, because the edge image is intended for the edge between
    stripe and foam.

    Parameters
    ----------
    setup
        Configuration with a section ``stripe``.
    plane
        The top plane of the foam as the camera sees it.
    """
    import cv2

    section = setup.config.stripe
    if section is None:
        raise InputError("sensor.yaml", "has no section 'stripe'", field="stripe")
    _check_width(setup)
    geometry, camera = setup.geometry, setup.camera
    inner = geometry.back_m + (geometry.width_m - section.width_m) * geometry.outward

    def filled(first_m: np.ndarray, second_m: np.ndarray) -> UInt8[np.ndarray, "rows columns"]:
        outline = plane.project(np.concatenate([first_m, second_m[::-1]]))
        mask = np.zeros((camera.height, camera.width), np.uint8)
        cv2.fillPoly(mask, [np.rint(outline).astype(np.int32)], 1)
        return mask

    margin = np.ones((2 * _MIXED_PX + 1,) * 2, np.uint8)
    stripe = filled(inner, geometry.front_m)
    foam = cv2.erode(filled(geometry.back_m, inner), margin) > 0
    # The stripe extends beyond the first and last point by half a spacing or more.
    spacing_px = np.linalg.norm(np.diff(plane.project(geometry.front_m[:2]), axis=0))
    reach = int(2 * spacing_px) + _MIXED_PX
    beside = cv2.dilate(stripe, np.ones((2 * _MIXED_PX + 1, 2 * reach + 1), np.uint8)) > 0
    others = np.flatnonzero(~beside & ~foam)
    step = max(1, int(np.ceil(len(others) / max(1, 0.7 * foam.sum()))))
    rest = foam.copy()
    rest.ravel()[others[::step]] = True
    return cv2.erode(stripe, margin) > 0, rest


def train_stripe(
    setup: FoamSetup,
    image_bgr: UInt8[np.ndarray, "rows columns 3"],
    plane: PlaneView,
    *,
    rng: np.random.Generator,
) -> StripeModel:
    """Learn the stripe's colours from one image of the untouched strip.

    Parameters
    ----------
    setup
        Configuration with a section ``stripe``.
    image_bgr
        Colour image (blue, green, red) of the untouched strip.
    plane
        The top plane of the foam as the camera sees it.
    rng
        Source of the random samples.

    Raises
    ------
    CalibrationError
        The stripe is not at the position of the model, or its colour cannot be distinguished from the rest.
    """
    if image_bgr.shape[:2] != (setup.camera.height, setup.camera.width):
        raise InputError(
            "train_stripe",
            f"found {image_bgr.shape[1]} x {image_bgr.shape[0]} px, "
            f"expected {setup.camera.width} x {setup.camera.height}",
        )
    stripe, rest = stripe_masks(setup, plane)
    return StripeModel.train(image_bgr, stripe, rest, rng=rng)


def _check_width(setup: FoamSetup) -> None:
    section = setup.config.stripe
    if section is not None and section.width_m > 0.6 * setup.geometry.width_m:
        raise InputError(
            "sensor.yaml",
            f"found {section.width_m} m, expected at most 60 % of the foam's width {setup.geometry.width_m} m",
            field="stripe.width_m",
        )
