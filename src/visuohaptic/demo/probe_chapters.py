"""At the table: the beam sensor is zeroed, the camera moves around, and the probe completes transparent parts."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ..core.camera.frame import Frame
from ..io.depth.depth_sequence import DepthFrame
from ..recognition.touch.haptic_model import UNKNOWN
from ..reconstruction.completion.outline import SLICE_M, axial_part, measured_outline, standing_object
from ..sensing.beam import TrackedBeam, compliance
from ..tasks.framework import Capsule, KnownObstacles, Supervisor
from ..tasks.manipulation.complete import CompleteSettings, CompletionByTouch, complete_by_touch
from ..tasks.memory import HEIGHT_SIGMA_M, recognise_container
from .bottle import PLACE
from .judge import Claim
from .report import depth_picture, forces_figure, outline_figure
from .results import ChapterResult, Illustration, Measure, counted, done, failed
from .served import known_loads, place_bottle, rest_count, robot_at_table, view_count
from .story import Known, Mission

if TYPE_CHECKING:
    from ..reconstruction.completion import Completion, Touch
    from ..reconstruction.mesh import SurfaceMesh
    from ..reconstruction.pipeline import Reconstruction

#: Region of interest on the table [m], and its voxels.
LOW, HIGH, VOXEL_M = (-0.3, -0.3, -0.02), (0.3, 0.3, 0.32), 0.006
#: Stopping criterion of the completion [m], and maximum number of probed lines.
BOUND_M, MAX_TOUCHES = 0.0015, 16
#: Above this expected error the outline is not used.
MAX_ERROR_M = 0.010
#: Minimum height of probing above the table: the tip is a few millimetres thick [m].
FLOOR_M = 0.008
#: The probe's rod, vertical above its tip [m].
ROD_M, ROD_RADIUS_M = 0.15, 0.0025
#: Nothing else stands within this distance of the middle of the table [m].
NEAR_M = 0.13
#: Expected error of the radius of an outline that is seen from all sides: .4 to .5 mm rms of five opaque containers of open tables.
#: As evidence of the class, the outline has the error beside edges and grooves, 1 mm [m].
SURFACE_M, EDGE_M = 5e-4, 1e-3
#: Probability that something transparent is not found. The search is set to as many false ones.
MISSED = 0.02
#: Ratio of its widths above which a cross-section is round: half-way between round containers as seen (0.98 to 0.99) and
#: 200 variants of each class that is not round (0.54 to 0.8).
ROUND_RATIO = 0.89
#: Search radius for the bottle around its axis [m].
REACH_M = 0.065


def zero_the_beam(mission: Mission) -> ChapterResult:
    """Read the beam sensor from camera images: unloaded for the zero, then under known loads.

    Parameters
    ----------
    mission
        Receives the zeroed sensor and the noise of its force.
    """
    (loads, _), rows = known_loads(mission), []
    with robot_at_table(mission, "beam") as bench:
        sensor, frames = _zeroed_probe(mission, bench)
        for frame, load in zip(frames, loads, strict=True):
            wrench = sensor.read(frame).reading.wrench
            if wrench.valid:
                rows.append((load[:3], wrench.force_N, np.sqrt(np.diag(wrench.covariance)[:3])))
    if len(rows) < max(2, len(loads) // 2):
        return failed(f"{len(rows)} of {len(loads)} loads could be read")
    true, read, sigma = (np.array(part) for part in zip(*rows, strict=True))
    error = read - true
    # A probe measures the force along the rod's axis and across it: the worst axis counts. The loads are known:
    # with the declared variance as one more sample, the posterior mean of the reading variance is used (inverse gamma).
    spread = np.sqrt((np.mean(sigma**2, axis=0) + np.sum(error**2, axis=0)) / (1 + len(error)))
    mission.known.probe_sigma_N = float(spread.max())
    worst = float(np.max(np.abs(error) / sigma))
    rms = float(np.sqrt(np.mean(error**2)))
    return done(
        f"the probe reads forces with a standard deviation of {1e3 * mission.known.probe_sigma_N:.0f} mN",
        Claim("force", "probe", 0.0, rms, sigma=mission.known.probe_sigma_N),
        Measure("rms error of a force's component [N]", rms),
        Measure("standard deviation after these loads [N]", mission.known.probe_sigma_N),
        Measure("largest error in declared standard deviations", worst),
        Illustration(
            forces_figure(true, read, sigma), "Forces read from the bending rod, compared with those applied"
        ),
        Illustration(frame.image, "The last frame: the reference print at the clamp, two more along the rod"),
    )


def _zeroed_probe(mission: Mission, bench: Any) -> tuple[TrackedBeam, Iterator[Frame]]:
    """The probe's sensor as described by its files, zeroed on images of the unloaded rod, and the images after them."""
    mission.known.probe = sensor = TrackedBeam.load(mission.folder / "beam" / "sensor.yaml")
    frames = iter(bench.camera)
    sensor.zero(itertools.islice(frames, rest_count(mission)))
    return sensor, frames


