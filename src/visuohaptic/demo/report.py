"""The report of the demo: one page with every chapter, its reason, its figures and its numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ..report.html_report import Report
from .judge import Claim
from .results import ChapterOutcome, ChapterResult, Illustration, Measure
from .story import Story

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..grasping import GraspPlan
    from ..io.depth.depth_sequence import DepthFrame
    from ..reconstruction.pipeline import Reconstruction
    from ..tasks.manipulation.grasp import LiftPlan
    from ..tasks.manipulation.squeeze_task import SqueezeCurve
    from .bottle import TableBottle

_YES_NO = {True: "yes", False: "no", None: ""}

#: What a claim of each kind states of its object; unit, factor from SI units, and decimals of a number.
_CLAIMS = {
    "place": ("position", "m", 1.0, 2),
    "foot": ("position of its foot", "mm", 1e3, 1),
    "friction": ("static friction", "N", 1.0, 2),
    "fixed": ("is fixed", "", 1.0, 0),
    "withstood": ("withstood the lower bound of its tag", "", 1.0, 0),
    "shape": ("rms error of its outline", "mm", 1e3, 1),
    "height": ("height", "mm", 1e3, 1),
    "fill": ("fill", "%", 1e2, 0),
    "mass": ("mass", "g", 1e3, 1),
    "force": ("rms error of a force", "mN", 1e3, 0),
    "grip": ("is held by the grasp", "", 1.0, 0),
    "transparent": ("is transparent", "", 1.0, 0),
    "requested": ("is a requested one", "", 1.0, 0),
}

#: Unit of a small value -> display unit, and the limit up to which it is used; for errors it always is.
_SMALL = {"m": ("mm", 1e3, 0.1), "N": ("mN", 1e3, 0.1), "kg": ("g", 1e3, 1.0)}


def write_story(story: Story, path: Path | str) -> Path:
    """Write the report as one self-contained HTML file.

    Parameters
    ----------
    story
        The run.
    path
        Path of the HTML file.
    """
    whole, summary = len(story.chapters) > 4, story.summary()
    report = Report(
        "A robot looks, touches and remembers" if whole else "Part of the mission",
        about=f"{summary[0].upper()}{summary[1:]}. Seed {story.mission.seed}, {story.duration_s:.0f} s of computing. "
        'Everything here is simulated. The column "truth" is the state of the simulated world, '
        "which the robot never sees.",
    )
    report.section("Overview")
    report.table([_row(number, one) for number, one in enumerate(story.chapters, 1)])
    if story.mission.fault is not None:
        report.text(f"A fault was switched on: {story.mission.fault.value.replace('_', ' ')}.")
    for number, one in enumerate(story.chapters, 1):
        if one.outcome is ChapterOutcome.SKIPPED:
            continue
        report.section(f"{number}. {one.title}")
        verb = "Done" if one.done else "Failed"
        report.text(f"{verb}: {one.reason}.")
        if one.claims:
            report.table([_claim_row(claim) for claim in one.claims])
        if one.measures:
            compared = any(measure.truth is not None for measure in one.measures)
            columns = ("quantity", "measured", *["truth"] * compared)
            report.table([dict(zip(columns, measure_texts(m), strict=False)) for m in one.measures])
        for picture in one.pictures:
            if isinstance(picture.content, np.ndarray):
                report.image(picture.content, picture.caption)
            else:
                report.figure(picture.content, picture.caption)
    return report.write(path)


def _row(number: int, one: ChapterResult) -> dict[str, Any]:
    return {
        "chapter": f"{number}. {one.title}",
        "outcome": one.outcome.value,
        "reason": one.reason,
        "correct": _YES_NO[one.correct],
        "computing [s]": f"{one.duration_s:.0f}",
    }


def _claim_row(claim: Claim) -> dict[str, Any]:
    what, unit, factor, decimals = _CLAIMS.get(claim.kind, (claim.kind, "", 1.0, 0))

    def shown(value: Any) -> str:
        numbers = value if isinstance(value, tuple) else (value,)
        if not unit or isinstance(value, (str, bool)):
            return ", ".join(map(_shown, numbers))
        # Adding 0 turns a rounded -0 into 0.
        return ", ".join(f"{round(factor * number, decimals) + 0.0:.{decimals}f}" for number in numbers)

    reported = shown(claim.value) + (f" \u00b1 {shown(claim.sigma)}" if math.isfinite(claim.sigma) else "")
    if claim.kind in ("shape", "force"):  # claimed is how large the error is
        reported = f"{shown(claim.sigma)} expected"
    return {
        "claim": f"{claim.what}: {what}" + (f" [{unit}]" if unit else ""),
        "reported": reported,
        "probability": f"{claim.forecast:.3f}",
        "truth": shown(claim.truth),
        "correct": _YES_NO[claim.correct],
    }


def measure_texts(measure: Measure) -> tuple[str, str, str]:
    """Quantity, value and ground truth in a suitable unit.

    Parameters
    ----------
    measure
        Measure with its unit in square brackets at the end of its name.
    """
    name, values = measure.what, [measure.estimate, measure.truth]
    what, _, unit = name.removesuffix("]").rpartition(" [")
    numbers = [abs(v) for v in values if isinstance(v, (int, float)) and not isinstance(v, bool)]
    smaller, factor, limit = _SMALL.get(unit, ("", 1.0, 0.0))
    if numbers and smaller and ("error" in what or max(numbers) <= limit):
        name = f"{what} [{smaller}]"
        values = [factor * v if isinstance(v, (int, float)) else v for v in values]
    return name, _shown(values[0]), _shown(values[1])


def _shown(value: Any) -> str:
    if value is None:
        return "\u2013"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (int, float)):
        return "\u221e" if value == math.inf else f"{value:.3g}"
    return str(value)


def forces_figure(
    true: Float[np.ndarray, "n 3"], read: Float[np.ndarray, "n 3"], sigma: Float[np.ndarray, "n 3"]
) -> Figure:
    """Forces of a sensor beside those applied, and their errors.

    Parameters
    ----------
    true, read, sigma
        Applied and measured forces, and the declared standard deviations [N].
    """
    from ..report.style import CYCLE, draw_axes

    def draw(left: Axes, right: Axes) -> None:
        for axis, name in enumerate("XYZ"):
            given, error = true[:, axis], 1e3 * (read - true)[:, axis]
            left.plot(given, read[:, axis], "o", ms=4, color=CYCLE[axis], label=f"$F_{name}$")
            right.errorbar(given, error, 2e3 * sigma[:, axis], fmt="o", ms=4, capsize=2, color=CYCLE[axis])
        left.axline((0, 0), slope=1, color="0.5", lw=0.8)
        right.axhline(0, color="0.5", lw=0.8)
        left.set(xlabel="applied [N]", ylabel="read [N]")
        right.set(xlabel="applied [N]", ylabel="error, with two sigma [mN]")
        left.legend()

    return draw_axes(1, 2, draw, size=(8.6, 3.6))


def outline_figure(
    outline: Float[np.ndarray, "k 2"],
    bottle: TableBottle,
    seen: Float[np.ndarray, "m 2"],
    contacts: Float[np.ndarray, "n 2"],
) -> Figure:
    """Outline of a bottle: true, completed, seen, and touched.

    Parameters
    ----------
    outline, seen, contacts
        Radius and height [m].
    bottle
        The true one.
    """
    from ..report.style import COLOURS, draw_axes

    def draw(axes: Axes) -> None:
        for side in (1, -1):
            for part, colour, width, label in (
                (bottle.outline_m, COLOURS["ink"], 0.9, "truth"),
                (outline, COLOURS["blue"], 2.0, "completed"),
            ):
                axes.plot(
                    *(1e3 * part * (side, 1)).T, color=colour, lw=width, label=label if side > 0 else None
                )
        axes.plot(*(1e3 * seen).T, ".", color=COLOURS["grey"], label="seen")
        axes.plot(*(1e3 * contacts).T, "o", color=COLOURS["orange"], label="touched")
        axes.set(xlabel="distance from the axis [mm]", ylabel="height [mm]", aspect="equal")
        axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0))

    return draw_axes(1, 1, draw, size=(6.4, 5.6))


def depth_picture(frame: DepthFrame, found: Reconstruction) -> Illustration:
    """A depth view with the detected transparent regions.

    Parameters
    ----------
    frame
        The view.
    found
        Result of all views.
    """
    import cv2

    from ..report.style import draw_axes

    def draw(axes: Axes) -> None:
        shown = axes.imshow(frame.depth_m, cmap="viridis_r", vmin=0.5, vmax=1.4)
        axes.figure.colorbar(shown, ax=axes, label="depth [m]")
        axes.set_facecolor("black")
        for number, region in enumerate(found.regions):
            seen_px = frame.camera.project(frame.T_world_camera.inverse().apply(region.hull_m))
            outline = cv2.convexHull(seen_px.astype(np.float32))[:, 0]
            axes.fill(*outline.T, fill=False, ec="#d55e00", lw=2, label=None if number else "transparent")
        axes.set(xticks=[], yticks=[])
        if found.regions:
            axes.legend(loc="lower right", frameon=True, facecolor="white")

    return Illustration(
        draw_axes(1, 1, draw, size=(8.0, 5.2)),
        "The first depth view, black where the sensor measures nothing, and the part that all views together "
        "find transparent",
    )


def belief_figure(history: Sequence[Mapping[str, float]], curve: SqueezeCurve) -> Figure:
    """Posterior of the classes after each squeeze, and one squeeze.

    Parameters
    ----------
    history
        Probability of each class, after each squeeze.
    curve
        The squeeze.
    """
    from ..report.style import COLOURS, draw_axes

    names = list(history[-1])

    def draw(left: Axes, right: Axes) -> None:
        belief = np.array([[step[name] for step in history] for name in names])
        cells = (0.5, len(history) + 0.5, len(names) - 0.5, -0.5)
        shown = left.imshow(belief, cmap="cividis", vmin=0, vmax=1, aspect="auto", extent=cells)
        left.figure.colorbar(shown, ax=left)
        left.set(title="probability", xlabel="squeeze")
        left.locator_params("x", integer=True, min_n_ticks=1)
        left.set_yticks(range(len(names)), names)
        left.grid(visible=False)
        right.plot(1e3 * curve.deformation_m, curve.force_N, "o-", color=COLOURS["orange"])
        right.set(xlabel="deformation of one side [mm]", ylabel="force of one finger [N]")

    return draw_axes(1, 2, draw, size=(8.6, 3.4))


def grasp_figure(plan: GraspPlan, lift: LiftPlan, outline_m: np.ndarray, lifted: bool) -> Figure:
    """Score and stiffness, unrolled, with the best grasp; and the bottle in the fingers.

    Parameters
    ----------
    plan
        Grasps with their map.
    lift
        The grasp as executed.
    outline_m
        Half of the width between the fingers, and height of the bottle [m].
    lifted
        Whether it was lifted.
    """
    from scipy.interpolate import griddata

    from ..report.style import COLOURS, draw_axes

    points, used = plan.surface.vertices_m, np.unique(plan.surface.faces)
    around = np.degrees(np.arctan2(points[used, 1], points[used, 0]))
    stiffness = 1e-3 * np.asarray(plan.surface.stiffness_N_per_m)[used]
    # A rim that is a hundred times as stiff as the wall would leave one colour for the wall.
    low, high = np.percentile(stiffness[np.isfinite(stiffness)], [2, 98])
    fields: tuple[tuple[np.ndarray, str, dict[str, Any]], ...] = (
        (plan.scores.pair[used], "score of both fingers", {}),
        (stiffness, "stiffness [N/mm]", {"norm": "log", "vmin": low, "vmax": high}),
    )
    height_mm = 1e3 * points[used, 2]
    at_deg_mm = np.meshgrid(np.arange(-180, 180, 5), np.linspace(height_mm.min(), height_mm.max(), 60))

    def draw(*axes: Axes) -> None:
        for at, (values, label, scale) in zip(axes, fields, strict=False):
            field = griddata((around, height_mm), values, at_deg_mm, method="nearest", rescale=True)
            shown = at.pcolormesh(*at_deg_mm, field, shading="nearest", rasterized=True, **scale)
            bar = at.figure.colorbar(shown, ax=at, extend="both" if scale else "neither")
            if scale:  # the scale is rarely longer than a decade
                bar.set_ticks(np.geomspace(low, high, 5).tolist(), minor=False)
                bar.ax.minorticks_off()
                bar.ax.yaxis.set_major_formatter("{x:.2g}")
            at.set(xlabel="angle about the axis [deg]", ylabel="height [mm]", title=label)
            at.grid(visible=False)
            for place in (plan.grasps[0].first_m, plan.grasps[0].second_m):
                angle = math.degrees(math.atan2(place[1], place[0]))
                at.plot(angle, 1e3 * place[2], "o", ms=11, mfc="none", mew=2, color=COLOURS["orange"])
        _draw_lift(axes[-1], lift, outline_m, lifted)

    return draw_axes(1, 3, draw, size=(11.0, 4.2))


def _draw_lift(axes: Axes, lift: LiftPlan, outline_m: np.ndarray, lifted: bool) -> None:
    """Outline of the bottle on the table and lifted, and the fingers beside it."""
    from matplotlib.patches import Rectangle

    from ..report.style import COLOURS

    up_mm = 1e3 * lift.lift_m if lifted else 0.0
    radius_mm, height_mm = 1e3 * outline_m.T
    for rise_mm, style, colour in ((0.0, "--", COLOURS["grey"]), (up_mm, "-", COLOURS["blue"])):
        heights_mm = np.append(height_mm, height_mm[::-1]) + rise_mm
        axes.plot(np.append(-radius_mm, radius_mm[::-1]), heights_mm, ls=style, color=colour)
    grip_mm = 1e3 * lift.place.height_m
    reach_mm = float(np.interp(grip_mm, height_mm, radius_mm))
    for left_mm in (reach_mm, -reach_mm - 30.0):
        axes.add_patch(Rectangle((left_mm, grip_mm + up_mm - 8.0), 30.0, 16.0, color="#d55e00", alpha=0.8))
    axes.axhline(0, color=COLOURS["ink"], lw=0.8)
    axes.set(xlabel="distance from the axis [mm]", ylabel="height above the table [mm]", aspect="equal")
