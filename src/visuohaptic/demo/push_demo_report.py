"""The report of the first story: one page with every figure of the run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import UInt8

from ..core.camera.plane import PlaneView
from ..core.geometry import rotation_2d
from ..core.measurement import EventKind
from ..report.annotation import FrameNotes, annotated_frame, primitive_outline
from ..report.charts import (
    ForceRun,
    error_budget,
    force_against_truth,
    force_over_time,
    pressure_profile,
)
from ..report.floor_chart import MapObject, floor_map
from ..report.html_report import Report
from ..report.run_tables import primitive_text, tag_rows
from ..simulation.mobile.obstacles import ObstacleKind, SimulatedObstacle

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .push_demo import DemoObject, DemoResult

__all__ = ["annotated_push", "error_figures", "force_of_push", "write_report"]


def write_report(result: DemoResult, path: Path | str) -> Path:
    """Write the report as one HTML file that needs nothing else.

    Parameters
    ----------
    result
        Of the run.
    path
        Of the HTML file.
    """
    report = Report(
        "A platform touches three obstacles",
        about="Force and shape read from camera frames of a strip of foam, beside the truth of the physics. "
        "Everything here is simulated: the foam's law and the camera's picture are written apart from "
        "what reads them.",
    )
    report.section("What was felt")
    tags = tag_rows({one.name: one.tag for one in result.objects})
    report.table(_turned(tags), "Haptic tags, value +- sigma")
    report.table(_turned(_against_truth(result)), "Against the truth of the physics")
    report.figure(
        _map(result), "The platform's path through the map; dashed outlines are where objects ended"
    )
    for one in result.objects:
        _object(report, result, one)
    report.section("All forces against the truth")
    report.figure(
        force_against_truth([_run(one) for one in result.objects]),
        "Measured against true force as in figure 3.7a; the band is the larger of 3 % and 0.1 N",
    )
    report.table(_turned([error_figures(one) for one in result.objects]), "Errors of the valid frames")
    report.section("The foam")
    report.figure(
        _foam(result), "Calibration: strain and stress as in figure 3.2, and the sensitivity of figure 3.4"
    )
    report.section("How this was made")
    report.text(
        f"{sum(len(one.samples) for one in result.objects)} frames of 1600 x 896 px in {result.duration_s:.0f} s "
        f"of computing, written to {result.folder.name}/: run.mcap (ROS 2 messages), run.csv, sensor.yaml, foam.yaml."
    )
    return report.write(path)


def error_figures(one: DemoObject) -> dict[str, Any]:
    """Error of the valid readings of one push against the truth.

    Parameters
    ----------
    one
        The push.

    Returns
    -------
    dict
        Heading with unit -> value; without errors when nothing was touched.
    """
    valid = np.array([sample.valid for sample in one.samples])
    truth = np.array([sample.truth_N for sample in one.samples])
    error = np.array([sample.measured_N for sample in one.samples]) - truth
    sigma = np.array([sample.sigma_N for sample in one.samples])
    touched = valid & (truth > 0.1)
    if not touched.any():
        return {"object": one.name, "frames": len(one.samples), "valid": int(valid.sum())}
    return {
        "object": one.name,
        "frames": len(one.samples),
        "valid": int(valid.sum()),
        "largest force [N]": float(truth.max()),
        "rms error [N]": float(np.sqrt(np.mean(error[touched] ** 2))),
        "median error [%]": float(100 * np.median(np.abs(error[touched]) / truth[touched])),
        "worst error / sigma": float(np.max(np.abs(error[touched]) / sigma[touched])),
    }


def force_of_push(one: DemoObject) -> Figure:
    """Force over time of one push, beside the truth, with its events.

    Parameters
    ----------
    one
        The push.
    """
    samples = one.samples
    return force_over_time(
        np.array([s.t_s for s in samples]),
        np.array([s.measured_N for s in samples]),
        np.array([s.sigma_N for s in samples]),
        truth_N=np.array([s.truth_N for s in samples]),
        valid=np.array([s.valid for s in samples]),
        reasons=[s.reason for s in samples],
        events=one.exploration.events,
    )


def annotated_push(
    result: DemoResult, one: DemoObject, *, split: bool = True
) -> UInt8[np.ndarray, "rows columns 3"] | None:
    """The camera's view at the largest force, with contours, contact and fitted shape (figure 3.10).



    Parameters
    ----------
    result
        With the sensor's setup.
    one
        The push.
    split
        Show the gradient in the lower part.
    """
    if one.picture_bgr is None or one.strip is None:
        return None
    setup = result.sensor.setup
    plane = PlaneView(setup.camera, setup.T_camera_foam)
    strip = one.strip
    profile = max((p for p in one.exploration.profiles if p.valid), key=lambda p: p.force_N)
    # Where it is pressed: beside the object the foam is only drawn along.
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
                f"{one.name}: {profile.force_N:.2f} N +- {profile.force_sigma_N:.2f} N",
                primitive_text(best) or "no primitive",
            ),
        ),
        split=split,
    )


def _turned(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A table with a column per object: there are few objects and many properties."""
    names = [str(row["object"]) for row in rows]
    properties = [key for key in rows[0] if key != "object"]
    return [
        {"property": key, **{name: row.get(key) for name, row in zip(names, rows, strict=True)}}
        for key in properties
    ]