def default_beam(mission: Mission) -> None:
    """A zeroed sensor, and the noise of its data sheet.

    Parameters
    ----------
    mission
        State of the mission; what the chapter would have found is set.
    """
    with robot_at_table(mission, "beam") as bench:
        _zeroed_probe(mission, bench)
    mission.known.probe_sigma_N = 0.03


def find_the_glass(mission: Mission) -> ChapterResult:
    """Depth views around the table: fuse opaque surfaces, detect transparent regions.

    Parameters
    ----------
    mission
        Receives the reconstruction.
    """
    from ..reconstruction.fusion.volume import SpaceGrid
    from ..reconstruction.pipeline import reconstruct

    bottle, frames = place_bottle(mission), []
    with robot_at_table(mission, "glass") as robot:
        camera = robot.depth.camera
        for index in range(view_count(mission)):
            depth_m = robot.depth.read().depth_m
            frames.append(DepthFrame(0.1 * index, depth_m, None, robot.arm.pose()[1], camera, index))
    mission.log(f"  {len(frames)} views; fusing, and looking for contradictions between them")
    found = reconstruct(frames, grid=SpaceGrid.around(LOW, HIGH, VOXEL_M))
    picture = depth_picture(frames[0], found)
    mission.record_cost(robot.arm.pose()[0])
    if not found.regions:
        return _find_the_opaque(mission, found, picture)
    region = found.regions[0]
    centre = region.centroid_m
    largest = ", the largest" if len(found.regions) > 1 else ","
    mission.log(
        f"  {counted(len(found.regions), 'transparent part')}{largest} {1e3 * region.size_m[2]:.0f} mm high around "
        f"({1e3 * centre[0]:.0f}, {1e3 * centre[1]:.0f}, {1e3 * centre[2]:.0f}) mm"
    )
    mission.scan = found
    mission.known.belief = replace(mission.known.belief, transparent=region.score)
    off = math.hypot(centre[0] - bottle.foot_m[0], centre[1] - bottle.foot_m[1])
    return done(
        f"{counted(len(found.regions), 'transparent part')} found in {len(frames)} views",
        Claim("foot", "bottle", (float(centre[0]), float(centre[1])), bottle.foot_m, sigma=VOXEL_M),
        Claim("transparent", "bottle", True, bottle.transparent, probability=region.score),
        Measure("distance of its middle from the bottle's axis [m]", off),
        Measure("transparent parts", len(found.regions), 1),
        picture,
    )


