"""Charts of a run: force against truth, over time and along the strip, and the error budget.

Every function takes plain arrays or the types of :mod:`visuohaptic.core` and
returns a matplotlib figure without global state, ready for ``savefig`` or
:meth:`visuohaptic.report.html_report.Report.figure`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from ..core import ErrorBudget, Event, ForceProfile, InputError
from ..core.files import literal, new_figure
from .style import COLOURS, CYCLE, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, eq=False)
class ForceRun:
    """Forces of one run, sample by sample."""

    name: str  #: name of the pressed shape or object
    truth_N: Float[np.ndarray, "n"]  #: true force from physics or a reference sensor
    measured_N: Float[np.ndarray, "n"]
    valid: Bool[np.ndarray, "n"] | None = None  #: all valid if None


@dataclass(frozen=True, slots=True, eq=False)
class TimeSeries:
    """One quantity over time."""

    name: str
    value: Float[np.ndarray, "n"]  #: in the unit of its axis; NaN if unknown
    sigma: Float[np.ndarray, "n"]  #: declared standard deviation, in the same unit


@styled
def force_against_truth(runs: Sequence[ForceRun]) -> Figure:
    """Measured force against the truth, as in Alt 2016, Fig. 3.7a, with the error below.

    The curve of each run is a cubic through its valid samples, as in the
    source; the dashed line is the ideal. The grey band is the specification:
    3 % of the truth, or at least 0.1 N.

    Parameters
    ----------
    runs
        Forces of the runs, one colour each.

    Raises
    ------
    InputError
        Forces of a run have different lengths.
    """
    figure, (upper, lower) = new_figure(2, 1, size=(7.2, 6.6), height_ratios=(3, 1.4), sharex=True)
    max_N = 1e-3
    for index, run in enumerate(runs):
        colour = CYCLE[index % len(CYCLE)]
        given = np.ones(len(run.truth_N)) if run.valid is None else run.valid
        truth_N, measured_N, valid = _same_length("ForceRun", run.truth_N, run.measured_N, given)
        good = (valid > 0) & np.isfinite(truth_N) & np.isfinite(measured_N)
        max_N = max(max_N, float(truth_N[good].max(initial=0)), float(measured_N[good].max(initial=0)))
        upper.plot(truth_N[good], measured_N[good], "x", color=colour, ms=4, mew=0.8, alpha=0.55)
        lower.plot(
            truth_N[good], (measured_N - truth_N)[good], "x", color=colour, ms=3.5, mew=0.8, alpha=0.55
        )
        if good.sum() >= 8 and np.ptp(truth_N[good]) > 0:
            grid_N = np.linspace(truth_N[good].min(), truth_N[good].max(), 100)
            curve = np.polynomial.Polynomial.fit(truth_N[good], measured_N[good], 3)
            upper.plot(grid_N, curve(grid_N), color=colour)
        rms_N = float(np.sqrt(np.mean((measured_N - truth_N)[good] ** 2))) if good.any() else float("nan")
        upper.plot(
            [], [], color=colour, marker="x", ms=4, label=literal(f"{run.name}, rms error {rms_N:.3f} N")
        )
    limit_N = 1.05 * max_N
    grid_N = np.linspace(0, limit_N, 200)
    promise_N = np.maximum(0.03 * grid_N, 0.1)
    upper.plot([0, limit_N], [0, limit_N], "--", color=COLOURS["ink"], lw=1.1, label="ideal", zorder=1)
    lower.axhline(0, ls="--", color=COLOURS["ink"], lw=1.1)
    lower.fill_between(grid_N, -promise_N, promise_N, color="#eceff2", lw=0, zorder=0, label="3 % or 0.1 N")
    upper.set(ylabel="measured force [N]", xlim=(0, limit_N), ylim=(min(0, upper.get_ylim()[0]), limit_N))
    lower.set(xlabel="true force [N]", ylabel="error [N]")
    upper.legend(loc="upper left")
    lower.legend(loc="upper left")
    return figure


@styled
def force_over_time(
    t_s: Float[np.ndarray, "n"],
    measured_N: Float[np.ndarray, "n"],
    sigma_N: Float[np.ndarray, "n"],
    *,
    truth_N: Float[np.ndarray, "n"] | None = None,
    valid: Bool[np.ndarray, "n"] | None = None,
    reasons: Sequence[str] = (),
    events: Sequence[Event] = (),
    title: str = "",
) -> Figure:
    """Force over time with its declared two-sigma band, the truth, and the events.

    Invalid samples are crosses on the zero line, labelled with their
    reason; below is the error against the truth with the same band.

    Parameters
    ----------
    t_s
        Times [s].
    measured_N
        Measured force [N].
    sigma_N
        Declared standard deviation [N].
    truth_N
        True force [N]; without it, no errors are shown.
    valid
        Which samples are valid; all by default.
    reasons
        Reason of each invalid sample, one text per sample.
    events
        Events to mark by name.
    title
        Title of the figure.

    Raises
    ------
    InputError
        Arrays have different lengths.

    Examples
    --------
    >>> t_s = np.linspace(0.0, 1.0, 30)
    >>> figure = force_over_time(t_s, 2.0 * t_s, np.full(30, 0.05))
    >>> figure.savefig("force.png")
    """
    t_s, measured_N, sigma_N = _same_length("force_over_time", t_s, measured_N, sigma_N)
    good = np.ones(len(t_s), dtype=bool) if valid is None else np.asarray(valid, dtype=bool)
    shown_N = np.where(good, measured_N, np.nan)
    band_N = 2 * sigma_N
    blue = COLOURS["blue"]
    if truth_N is None:
        figure, (upper,) = new_figure(1, 1, size=(8.6, 3.6))
        bottom = upper
    else:
        (truth_N,) = _same_length("force_over_time", truth_N, length=len(t_s))
        figure, (upper, bottom) = new_figure(2, 1, size=(8.6, 5.2), height_ratios=(3, 1.3), sharex=True)
        upper.plot(t_s, truth_N, color=COLOURS["ink"], lw=1.2, label="true")
        error_N = shown_N - truth_N
        bottom.fill_between(t_s, -band_N, band_N, where=good, color=blue, alpha=0.18, lw=0)
        bottom.plot(t_s, error_N, color=blue, lw=1.0)
        bottom.axhline(0, color=COLOURS["ink"], lw=0.8)
        bottom.set(ylabel="error [N]")
    upper.fill_between(
        t_s, shown_N - band_N, shown_N + band_N, color=blue, alpha=0.22, lw=0, label="± 2 sigma, declared"
    )
    upper.plot(t_s, shown_N, color=blue, label="measured")
    upper.set(ylabel="force [N]")
    _finish(figure, (upper, bottom), t_s, good, reasons, events, title)
    return figure


@styled
def traces_over_time(
    t_s: Float[np.ndarray, "n"],
    panels: Mapping[str, Sequence[TimeSeries]],
    *,
    reasons: Sequence[str],
    events: Sequence[Event] = (),
    title: str = "",
) -> Figure:
    """Quantities over time, each with its declared two-sigma band, and the reasons of invalid samples.

    Parameters
    ----------
    t_s, events, title
        As in :func:`force_over_time`.
    panels
        Traces of each axes, by axis label including the unit.
    reasons
        ``ok``, or the reason of an invalid sample, one text per sample; these are drawn as crosses.

    Raises
    ------
    InputError
        A trace has another length than the times.

    Examples
    --------
    >>> t_s = np.linspace(0.0, 1.0, 30)
    >>> traces = [TimeSeries(axis, k * t_s, np.full(30, 0.1)) for k, axis in enumerate("xyz")]
    >>> figure = traces_over_time(t_s, {"force [N]": traces}, reasons=["ok"] * 30)
    """
    figure, axes = new_figure(len(panels), 1, size=(8.6, 1.0 + 2.3 * len(panels)), sharex=True)
    good = np.array([str(reason) == "ok" for reason in reasons], dtype=bool)
    for place, (label, traces) in zip(axes, panels.items(), strict=True):
        for index, trace in enumerate(traces):
            colour = CYCLE[index % len(CYCLE)]
            time_s, value, sigma = _same_length(f"trace {trace.name}", t_s, trace.value, trace.sigma)
            place.fill_between(time_s, value - 2 * sigma, value + 2 * sigma, color=colour, alpha=0.22, lw=0)
            place.plot(time_s, value, color=colour, label=literal(trace.name))
        place.set(ylabel=literal(label))
        if place is not axes[0]:
            place.legend(loc="upper left", ncols=6)
    band = COLOURS["grey"] if any(len(traces) > 1 for traces in panels.values()) else CYCLE[0]
    axes[0].fill_between([], [], [], color=band, alpha=0.22, lw=0, label="± 2 sigma, declared")
    _finish(figure, axes, np.asarray(t_s, dtype=np.float64), good, reasons, events, title)
    return figure


def _finish(
    figure: Figure, axes: Sequence[Axes], t_s: np.ndarray, good: np.ndarray, reasons: Sequence[str],
    events: Sequence[Event], title: str,
) -> None:  # fmt: skip
    """Add invalid samples, events, legend, title and time axis."""
    upper = axes[0]
    texts = np.array([str(text) for text in reasons] if len(reasons) else [""] * len(t_s), dtype=object)
    colours = [COLOURS[name] for name in ("orange", "pink", "yellow", "grey")]
    for index, reason in enumerate(dict.fromkeys(texts[~good])):
        chosen, said = ~good & (texts == reason), f"invalid: {reason}" if reason else "invalid"
        upper.plot(
            t_s[chosen], np.zeros(chosen.sum()), "x", color=colours[index % 4], ms=5, label=literal(said)
        )
    if len(t_s) > 1:
        upper.set_xlim(float(t_s[0]), float(t_s[-1]))
    _mark_events(upper, events)
    figure.suptitle(literal(title), x=0.02, ha="left", fontsize=10.5)
    axes[-1].set(xlabel="time [s]")
    upper.margins(y=0.16)
    upper.legend(loc="lower left", bbox_to_anchor=(0.0, 1.06), ncols=5, borderaxespad=0.0)


def _mark_events(axes: Axes, events: Sequence[Event]) -> None:
    """A line and a name per event; adjacent names have different heights."""
    last_s, level = -np.inf, 0
    low_s, high_s = axes.get_xlim()
    for event in sorted(events, key=lambda event: event.t_s):
        level = (level + 1) % 3 if event.t_s - last_s < 0.09 * (high_s - low_s) else 0
        last_s = event.t_s
        axes.axvline(event.t_s, color=COLOURS["green"], lw=1.0, ls=(0, (4, 2)))
        near_end = event.t_s > high_s - 0.08 * (high_s - low_s)
        axes.annotate(
            str(event.kind),
            (event.t_s, 0.985 - 0.065 * level),
            xycoords=("data", "axes fraction"),
            xytext=(-3 if near_end else 3, 0),
            textcoords="offset points",
            ha="right" if near_end else "left",
            color=COLOURS["green"],
            fontsize=8.5,
            va="top",
            bbox={"facecolor": "white", "lw": 0, "alpha": 0.85, "pad": 0.6},
        )


@styled
def pressure_profile(profile: ForceProfile, *, title: str = "") -> Figure:
    """Deflection and pressure along the strip, with contacts and invalid points.

    Parameters
    ----------
    profile
        One frame of a foam sensor.
    title
        Shown before time and force.
    """
    figure, (upper, lower) = new_figure(2, 1, size=(8.6, 4.8), sharex=True)
    s_mm = 1e3 * profile.s_m
    rows = (
        (upper, 1e3 * profile.delta_m, 1e3 * profile.delta_sigma_m, "deflection [mm]", COLOURS["orange"]),
        (
            lower,
            1e-3 * profile.pressure_Pa,
            1e-3 * profile.pressure_sigma_Pa,
            "pressure [kPa]",
            COLOURS["blue"],
        ),
    )
    good = profile.point_valid
    for axes, value, sigma, label, colour in rows:
        shown = np.where(good, value, np.nan)
        axes.fill_between(s_mm, shown - 2 * sigma, shown + 2 * sigma, color=colour, alpha=0.22, lw=0)
        axes.plot(s_mm, shown, color=colour, marker=".", ms=3.5)
        axes.plot(s_mm[~good], np.zeros((~good).sum()), "x", color=COLOURS["grey"], ms=5)
        axes.set_ylabel(label)
        # Only within the contact; the adjacent foam is merely dragged along.
        axes.fill_between(
            s_mm, 0.0, 1.0, where=profile.pressure_Pa > 0, transform=axes.get_xaxis_transform(),
            color="#f1ede2", lw=0, zorder=0,
        )  # fmt: skip
    for contact in profile.contacts:
        said = f"{contact.force_N:.2f} ± {contact.force_sigma_N:.2f} N"
        upper.annotate(
            said if contact.valid else f"{said}\n{contact.reason}",
            (1e3 * contact.centre_m, 0.97),
            xycoords=("data", "axes fraction"),
            ha="center",
            va="top",
            fontsize=9,
        )
    upper.margins(y=0.25)
    lower.set_xlabel("position along the strip [mm]")
    state = "" if profile.valid else f", invalid: {profile.reason}"
    total = f"t = {profile.t_s:.2f} s, force {profile.force_N:.2f} ± {profile.force_sigma_N:.2f} N{state}"
    upper.set_title(literal(f"{title}   {total}".strip()))
    return figure


@styled
def error_budget(budgets: Mapping[str, ErrorBudget]) -> Figure:
    """Contributions to the uncertainty of each force: standard deviations by cause.

    Parameters
    ----------
    budgets
        One row per force, by name.
    """
    causes = (
        ("image_N", "image"),
        ("calibration_N", "calibration"),
        ("model_N", "model"),
        ("zero_N", "zero"),
    )
    figure, (axes,) = new_figure(1, 1, size=(8.6, 1.3 + 0.55 * max(len(budgets), 1)))
    height = 0.8 / len(causes)
    for row, budget in enumerate(budgets.values()):
        for index, (field, label) in enumerate(causes):
            axes.barh(
                row - 0.4 + (index + 0.5) * height,
                1e3 * getattr(budget, field),
                height,
                color=CYCLE[index],
                label=label if row == 0 else None,
            )
        total_mN = 1e3 * budget.total_N
        axes.plot([total_mN, total_mN], [row - 0.42, row + 0.42], color=COLOURS["ink"], lw=1.6)
        axes.annotate(
            f"{total_mN:.3g}", (total_mN, row), xytext=(4, 0), textcoords="offset points", va="center"
        )
    axes.plot([], [], color=COLOURS["ink"], label="total")
    axes.set_yticks(range(len(budgets)), [literal(name) for name in budgets])
    axes.set_xlabel("standard deviation of the force [mN]")
    axes.grid(axis="y", visible=False)
    axes.margins(x=0.12)
    axes.invert_yaxis()
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=5)
    return figure


def _same_length(where: str, *arrays: object, length: int | None = None) -> tuple[np.ndarray, ...]:
    """Check that arrays have equal length."""
    found = tuple(np.asarray(array, dtype=np.float64) for array in arrays)
    lengths = {array.shape for array in found} | ({(length,)} if length is not None else set())
    if len(lengths) != 1 or len(next(iter(lengths))) != 1:
        raise InputError(where, f"found arrays of shapes {sorted(lengths)}, expected one length for all")
    return found
