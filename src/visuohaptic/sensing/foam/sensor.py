"""The foam sensor: deflection, pressure and force from a camera frame."""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Iterable
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np
from jaxtyping import Bool

from ...core import CalibrationError, Camera, Frame, InputError, PlaneView
from ...core.measurement import Contact, ErrorBudget, ForceProfile, Reason
from .deflection import Deflection, measure_deflection
from .edges import MeasuredEdges, edge_uncertainty_m, measure_edges
from .material.hysteresis import HysteresisState
from .posterior import EdgePosterior, EdgeStates
from .profile import ContactRegion, FoamReading, read_profile
from .shadowed import second_front
from .strip import FoamSensorConfig, FoamSetup, ObservedStrip, StripeView, StripOptics
from .strip.encoding import ENCODINGS, EdgeSkew, edge_skew, encoding_probability
from .strip.zero import ZeroReference, ZeroWatch, check_width
from .validity import Validity, check_known, check_untouched

log = logging.getLogger(__name__)

#: Minimum contrast of the front that docs/howto/build_foam_sensor.md asks for [grey levels].
_MIN_CONTRAST = 40.0
#: Number of recent images that are compared with a new one, because a camera with mixed-up buffers may repeat one of them.
_REMEMBERED_IMAGES = 8


class FoamSensor:
    """A foam strip observed by a camera.

    Parameters
    ----------
    setup
        Configuration with all files that it names, see :meth:`FoamSensorConfig.load`.
    zero
        The strip at rest; without it the reason of every frame is ``not_zeroed``.

    Examples
    --------
    With a real camera and ``sensor.yaml``, use ``FoamSensor.load("sensor.yaml")``; here both are simulated:

    >>> from dataclasses import replace
    >>> from visuohaptic.rigs import VirtualSensor
    >>> virtual, rng = VirtualSensor(), np.random.default_rng(0)
    >>> sensor = virtual.build(".", rng, zero_frames=5)
    >>> (frame,) = virtual.rest_frames(rng, 1)
    >>> profile = sensor.read(replace(frame, t_s=0.1, index=1))
    >>> profile.valid, profile.force_N < 0.1, profile.contacts
    (True, True, ())
    """

    def __init__(self, setup: FoamSetup, zero: ZeroReference | None = None) -> None:
        self.setup = setup
        self.optics = self._make_optics()
        self._watch = self._watching(zero) if zero is not None else None
        if zero is not None:
            self._check_width(float(np.median(zero.width_m)), setup.zero_path)
        self._images: deque[int] = deque(maxlen=_REMEMBERED_IMAGES)
        self._forget()
        self.strip: ObservedStrip | None = None  #: of the last frame, for drawing
        self.reading: FoamReading | None = None  #: of the last frame

    def _make_optics(self) -> StripOptics:
        setup = self.setup
        plane = PlaneView(setup.camera, setup.T_camera_foam)
        return StripOptics(setup.geometry, setup.config.tracking, plane, stripe=StripeView.of(setup))

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Load the sensor that ``sensor.yaml`` describes, with its zero reference if there is one.

        Parameters
        ----------
        path
            The file; file names in it are relative to its folder.

        Raises
        ------
        InputError
            A file or field cannot be used.
        """
        return cls.of_setup(FoamSensorConfig.load(path))

    @classmethod
    def of_setup(cls, setup: FoamSetup) -> Self:
        """Create a sensor from a loaded configuration, with its zero reference if there is one.

        Parameters
        ----------
        setup
            From :meth:`FoamSensorConfig.load`.
        """
        zero = None
        if setup.zero_path.exists():
            zero = ZeroReference.load(setup.zero_path, len(setup.geometry.s_m))
        return cls(setup, zero)

    @property
    def camera(self) -> Camera:
        """Model of the camera that delivers the frames."""
        return self.setup.camera

    @property
    def zeroed(self) -> bool:
        """Whether the sensor has a zero reference."""
        return self._watch is not None

    @property
    def zero_reference(self) -> ZeroReference | None:
        """The current zero reference; ``None`` before :meth:`zero`."""
        return self._watch.zero if self._watch is not None else None

    def zero(self, frames: Iterable[Frame], *, limit: int = 60) -> ZeroReference:
        """Take the zero reference from frames of the untouched strip.

        Parameters
        ----------
        frames
            Frames of the untouched strip.
        limit
            Maximum number of frames to read.

        Raises
        ------
        CalibrationError
            The contours were not found, or the strip moved during zeroing.
        """
        self._watch = None
        self.optics.reset()
        seen: list[ObservedStrip] = []
        skews: list[EdgeSkew] = []
        used = 0
        for used, frame in enumerate(frames, start=1):
            self._check_size(frame)
            strip = self.optics.observe(frame, self.zero_reference)
            if strip is not None:
                seen.append(strip)
                skews.append(edge_skew(frame.grey, strip.reference))
            if used >= limit:
                break
        if len(seen) < max(1, used // 2):
            raise CalibrationError(
                "zero",
                f"the reference contour was found in {len(seen)} of {used} frames",
                remedy="check T_camera_foam in sensor.yaml, the light and the focus",
            )
        wide = self.optics.visible_width_m(frame)
        if np.isfinite(wide):
            self._check_width(wide, "zero")
        widths = np.array(
            [np.where(strip.usable | strip.low_confidence, strip.width_m, np.nan) for strip in seen]
        )
        zero = ZeroReference.from_samples(
            seen[-1].t_s,
            np.array([strip.reference_px for strip in seen]),
            widths,
            np.mean([strip.image for strip in seen], axis=0),
            uncertainty_m=np.mean([np.nan_to_num(edge_uncertainty_m(strip)) for strip in seen], axis=0),
            blur_ratio=np.median(
                [np.nan_to_num(s.front.blur_px, nan=s.blur_px) / s.lens_px for s in seen], axis=0
            ),
            encoded_m=np.mean([np.nan_to_num(strip.encoded_m) for strip in seen], axis=0),
        )
        zero = replace(zero, encoding=encoding_probability(skews))
        self._check_width(float(np.median(zero.width_m)), "zero")
        check_untouched(zero, self.setup.geometry.s_m)
        check_known(zero, seen[-1].width_sigma_m, self.optics.outside, self.setup)
        if self.optics.stripe is None and abs(zero.contrast) < _MIN_CONTRAST:
            log.warning(
                "the foam and what is in front of it differ by %.0f grey levels, expected %.0f or more: frames may not be read; "
                "change the background or the light",
                abs(zero.contrast),
                _MIN_CONTRAST,
            )
        self._warn_of_ends(np.isfinite(widths).sum(axis=0) * 2 >= len(seen))
        self._watch = self._watching(zero)
        self._forget()
        self.optics.forget_motion()
        # The strip is untouched at this time: any contact in the next frame is new.
        self._posterior.start(zero.t_s)
        self._watch.forget(zero.t_s)
        return zero

    def _warn_of_ends(self, shown: Bool[np.ndarray, "K"]) -> None:
        """Warn where no front is seen at an end of the strip, although it is inside the image."""
        inside = np.flatnonzero(~self.optics.outside)
        fronts = np.flatnonzero(shown)
        missing = fronts[0] - inside[0], inside[-1] - fronts[-1]
        cell_m = float(self.setup.geometry.cell_m[0])
        if max(missing) > 0:
            log.warning(
                "no front is seen up to %.0f mm from an end of the strip: frames may not be read when something presses; "
                "check strip in sensor.yaml, or uncover the end",
                1e3 * max(missing) * cell_m,
            )

    def _watching(self, zero: ZeroReference) -> ZeroWatch:
        """Watch the zero reference; the transfer function in the camera file overrides the estimated encoding."""
        known = ENCODINGS.get(self.setup.camera.transfer_function, zero.encoding)
        return ZeroWatch(replace(zero, encoding=known))

    def _check_width(self, measured_m: float, where: Path | str) -> None:
        geometry = self.setup.geometry
        stripe_m = geometry.width_m - self.optics.rest_width_m
        check_width(measured_m, geometry.width_m, where, stripe_m=stripe_m)

    def reset(self) -> None:
        """Discard the last frames and the history of the foam; the zero reference remains."""
        self.optics.reset()
        self._images.clear()
        self._forget()
        if self._watch is not None:
            self._watch.forget()

    def close(self) -> None:
        """Do nothing: a foam sensor holds no resources."""

    def _forget(self) -> None:
        """Start a new history of the foam."""
        geometry = self.setup.geometry
        self._memory = HysteresisState.at_rest(len(geometry.s_m))
        speed = self.setup.config.max_contact_speed_m_s
        self._posterior = EdgePosterior(geometry.s_m, geometry.width_m, speed)
        self._validity = Validity(self.setup)
        self._frame_s = np.inf  # shortest time between two frames
        self._last_t_s: float | None = None

    def read(self, frame: Frame) -> ForceProfile:
        """Deflection, pressure and force of one frame, with uncertainty, validity and reason.

        Frames are passed in the order in which the camera delivers them. A frame that is
        older than the previous one, or a repeated image, is reported as stale.

        Parameters
        ----------
        frame
            The next frame in chronological order.
        """
        self._check_size(frame)
        if self._stale(frame):
            return self.blank(frame.t_s, Reason.STALE)
        strip = self.strip = self.optics.observe(frame, self.zero_reference)
        watch, geometry = self._watch, self.setup.geometry
        if strip is None or watch is None:
            return self.blank(frame.t_s, Reason.LOST if strip is None else Reason.NOT_ZEROED)
        strip, edges, states = self._states(frame, strip, watch.zero)
        self.strip = strip
        found = measure_deflection(edges, states, strip, geometry)
        contour = found.contour(
            geometry, math.hypot(strip.common_sigma_m, watch.sigma_m(strip.t_s, found.delta_m))
        )
        law = self.setup.config.boundary
        reading = read_profile(contour, self.setup.material, boundary=law, memory=self._memory)
        reading, reason = self._validity.evaluate(
            reading, found, strip, frame_s=self._frame_s, drifted=watch.drifted
        )
        self.reading = reading
        if reason is Reason.OK:
            usable = found.states.foam & strip.usable
            watch.update(strip.t_s, strip.width_m, touched=bool(reading.contacts), usable=usable)
        profile = ForceProfile(
            strip.t_s, reason is Reason.OK, reason, reading.force_N, reading.budget,
            geometry.s_m, found.delta_m, found.sigma_m, reading.pressure_Pa, reading.pressure_sigma_Pa,
            found.seen, tuple(self._contact(region, found) for region in reading.contacts),
            found.states.evidence,
        )  # fmt: skip
        return profile if profile.valid else profile.unread()

    def _states(
        self, frame: Frame, strip: ObservedStrip, zero: ZeroReference
    ) -> tuple[ObservedStrip, MeasuredEdges, EdgeStates]:
        """Edges and their states; the front where a shadow's edge hides it is a second edge."""
        width_m, before = self.setup.geometry.width_m, copy(self._posterior)
        edges = measure_edges(strip, zero, width_m, before.last_m)
        states = self._posterior.infer(strip, zero, edges)
        tested = ~states.foam & ~self.optics.outside
        if strip.stripe or not tested.any():
            return strip, edges, states
        second = second_front(frame.grey, strip, self.optics.polarity, tested, before.last_m)
        if second is None:
            return strip, edges, states
        strip = self.optics.with_front(frame, *second, zero)
        edges = measure_edges(strip, zero, width_m, before.last_m)
        self._posterior = before
        return strip, edges, before.infer(strip, zero, edges)

    def _check_size(self, frame: Frame) -> None:
        camera = self.setup.camera
        if frame.image.shape[:2] != (camera.height, camera.width):
            raise InputError(
                f"frame {frame.index}",
                f"found {frame.image.shape[1]} x {frame.image.shape[0]} px, "
                f"expected {camera.width} x {camera.height} as in {self.setup.config.camera}",
            )

    def _stale(self, frame: Frame) -> bool:
        """Whether a frame is out of order or a repetition: the noise of real images never repeats exactly."""
        image = hash(frame.image[:: max(1, frame.image.shape[0] // 64), ::7].tobytes())
        late = self._last_t_s is not None and not frame.t_s > self._last_t_s
        known = image in self._images
        if not known:
            self._images.append(image)  # also of a late frame, which may be repeated with a new time stamp
        if late or known:
            return True
        if self._last_t_s is not None and frame.t_s - self._last_t_s > self.setup.config.max_gap_s:
            self.optics.forget_motion()
        if self._last_t_s is not None:
            self._frame_s = min(self._frame_s, frame.t_s - self._last_t_s)
        self._last_t_s = frame.t_s
        return False

    def _contact(self, region: ContactRegion, found: Deflection) -> Contact:
        """One region with its contour in frame F, without points of unknown deflection."""
        inside = np.arange(region.first, region.last + 1)
        inside = inside[np.isfinite(found.delta_m[inside])]
        geometry = self.setup.geometry
        # From deflections rather than projected pixels: normalised with the zero reference like the force.
        front = geometry.front_m[inside] - found.delta_m[inside, None] * geometry.outward[inside]
        return Contact(
            region.s_start_m, region.s_end_m, region.force_N, region.budget, region.valid, region.reason,
            front, found.sigma_m[inside], found.delta_m[inside],
        )  # fmt: skip

    def blank(self, t_s: float, reason: Reason) -> ForceProfile:
        """A profile without force, only with the reason why there is none.

        Parameters
        ----------
        t_s
            Time of the frame [s].
        reason
            Why the frame was not read.
        """
        unknown = np.full(len(self.setup.geometry.s_m), np.nan)
        return ForceProfile(
            t_s, False, reason, float("nan"), ErrorBudget.unknown(), self.setup.geometry.s_m,
            unknown, unknown, unknown, unknown, np.zeros(len(unknown), dtype=bool),
        )  # fmt: skip
