"""Comparison of two records of one force: a run against a scale, another sensor, or another run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from ..core import InputError, normal_sigmas
from .charts import ForceRun, force_against_truth, force_over_time
from .html_report import Report

#: Half width of the 90 % interval of a normal distribution, in standard deviations.
_BAND_90 = normal_sigmas(0.1)
#: Deviation of a normal distribution that is exceeded once in a thousand, in standard deviations.
_RARE = normal_sigmas(1e-3)
#: Maximum number of clock offsets tried: an hour in half frames at 30 Hz, some seconds of computation.
MAX_STEPS = 250_000


@dataclass(frozen=True, slots=True, eq=False)
class ForceRecord:
    """A force over time, n samples in temporal order.

    Raises
    ------
    InputError
        There are no samples, or the columns differ in length.
    """

    name: str
    t_s: Float[np.ndarray, "n"]
    force_N: Float[np.ndarray, "n"]
    sigma_N: Float[np.ndarray, "n"]  #: declared standard deviation; 0 if none is declared
    valid: Bool[np.ndarray, "n"]
    reasons: tuple[str, ...] = ()  #: reasons of invalid samples, one text per sample

    def __post_init__(self) -> None:
        counts = {len(self.t_s), len(self.force_N), len(self.sigma_N), len(self.valid)}
        if len(counts) > 1 or 0 in counts:
            raise InputError(
                self.name, f"found columns of {sorted(counts)} samples, expected one or more, alike in all"
            )


@dataclass(frozen=True, slots=True, eq=False)
class ForceComparison:
    """A run and a reference, on the clock of the run."""

    run: ForceRecord
    reference: ForceRecord
    expected_N: Float[np.ndarray, "n"]  #: the reference at the samples of the run; NaN beyond its ends
    offset_s: float  #: time of the reference at time 0 of the run
    offset_sigma_s: float  #: 0 if the offset was given
    compared: int  #: number of samples valid in both
    read: float  #: fraction of valid samples in the run, among those covered by the reference
    bias_N: float  #: mean of run minus reference
    rms_N: float  #: root mean square of run minus reference
    gain: float  #: run = gain * reference, least squares
    gain_sigma: float  #: largest standard deviation of the gain with the declared sigma, over all correlations of the errors
    rms_over_sigma: float  #: root mean square of the error over its declared sigma; 1 if sigma is calibrated
    coverage_90: float  #: fraction of the samples whose reference is inside the declared 90 % interval

    def lines(self) -> tuple[str, ...]:
        """Summary of the results, as text lines."""
        clock = f"clocks {self.offset_s:+.3f} s apart"
        if self.offset_sigma_s > 0:
            clock += f" +- {self.offset_sigma_s:.3f} s, as the forces agree best"
        found = (
            f"{self.compared} samples compared, {100 * self.read:.0f} % of the run read, {clock}",
            f"error {self.rms_N:.3f} N rms, mean {self.bias_N:+.3f} N, scale {100 * (self.gain - 1):+.1f} %",
            f"rms of error / sigma {self.rms_over_sigma:.2f} (1 if the declared sigma is correct), "
            f"{100 * self.coverage_90:.0f} % inside the declared 90 % interval",
        )
        if abs(self.gain - 1) <= _RARE * self.gain_sigma or not np.isfinite(self.gain_sigma):
            return found
        return (
            *found,
            f"the forces differ by a factor of {self.gain:.2f}, the declared sigma explains "
            f"+- {100 * self.gain_sigma:.1f} %: calibrate again (foam of another batch, another size, a reference in "
            "another unit)",
        )


def compare_forces(
    run: ForceRecord, reference: ForceRecord, *, offset_s: float | None = None, max_offset_s: float = 2.0
) -> ForceComparison:
    """Compare a run with a reference that may use another clock.

    The reference is interpolated linearly between its samples. If it has fewer than the run, only the samples of the run
    nearest to those of the reference are compared: a press between two readings of a scale is unknown. Where it declares no
    standard deviation, the smallest step of its values is its resolution, a uniform error. If the offset of the clocks is not given, it is
    the one with the smallest sum of squares, refined by a parabola whose curvature gives its standard deviation.

    Parameters
    ----------
    run
        The run to evaluate.
    reference
        The reference to compare it with.
    offset_s
        Time of the reference at time 0 of the run [s]; estimated by default.
    max_offset_s
        Maximum offset between the clocks [s].

    Returns
    -------
    ForceComparison
        Errors, and their consistency with the declared sigma.

    Raises
    ------
    InputError
        Fewer than ten samples can be compared, the times of the reference decrease, or the force is constant, so that the
        offset is undetermined.

    Examples
    --------
    >>> t_s = np.linspace(0.0, 4.0, 121)
    >>> press_N = 2.0 * np.sin(t_s) ** 2
    >>> always = np.ones(121, dtype=bool)
    >>> run = ForceRecord("foam", t_s, press_N + 0.02, np.full(121, 0.02), always)
    >>> scale = ForceRecord("scale", t_s + 0.5, press_N, np.zeros(121), always)
    >>> found = compare_forces(run, scale)
    >>> round(found.offset_s, 2)
    0.5
    """
    truth_N = np.where(reference.valid, reference.force_N, np.nan)
    if np.isfinite(truth_N).sum() < 2:
        raise InputError(
            reference.name, f"found {np.isfinite(truth_N).sum()} valid samples, expected two or more"
        )
    if not (np.diff(reference.t_s) >= 0.0).all():
        raise InputError(
            reference.name, "found times that decrease or are NaN, expected them in temporal order"
        )
    sigma_s = 0.0
    if offset_s is None:
        offset_s, sigma_s = _clock_offset(run, reference.name, reference.t_s, truth_N, max_offset_s)
    expected_N, expected_sigma_N = (
        _at(run.t_s + offset_s, reference.t_s, values) for values in (truth_N, reference.sigma_N)
    )
    read = run.valid & np.isfinite(run.force_N)
    covered = np.isfinite(expected_N) & _nearest(run.t_s + offset_s, reference.t_s)
    good = covered & read
    if good.sum() < 10:
        # A run may be long enough, and its reference have too few readings to compare it at.
        few = (np.isfinite(expected_N) & read).sum() >= 10
        where = f"at the readings of {reference.name}" if few else f"while {reference.name} was recorded"
        raise InputError(
            run.name,
            f"found {good.sum()} valid samples {where}, expected ten or more",
            remedy="record longer, or with more readings a second" if few else "check the clocks",
        )
    error_N = (run.force_N - expected_N)[good]
    declared = bool((np.hypot(run.sigma_N, expected_sigma_N)[good] > 0).all())
    rounding_N = np.where(expected_sigma_N > 0, 0.0, _resolution(truth_N) / np.sqrt(12.0))
    sigma_N = np.hypot(run.sigma_N, expected_sigma_N + rounding_N)[good]
    squares = float(expected_N[good] @ expected_N[good])
    gain_sigma = (
        float(np.abs(expected_N[good]) @ sigma_N) / squares if declared and squares > 0 else float("nan")
    )
    return ForceComparison(
        run=run,
        reference=reference,
        expected_N=expected_N,
        offset_s=float(offset_s),
        offset_sigma_s=sigma_s,
        compared=int(good.sum()),
        read=float(good.sum() / covered.sum()),
        bias_N=float(error_N.mean()),
        rms_N=float(np.sqrt(np.mean(error_N**2))),
        gain=float(run.force_N[good] @ expected_N[good]) / squares if squares > 0 else float("nan"),
        gain_sigma=gain_sigma,
        rms_over_sigma=float(np.sqrt(np.mean((error_N / sigma_N) ** 2))) if declared else float("nan"),
        coverage_90=float(np.mean(np.abs(error_N) <= _BAND_90 * sigma_N)) if declared else float("nan"),
    )


def write_comparison(comparison: ForceComparison, path: Path | str) -> Path:
    """Write a page with both forces over time, a scatter plot, and a summary.

    Parameters
    ----------
    comparison
        From :func:`compare_forces`.
    path
        Path of the HTML file.
    """
    run, reference = comparison.run, comparison.reference
    report = Report(
        f"{run.name} compared with {reference.name}", about="Force of a sensor compared with a reference."
    )
    report.section("Summary").text("\n\n".join(comparison.lines()))
    report.section("Over time")
    report.figure(
        force_over_time(
            run.t_s, run.force_N, run.sigma_N,
            truth_N=comparison.expected_N, valid=run.valid, reasons=run.reasons,
        ),
        f"{run.name} with its declared band, {reference.name} as the true force; below, their difference",
    )  # fmt: skip
    report.section("Measured against reference")
    good = run.valid & np.isfinite(comparison.expected_N)
    report.figure(
        force_against_truth([ForceRun(run.name, comparison.expected_N[good], run.force_N[good])]),
        f"Force of {run.name} against that of {reference.name}",
    )
    return report.write(path)


def _at(
    t_s: Float[np.ndarray, "n"], known_s: Float[np.ndarray, "m"], values: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "n"]:
    """Interpolated values; NaN before the first and after the last sample, and next to a NaN sample."""
    return np.interp(t_s, known_s, values, left=np.nan, right=np.nan)


def _nearest(t_s: Float[np.ndarray, "n"], known_s: Float[np.ndarray, "m"]) -> Bool[np.ndarray, "n"]:
    """Samples that are nearest to a known one, where the known ones are farther apart; else all."""
    if len(t_s) < 2 or np.median(np.diff(known_s)) <= np.median(np.diff(t_s)):
        return np.ones(len(t_s), dtype=bool)
    known_s = known_s[(known_s >= t_s[0]) & (known_s <= t_s[-1])]
    at = np.clip(np.searchsorted(t_s, known_s), 1, len(t_s) - 1)
    chosen = np.zeros(len(t_s), dtype=bool)
    chosen[at - (known_s - t_s[at - 1] < t_s[at] - known_s)] = True
    return chosen


def _resolution(values: Float[np.ndarray, "m"]) -> float:
    """Smallest difference of two values."""
    steps = np.diff(np.unique(values[np.isfinite(values)]))
    return float(steps.min()) if len(steps) else 0.0


def _clock_offset(
    run: ForceRecord,
    name: str,
    known_s: Float[np.ndarray, "m"],
    known_N: Float[np.ndarray, "m"],
    max_offset_s: float,
) -> tuple[float, float]:
    """Offset of the reference's clock with the best agreement of both forces, and its standard deviation [s]."""
    good = run.valid & np.isfinite(run.force_N)
    t_s, force_N = run.t_s[good], run.force_N[good]
    step_s = 0.5 * float(np.median(np.diff(run.t_s))) if len(run.t_s) > 1 else max_offset_s
    steps = max_offset_s / max(step_s, 1e-4)
    if not 0 < steps <= MAX_STEPS:
        raise InputError(
            "max_offset_s",
            f"found {max_offset_s:g} s, expected more than 0 and at most {MAX_STEPS * step_s:g} s",
        )
    count = int(np.ceil(steps))
    offsets = step_s * np.arange(-count, count + 1)
    mean_square = np.full(len(offsets), np.inf)
    for k, offset in enumerate(offsets):
        error = force_N - _at(t_s + offset, known_s, known_N)
        inside = np.isfinite(error)
        # At least half of the run must overlap with the reference: an empty overlap agrees with everything.
        if inside.sum() >= max(10, len(t_s) // 2):
            mean_square[k] = float(np.mean(error[inside] ** 2))
    best = int(np.argmin(mean_square))
    if not np.isfinite(mean_square[best]):
        raise InputError(
            name,
            f"covers less than half of the run for every offset within {max_offset_s:g} s: it begins at "
            f"{known_s[0]:.3f} s, the run at {run.t_s[0]:.3f} s",
            remedy="give --offset, or a larger --max-offset",
        )
    if not 0 < best < len(offsets) - 1 or not np.isfinite(mean_square[best - 1 : best + 2]).all():
        raise InputError(
            name,
            f"the forces agree best at the end of the search, {offsets[best]:+.2f} s; "
            "expected a force that changes, or a larger --max-offset",
        )
    lower, middle, upper = mean_square[best - 1 : best + 2]
    curvature = float(lower - 2 * middle + upper)
    if curvature <= 0:
        raise InputError(
            name, "the force does not change, so the offset of the clocks cannot be estimated; give --offset"
        )
    shift = 0.5 * float(lower - upper) / curvature
    least = float(middle) - 0.25 * float(lower - upper) * shift
    # chi^2 = n * mean square / its minimum increases by 1 at one standard deviation.
    sigma_s = step_s * float(np.sqrt(max(least, 0.0) * 2.0 / (curvature * len(t_s))))
    return float(offsets[best] + shift * step_s), sigma_s