def _find_the_opaque(mission: Mission, found: Reconstruction, picture: Illustration) -> ChapterResult:
    """An object whose whole outline is seen where nothing is transparent."""
    known, bottle = mission.known, place_bottle(mission)
    foot, *oval = standing_object(found.surface, np.zeros(2), NEAR_M, REACH_M)
    known.squash, known.wide_rad = oval if oval[0] < ROUND_RATIO else (1.0, 0.0)
    surface = _as_round(axial_part(found.surface, foot, REACH_M), foot, known)
    outline = measured_outline(surface, foot, REACH_M)
    # Two slices may miss: a band without a wall is transparent, whether it is found or not.
    if not len(outline) or np.diff(outline[:, 1]).max() > 2.5 * SLICE_M:
        there = "what stands there is not seen whole" if len(outline) else "nothing stands there"
        return failed(f"no view contradicts another: nothing transparent was found, and {there}", picture)
    known.outline_m, known.bottle_at_m, known.outline_sigma_m = outline, foot, SURFACE_M
    known.outline_errors = seen_errors(outline)
    known.belief = replace(known.belief, transparent=MISSED)
    if known.squash < 1.0:
        flat = dict.fromkeys(("elliptic", UNKNOWN), 0.5)
        known.belief = replace(known.belief, classes=flat)
    return done(
        f"{'an oval' if known.squash < 1.0 else 'a round'} opaque object, {1e3 * outline[-1, 1]:.0f} mm high",
        Claim("foot", "bottle", (float(foot[0]), float(foot[1])), bottle.foot_m, sigma=SURFACE_M),
        Claim("transparent", "bottle", False, bottle.transparent, probability=1.0 - MISSED),
        picture,
    )