def _object(report: Report, result: DemoResult, one: DemoObject) -> None:
    report.section(one.name[:1].upper() + one.name[1:])
    picture = annotated_push(result, one)
    if picture is not None:
        report.image(
            picture,
            "What the camera sees at the largest force: reference and front contour, contact region and "
            "fitted shape; the lower part shows the gradient that the contours are found in",
        )
    report.figure(force_of_push(one), "Force over time with two sigma, the truth, and the events")
    pressed = [p for p in one.exploration.profiles if p.valid and p.contacts]
    if pressed:
        profile = max(pressed, key=lambda p: p.force_N)
        report.figure(
            pressure_profile(profile), "Deflection and pressure along the strip at the largest force"
        )
        report.figure(error_budget({one.name: profile.budget}), "Where its uncertainty comes from")


def _against_truth(result: DemoResult) -> list[dict[str, Any]]:
    rows = []
    for one in result.objects:
        obstacle, tag = one.path.obstacle, one.tag
        fixed = not obstacle.movable
        rows.append(
            {
                "object": one.name,
                "fixed, felt": tag.fixed,
                "fixed, true": fixed,
                "static friction, felt [N]": tag.static_friction_N.value if tag.static_friction_N else None,
                "static friction, true [N]": None if fixed else obstacle.static_friction_N,
                "dynamic friction, felt [N]": tag.dynamic_friction_N.value
                if tag.dynamic_friction_N
                else None,
                "dynamic friction, true [N]": None if fixed else obstacle.dynamic_friction_N,
                "turn, felt [deg/m]": _degrees(
                    tag.rotation_rad_per_m.value if tag.rotation_rad_per_m else None
                ),
                "turn while pushed, seen [deg]": _degrees(_turn_seen(one)),
                "turn while pushed, true [deg]": None if fixed else _degrees(one.turn_true_rad),
                "falls, seen": tag.falls,
                "falls, true": any(event.kind is EventKind.FALL for event in one.true_events),
                "seen ahead of the foam [mm]": _millimetres(one.exploration.seen_ahead_m),
                "touched later than expected [mm]": _millimetres(one.touch_error_m),
                "shape, fitted": primitive_text(tag.primitive),
                "shape, true": _true_shape(obstacle),
            }
        )
    return rows


def _turn_seen(one: DemoObject) -> float | None:
    angles = one.exploration.object_angle_rad
    angles = angles[np.isfinite(angles)]
    return float(angles[-1] - angles[0]) if len(angles) > 1 else None


def _degrees(value: float | None) -> float | None:
    return float(np.degrees(value)) if value is not None and np.isfinite(value) else None


def _millimetres(value: float) -> float | None:
    return 1e3 * value if np.isfinite(value) else None


def _true_shape(obstacle: SimulatedObstacle) -> str:
    """The shape that the foam met, in the words of the fitted ones."""
    if obstacle.kind is ObstacleKind.CYLINDER:
        return f"circle, radius {500 * obstacle.length_m:.1f} mm"
    return f"segment, {1e3 * obstacle.width_m:.1f} mm long"


def _run(one: DemoObject) -> ForceRun:
    touched = [s for s in one.samples if s.truth_N > 0.02]
    return ForceRun(
        one.name,
        np.array([s.truth_N for s in touched]),
        np.array([s.measured_N for s in touched]),
        np.array([s.valid for s in touched], dtype=bool),
    )


def _map(result: DemoResult) -> Any:
    grid = result.grid
    x, y, yaw = grid.origin

    def aligned(points_m: np.ndarray) -> np.ndarray:
        """World to the axes of the map's picture, which may be turned."""
        return (points_m - [x, y]) @ rotation_2d(yaw)

    objects = []
    for one in result.objects:
        obstacle = one.path.obstacle
        outline = obstacle.outlines[0]
        start = aligned(outline.moved(obstacle.x_m, obstacle.y_m, obstacle.yaw_rad).polygon_m())
        end = aligned(outline.moved(*one.end_pose).polygon_m()) if obstacle.movable else None
        objects.append(MapObject(one.name, start, one.tag, end))
    return floor_map(
        grid.cells, grid.resolution_m, (0.0, 0.0), path_world_m=aligned(result.track_m), objects=objects
    )


def _foam(result: DemoResult) -> Any:
    from matplotlib.figure import Figure

    from ..sensing.foam.material.calibration import calibrate_foam
    from ..sensing.foam.material.material_plots import draw_sensitivity, draw_strain_stress
    from ..sensing.foam.material.records import read_strain_stress

    material = result.sensor.setup.material
    found = calibrate_foam(
        read_strain_stress(result.folder / "strain_stress.csv"),
        width_m=material.width_m,
        height_m=material.height_m,
    )
    figure = Figure(figsize=(9.6, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    draw_strain_stress(left, found)
    draw_sensitivity(right, found)
    return figure
