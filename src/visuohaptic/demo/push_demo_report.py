"""Figures of one push: the camera's view with the readings, and the force over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import UInt8

from ..core.camera.plane import PlaneView
from ..report.annotation import FrameNotes, annotated_frame, primitive_outline
from ..report.charts import force_over_time
from ..report.run_tables import primitive_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .push_demo import DemoObject, DemoResult


def force_of_push(one: DemoObject) -> Figure:
    """Force over time of one push, with ground truth and its events.

    Parameters
    ----------
    one
        The push.
    """
    felt, truth_N = zip(*one.samples, strict=True)
    return force_over_time(
        *(
            np.array([getattr(profile, name) for profile in felt])
            for name in ("t_s", "force_N", "force_sigma_N")
        ),
        truth_N=np.array(truth_N),
        valid=np.array([profile.valid for profile in felt]),
        reasons=[profile.reason.value for profile in felt],
        events=one.exploration.events,
    )


def annotated_push(result: DemoResult, one: DemoObject) -> UInt8[np.ndarray, "rows columns 3"] | None:
    """The camera's view at the largest force, with contours, contact and fitted shape (figure 3.10).

    Parameters
    ----------
    result
        Result with the sensor's setup.
    one
        The push.
    """
    if one.picture_bgr is None or one.strip is None:
        return None
    setup = result.sensor.setup
    plane = PlaneView(setup.camera, setup.T_camera_foam)
    strip = one.strip
    profile = max((p for p in one.exploration.profiles if p.valid), key=lambda p: p.force_N)
    # Where it is compressed: beside the object, the foam is only dragged along.
    pressed = [contact.delta_m > 0.1 * np.max(contact.delta_m) for contact in profile.contacts]
    contacts = [
        plane.project(contact.points_foam_m[inside])
        for contact, inside in zip(profile.contacts, pressed, strict=True)
        if np.count_nonzero(inside) > 1
    ]
    shapes = []
    best = one.exploration.fit.best if one.exploration.fit is not None else None
    if best is not None:
        shapes.append(plane.project(primitive_outline(best, reach_m=0.06)))
    return annotated_frame(
        one.picture_bgr,
        FrameNotes(
            reference_px=strip.reference_points_px,
            front_px=strip.front_points_px,
            front_valid=strip.usable | strip.low_confidence,
            contacts_px=contacts,
            primitives_px=shapes,
            lines=(
                f"{one.name}: {profile.force_N:.2f} N ± {profile.force_sigma_N:.2f} N",
                primitive_text(best) or "no primitive",
            ),
        ),
        split=False,
    )