def seen_errors(outline_m: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k k"]:
    """Covariance of the logarithms of the radii of an outline that is seen from all sides.

    Parameters
    ----------
    outline_m
        Radius and height [m].
    """
    # Half of the error is common to all heights.
    return np.asarray(
        EDGE_M**2 * (0.5 * np.eye(len(outline_m)) + 0.5) / np.outer(outline_m[:, 0], outline_m[:, 0])
    )


def _as_round(surface: SurfaceMesh, foot_m: np.ndarray, known: Known) -> SurfaceMesh:
    """An oval object stretched across its larger width until it is round."""
    across = np.array([-math.sin(known.wide_rad), math.cos(known.wide_rad)])
    points_m = surface.vertices_m.copy()
    points_m[:, :2] += np.outer((points_m[:, :2] - foot_m) @ across, (1.0 / known.squash - 1.0) * across)
    return replace(surface, vertices_m=points_m)


def complete_the_bottle(mission: Mission) -> ChapterResult:
    """Probe where the uncertainty is highest, until it is low enough, and measure the outline.

    Parameters
    ----------
    mission
        Mission with the reconstruction and the beam sensor's noise; receives the outline.
    """
    known, bottle = mission.known, place_bottle(mission)
    if known.belief.transparent < 0.5:
        return done(
            f"all of it is seen, {1e3 * known.outline_m[-1, 1]:.0f} mm high, up to {2e3 * known.outline_m[:, 0].max():.0f} mm wide",
            Claim("shape", "bottle", 0.0, bottle.outline_error_m(known.outline_m), sigma=SURFACE_M),
            Claim("height", "bottle", float(known.outline_m[-1, 1]), bottle.height_m, sigma=HEIGHT_SIGMA_M),
        )
    completion = _visible(mission)
    surface, before_m, foot = completion.visual, completion.expected_error_m(), completion.axis_m
    seen = measured_outline(surface, foot, REACH_M)
    # The foot and the top of a measured outline repeat the slices next to them.
    known.seen = seen[1:-1], float(seen[-1, 1] if len(seen) else surface.vertices_m[:, 2].max())
    touched = _probe(mission, completion, lambda touches: identify(mission, _radial(touches, foot)))
    contacts = _radial(touched.touches, foot)
    mission.log(f"  {len(contacts)} contacts on {len(touched.touches)} lines: {touched.ending.why}")
    if not (touched.ending.success or touched.ending.outcome == "touches_used"):
        return failed(f"{touched.ending.outcome}: {touched.ending.why}")
    if (recalled := mission.known_bottle) is not None:
        # The outline is part of the prior probability of its class.
        outline, error_m, errors = recalled.outline_m, float(np.sqrt(np.mean(recalled.sigma_m**2))), None
    else:
        if len(contacts) < 3:
            return failed(f"{touched.ending.outcome}: {touched.ending.why}; only {len(contacts)} contacts")
        whole = measured_outline(axial_part(completion.completed(), foot, REACH_M), foot, REACH_M)
        outline, error_m = _joined(whole, seen), touched.error_m
        errors = completion.radial.ring_errors(outline) if completion.radial and len(outline) else None
        if errors is not None:  # bottom and lid of the missing surface are no part of the outline
            error_m = float(np.sqrt(np.mean(np.diag(errors) * outline[:, 0] ** 2)))
    if not len(outline) or error_m > MAX_ERROR_M:
        return failed(
            f"after {len(contacts)} contacts the outline is still expected to be {1e3 * error_m:.1f} mm off"
        )
    known.outline_m, known.bottle_at_m, known.outline_sigma_m = outline, np.asarray(foot), error_m
    # It is touched where nothing is seen: search and touch would have to fail.
    known.belief = replace(known.belief, transparent=1.0 - MISSED * (1.0 - known.belief.transparent))
    known.outline_errors = errors
    rms_m = bottle.outline_error_m(outline)
    seen_rms_m = bottle.outline_error_m(seen) if len(seen) else None
    missed = f" ({1e3 * touched.error_m:.2f} mm where it was not seen, {1e3 * BOUND_M:.2f} mm were requested)"
    missed = "" if touched.error_m <= BOUND_M else missed
    number = counted(len(contacts), "contact")
    how, sure = f"{number} complete the outline", math.nan
    if recalled is not None:
        sure, missed = mission.known_bottle_probability, ""
        how = f"{recalled.id} of an earlier visit (probability {sure:.2f}, {number})"
    return done(
        f"{how}: {1e3 * outline[-1, 1]:.0f} mm high, up to {2e3 * outline[:, 0].max():.0f} mm wide, "
        f"expected error {1e3 * error_m:.1f} mm{missed}",
        Claim("shape", "bottle", 0.0, rms_m, sigma=error_m, probability=sure),
        Claim("height", "bottle", float(outline[-1, 1]), bottle.height_m, sigma=HEIGHT_SIGMA_M),
        Measure("expected error of the missing part, before touching [m]", before_m),
        Measure("expected error of the missing part, after [m]", touched.error_m),
        Measure("rms error of the outline's radius [m]", rms_m),
        Measure("rms error of the outline that was only seen [m]", seen_rms_m),
        Illustration(
            outline_figure(outline, bottle, seen, contacts),
            "Outline of the bottle: seen by the camera, touched by the probe, completed, and true",
        ),
    )


def _joined(
    completed_m: Float[np.ndarray, "k 2"], seen_m: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "m 2"]:
    """The visible outline, and between and below its heights the completed one."""
    if len(seen_m) and seen_m[1, 1] > SLICE_M:
        seen_m = seen_m[1:]  # the foot repeats the lowest slice, which is not at the foot
    gap = (np.abs(completed_m[:, 1, None] - seen_m[None, :, 1]) > SLICE_M).all(axis=1)
    return np.vstack([seen_m, completed_m[gap]])[np.argsort(np.append(seen_m[:, 1], completed_m[gap, 1]))]


def identify(mission: Mission, touched_m: Float[np.ndarray, "n 2"]) -> bool:
    """Whether the container is one of an earlier visit, by sight, contacts, and the widths of all squeezes.

    Parameters
    ----------
    mission
        Receives the stored container, or ``None``.
    touched_m
        Radius and height of the contacts [m].
    """
    known, before = mission.known, mission.known_bottle
    known.touched_m = touched_m
    stored = [] if mission.memory is None else mission.memory.bottles()
    felt_m = [(one.surface_m, one.place.height_m) for one in (*known.curves, *known.firm_curves)]
    match = recognise_container(*known.seen, stored, np.vstack([touched_m, np.reshape(felt_m, (-1, 2))]))
    mission.known_bottle, mission.known_bottle_probability = match or (None, 0.0)
    if match and (before is None or match[0].id != before.id):
        names = " or ".join((match[0].id, *match[0].alike))
        mission.log(f"  it looks like {names}, class {match[0].class_name} (probability {match[1]:.2f})")
    elif before is not None and not match:
        mission.log(f"  its side is not where that of {before.id} is: it is another one")
    return match is not None


def _visible(mission: Mission) -> Completion:
    """The visible part of the bottle, and the missing region."""
    from ..reconstruction.completion import Completion, CompletionSettings, HoleRegion

    region = mission.scan.regions[0]
    foot = region.centroid_m[:2]
    wall = axial_part(mission.scan.surface, foot, REACH_M)
    # Points at heights where the wall is transparent may be refracted background: these heights are touched instead.
    height, hull = wall.vertices_m[wall.faces].mean(axis=1)[:, 2], region.hull_m[:, 2]
    among = (height > hull.min() + 2 * VOXEL_M) & (height < hull.max() - 2 * VOXEL_M)
    return Completion(
        wall.submesh(np.flatnonzero(~among)),
        HoleRegion.of_points(region.hull_m),
        CompletionSettings(floor_m=FLOOR_M),
        T_visual_haptic=PLACE.inverse(),
    )


def _probe(
    mission: Mission, completion: Completion, enough: Callable[[Sequence[Touch]], bool]
) -> CompletionByTouch:
    """Touch the true bottle; the force is read from images of the rod."""
    sensor, sigma_N = mission.known.probe, mission.known.probe_sigma_N
    sensor.reset()
    # A lateral contact bends the rod.
    across = float(compliance(sensor.sensor.setup.beam, 1.0)[1, 1])
    settings = CompleteSettings(
        bound_m=BOUND_M,
        touches=MAX_TOUCHES * (1 + mission.attempt),
        touch_N=8 * sigma_N,
        blocked_N=max(1.0, 16 * sigma_N),
        top_m=float(completion.visual.vertices_m[:, 2].max()),
        compliance_m_per_N=across,
        sigma_m=0.0005 + sigma_N * across,
    )
    # Collision test of the probe's rod with the points seen by the camera.
    rod = Capsule((0.0, 0.0, 0.0), (0.0, 0.0, ROD_M), ROD_RADIUS_M)
    obstacles = KnownObstacles((rod,), [PLACE.apply(completion.visual.vertices_m)])
    with robot_at_table(mission, "probe") as robot:
        guard = Supervisor(clock=lambda: robot.arm.pose()[0])
        touched = complete_by_touch(
            guard.arm(robot.arm, obstacles),
            guard.frames(robot.camera),
            guard.force(lambda frame: sensor.read(frame).reading.wrench),
            completion,
            settings,
            T_base_visual=PLACE,
            enough=enough,
        )
        mission.record_cost(robot.arm.pose()[0], len(touched.touches))
    return touched


def _radial(touches: Sequence[Touch], foot_m: np.ndarray) -> Float[np.ndarray, "n 2"]:
    """Radius and height of the contacts [m]."""
    contacts = [one.contact_m for one in touches if one.contact_m is not None]
    points = PLACE.inverse().apply(np.array(contacts).reshape(-1, 3))
    return np.column_stack([np.hypot(*(points[:, :2] - foot_m).T), points[:, 2]])


def default_outline(mission: Mission) -> None:
    """The outline as a completion would return it: ground truth with an error of half a millimetre.

    Parameters
    ----------
    mission
        State of the mission; what the chapter would have found is set.
    """
    bottle = place_bottle(mission)
    off = 5e-4 * mission.rng(24).standard_normal((len(bottle.outline_m), 1))
    mission.known.outline_m = bottle.outline_m + off * (1, 0)
    mission.known.bottle_at_m, mission.known.outline_sigma_m = np.array(bottle.foot_m) + 5e-4, 5e-4
    mission.known.outline_errors = np.diag((5e-4 / bottle.outline_m[:, 0]) ** 2)
