"""The beam sensor: wrenches from template poses, with a reason if a reading is not valid."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from ...core import CalibrationError, InputError, Pose, Reason, Wrench
from ...tracking.pose.plane_pose import pose_difference
from .correction import Correction, prior_correction
from .estimate import LINEAR_LIMIT, BeamEstimate, BeamModel, estimate_wrench
from .mechanics import Beam
from .observation import RelativePoses, TemplateObservation, relative_poses, section_motion
from .zero import BeamDriftSettings, BeamZero, BeamZeroWatch

#: Probability that a valid frame is rejected because its templates disagree, or because its reference seems to have moved.
_DISAGREEMENT = 1e-7
#: Probability that the templates of a valid frame disagree by more than the declared noise, without inflation.
_SURPRISE = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class BeamSetup:
    """Configuration of a sensor."""

    xi: Mapping[str, float]  #: position of each template on the rod, x / L
    T_reference_sensor: Pose  #: frame S in the reference template
    beam: Beam = field(default_factory=Beam)
    correction: Correction | None = None  #: from ``calibrate_beam``; None: the beam's tolerances
    reference: str = "reference"  #: name of the template on the base
    #: ``moving``: the reference is taken from each frame; ``steady``: camera and base are rigidly
    #: connected, so that its noise is averaged
    view: Literal["moving", "steady"] = "moving"
    model: BeamModel = "auto"
    linear_limit: float = LINEAR_LIMIT
    drift: BeamDriftSettings = field(default_factory=BeamDriftSettings)
    stress_limit: float = 0.9  #: fraction of the yield stress beyond which the sensor is saturated
    max_age_s: float = 0.2  #: an older frame is stale
    zero_path: Path | None = None
    camera_path: Path | None = None  #: required to read from images
    templates_path: Path | None = None  #: folder of the templates, for the same

    def __post_init__(self) -> None:
        if not self.xi:
            raise InputError("templates", "found none on the rod, expected at least one")
        for name, xi in self.xi.items():
            if not 0.05 <= xi <= 1:
                raise InputError("templates", f"found xi {xi:g}, expected 0.05 to 1", field=name)
        if self.reference in self.xi:
            raise InputError("templates", f"{self.reference} is both the reference and on the rod")


@dataclass(frozen=True, slots=True, eq=False)
class BeamReading:
    """Reading of one frame: the wrench, and the components of its covariance."""

    wrench: Wrench  #: about the tip, frame S; its covariance is the sum of those below
    noise: Float[np.ndarray, "6 6"]  #: due to the poses of this frame
    zero: Float[np.ndarray, "6 6"]  #: due to the zero reference and its drift
    setup: Float[np.ndarray, "6 6"]  #: due to position errors of the templates that no calibration contains
    calibration: Float[np.ndarray, "6 6"]  #: due to the uncertainty of the compliance
    exact: bool  #: computed with the exact rod; otherwise with the linear beam
    stress: float  #: stress in the rod over its yield stress
    templates: tuple[str, ...]  #: templates used


class BeamSensor:
    """Reads six axes from the poses of templates on a bending rod.

    Parameters
    ----------
    setup
        Beam, templates, correction.
    zero
        Poses at rest; without them every reading is ``not_zeroed``.

    Examples
    --------
    >>> sensor = BeamSensor(BeamSetup({"tip": 1.0}, Pose.identity()))
    >>> sensor.read(0.0, []).wrench.reason
    <Reason.NOT_ZEROED: 'not_zeroed'>
    """

    def __init__(self, setup: BeamSetup, zero: BeamZero | None = None) -> None:
        self.setup = setup
        self.correction = setup.correction or prior_correction(setup.beam)
        self._steady = SteadyReference() if setup.view == "steady" else None
        self._set_zero(zero)
        self._last_t: float | None = None

    @property
    def zero_reference(self) -> BeamZero | None:
        """Poses at rest."""
        return self._zero

    def _set_zero(self, zero: BeamZero | None) -> None:
        self._zero = zero
        self.watch = BeamZeroWatch(self.setup.beam.full_scale, self.setup.drift)
        self._yielded = False

    def zero(self, frames: Iterable[tuple[float, Sequence[TemplateObservation]]]) -> BeamZero:
        """Take the zero from frames (t_s, templates) of an unloaded sensor.

        Parameters
        ----------
        frames
            Time [s] and templates of each frame.

        Raises
        ------
        CalibrationError
            Not enough templates were visible, or the sensor moved during zeroing.
        """
        seen = list(frames)
        steady = None
        if self._steady is not None:
            steady = SteadyReference(max(len(seen), 2))
            for _, templates in seen:
                if self._relative(templates, steady)[1] is Reason.MOVED:
                    raise CalibrationError(
                        "zero", "the reference moved in the view", remedy="hold camera and sensor still"
                    )
            steady.hold()
        found = [relative for _, templates in seen if (relative := self._relative(templates, steady)[0])]
        if not found:
            raise CalibrationError(
                "zero",
                "no frame shows the reference template and one on the rod",
                remedy="make sure that nothing covers them",
            )
        zero = BeamZero.from_frames(seen[-1][0], found, shared=None if steady is None else steady.covariance)
        self._steady = None if steady is None else SteadyReference()
        self._set_zero(zero)
        return zero

    def reset(self) -> None:
        """Reset time, drift and reference; the zero is kept."""
        self._last_t = None
        self._steady = SteadyReference() if self._steady is not None else None
        self._set_zero(self._zero)

    def read(
        self, t_s: float, templates: Sequence[TemplateObservation], *, now_s: float | None = None
    ) -> BeamReading:
        """Wrench of one frame.

        Parameters
        ----------
        t_s
            Time of the frame [s].
        templates
            Poses of the reference and of those on the rod; others are ignored.
        now_s
            Time at which it is read; frames older than ``max_age_s`` are stale.
        """
        if self._zero is None:
            return self._nothing(t_s, Reason.NOT_ZEROED)
        late = now_s is not None and now_s - t_s > self.setup.max_age_s
        if not np.isfinite(t_s) or late or (self._last_t is not None and t_s <= self._last_t):
            return self._nothing(t_s, Reason.STALE)
        self._last_t = t_s
        relative, reason = self._relative(templates, self._steady, set(self._zero.rest.names))
        if relative is None:
            return self._nothing(t_s, reason)
        return self._measure(t_s, relative, reason)

    def _relative(
        self,
        templates: Sequence[TemplateObservation],
        steady: SteadyReference | None,
        requested: set[str] | None = None,
    ) -> tuple[RelativePoses | None, Reason]:
        """Poses in the reference template, or the reason why there are none; with the reason if they are not valid."""
        by_name = {template.name: template for template in templates}
        if len(by_name) != len(templates):
            raise InputError("templates", "a name occurs twice in one frame")
        reference = by_name.get(self.setup.reference)
        seen = bool(reference and reference.valid and reference.T_camera_template)
        reason = Reason.OK
        if steady is not None:
            if seen and reference is not None and reference.T_camera_template is not None:
                reason = steady.update(reference.T_camera_template, reference.covariance)
            if steady.pose is None:
                return None, reference.reason if reference else Reason.LOST
            pose, covariance = steady.pose, steady.covariance
        elif not seen or reference is None or reference.T_camera_template is None:
            return None, reference.reason if reference and not reference.valid else Reason.LOST
        else:
            pose, covariance = reference.T_camera_template, reference.covariance
        names = [name for name in self.setup.xi if requested is None or name in requested]
        there = [by_name[name] for name in names if name in by_name and by_name[name].valid]
        if not there:
            reasons = [by_name[name].reason for name in names if name in by_name]
            return None, reasons[0] if reasons else Reason.LOST
        return relative_poses(pose, covariance, there), reason

    def _measure(self, t_s: float, relative: RelativePoses, reason: Reason) -> BeamReading:
        assert self._zero is not None
        setup = self.setup
        relative = replace(relative, covariance=self._zero.noise * relative.covariance)
        motion = section_motion(
            relative, self._zero.rest, setup.xi, setup.T_reference_sensor, setup.beam.length_m
        )
        try:
            found = estimate_wrench(
                setup.beam,
                motion,
                model=setup.model,
                linear_limit=setup.linear_limit,
                place_left=self.correction.place_left,
            )
        except InputError:  # shape that no rod can have: a template is not at its declared position
            return self._nothing(t_s, Reason.LOST)
        wrench = self.correction.apply(found.wrench)
        noise, zero = self.correction.transform(found.noise), self.correction.transform(found.zero)
        sigma = np.sqrt(np.diag(noise + zero))
        bent = found.stress - 3 * self._stress_sigma(sigma)
        self._yielded = self._yielded or bent > 1.0
        saturated = found.stress > setup.stress_limit or self._spring_at_stop(wrench)
        if reason is Reason.OK and self._disagree(found):
            reason = Reason.DRIFTED
        if saturated:
            reason = Reason.SATURATED
        elif reason is Reason.OK:
            self.watch.update(t_s, wrench, sigma)
            if self.watch.drifted or self._yielded:
                reason = Reason.DRIFTED
        wrench = wrench - self.watch.offset
        zero = zero + self.watch.covariance
        misplaced = self.correction.transform(found.setup_left)
        calibration = self.correction.covariance(wrench)
        # Templates disagree, but not enough for rejection: one of them may have come loose. Noise
        # rarely explains this, so the covariance is inflated accordingly.
        surprise = found.chi2 / chi2_limit(found.freedom, _SURPRISE)
        if surprise > 1:
            whole = noise + zero + self.correction.transform(found.setup)  # as chi^2 takes it
            misplaced = misplaced + (surprise - 1) * whole
        result = Wrench(
            t_s, reason is Reason.OK, reason, wrench[:3], wrench[3:], noise + zero + misplaced + calibration
        )
        return BeamReading(
            result, noise, zero, misplaced, calibration, found.exact, found.stress, relative.names
        )

    def _stress_sigma(self, sigma: Float[np.ndarray, "6"]) -> float:
        beam = self.setup.beam
        return float(np.hypot(*sigma[4:]) + beam.length_m * np.hypot(*sigma[1:3])) / beam.moment_limit_Nm

    def _spring_at_stop(self, wrench: Float[np.ndarray, "6"]) -> bool:
        beam = self.setup.beam
        return bool(
            abs(wrench[0]) > beam.spring_N_per_m * beam.spring_travel_m
            or abs(wrench[3]) > beam.spring_Nm_per_rad * beam.spring_turn_rad
        )

    def _disagree(self, found: BeamEstimate) -> bool:
        """Whether the templates disagree by more than noise and setup allow."""
        return found.chi2 > chi2_limit(found.freedom, _DISAGREEMENT)

    def _nothing(self, t_s: float, reason: Reason) -> BeamReading:
        nothing, unknown = np.full(3, np.nan), np.full((6, 6), np.nan)
        wrench = Wrench(t_s, False, reason, nothing, nothing.copy(), unknown)
        return BeamReading(wrench, unknown, unknown, unknown, unknown, False, float("nan"), ())


def chi2_limit(freedom: int, chance: float) -> float:
    """chi^2 that is exceeded with a probability; infinite without redundancy.

    Parameters
    ----------
    freedom
        Degrees of freedom.
    chance
        The probability.
    """
    if freedom <= 0:
        return float("inf")
    from scipy.special import chdtri

    return float(chdtri(freedom, chance))


class SteadyReference:
    """Mean pose of the reference while camera and sensor base are rigidly connected.

    The lever arm from the reference to the tip converts the reference's small
    rotation noise into half of the noise of F_Y; a mean over ``frames`` frames
    removes it. A bump of the camera is detected by the distance of the new poses
    from the mean: the first such frames are ``moved``, then the mean restarts.
    Corners of a print err together, by more than the tracker declares: the
    covariance of a frame is scaled by the mean squared distance of earlier frames,
    with the declared covariance as one more.

    Parameters
    ----------
    frames
        Maximum number of frames in the mean; older ones are forgotten exponentially.
    patience
        Number of consecutive deviating frames after which the new pose is accepted.
    """

    def __init__(self, frames: int = 100, patience: int = 5) -> None:
        self.frames, self.patience = frames, patience
        self.pose: Pose | None = None
        self.covariance: Float[np.ndarray, "6 6"] = np.full((6, 6), np.nan)
        self._count = 0
        self._deviating = 0
        self._squares = 0.0
        self._held = False

    def hold(self) -> None:
        """Freeze the current mean."""
        self._held = True

    def update(self, pose: Pose, covariance: Float[np.ndarray, "6 6"]) -> Reason:
        """Process one pose; ``moved`` if it does not agree with the previous ones.

        Parameters
        ----------
        pose
            ``T_camera_reference`` in one frame.
        covariance
            Its covariance, axes of the camera [m, rad].
        """
        if self._held:
            return Reason.OK
        if self.pose is None:
            self.pose, self.covariance, self._count = pose, covariance, 1
            return Reason.OK
        offset = pose_difference(self.pose, pose)
        distance = float(offset @ np.linalg.solve(covariance + self.covariance, offset))
        # The first frame has no distance, and stands for the declared covariance.
        declared = max(1.0, (6.0 + self._squares) / (6.0 * self._count))
        if distance > chi2_limit(6, _DISAGREEMENT) * declared:
            self._deviating += 1
            if self._deviating >= self.patience:
                self.pose, self.covariance, self._count, self._deviating = pose, covariance, 1, 0
                self._squares = 0.0
            return Reason.MOVED
        self._deviating = 0
        self._squares = (self._squares + distance) * min(1.0, self.frames / (self._count + 1))
        self._count = min(self._count + 1, self.frames)
        gain = 1 / self._count
        step = gain * offset
        self.pose = Pose(
            Pose.from_rotation_vector(step[3:], np.zeros(3)).rotation @ self.pose.rotation,
            self.pose.translation_m + step[:3],
        )
        self.covariance = (1 - gain) ** 2 * self.covariance + gain**2 * covariance
        return Reason.OK
