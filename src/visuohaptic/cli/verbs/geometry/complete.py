"""``visuohaptic complete``: extend a visible surface into a transparent region or a hidden one, and plan the next touch.

reads   a surface (PLY, metres, z up); regions.json with the transparent regions, or --hidden; with --touches a CSV table with
        x_m, y_m, z_m and optionally start_x_m ..., end_x_m ..., sigma_m (no contact: x_m is empty);
        --clear needs the outlines that `reconstruct` writes into regions.json (axis, radius, height)
writes  the completed surface (PLY) with sigma_m, the standard deviation of each vertex [m]

example: visuohaptic complete surface.ply --region regions.json --out completed.ply --next
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from .... import core, reconstruction
from ....core.files.plain_json import picked
from ....io import meshes

if TYPE_CHECKING:
    from ....reconstruction.body_completion import BodyCompletion
    from ....reconstruction.completion import Completion, HoleRegion, Touch, TouchPlan

#: Optional modules that the verb imports.
NEEDS = ("robust_laplacian", "skimage")
#: Default distances of further fingers from the first [m].
_APART_M = (0.01, 0.1)


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("model", Path, "visible surface, PLY")
    add("--region", Path, "regions.json")
    add(
        "--hidden",
        float,
        "instead of --region: corners of a box around what no view shows of an opaque object, as its back [m]",
        metavar="X0 Y0 Z0 X1 Y1 Z1",
    )
    add("--cluster", int, "number of the region (default: the one nearest to the model)")
    add("--clear", bool, "complete a fully clear vessel from its outlines, without a visible band")
    add("--touches", Path, "CSV file of the touches so far")
    add("--register", Path, "CSV file of contacts on the visible part, to align the frame of the touches")
    add("--out", Path, "completed surface, PLY", required=True)
    add("--next", bool, "plan the next touch")
    add("--fingers", 1, "plan as many touches at once, each finger apart from the first (1)", low=1, high=10)
    add(
        "--apart-m",
        float,
        "distance of the further fingers' starts from that of the first [m] (0.01 0.1)",
        metavar="LOW HIGH",
    )
    add("--bound-m", 0.001, "expected error at which to stop [m] (0.001)", low=0, above=True)
    add("--plot", Path, "figure of the completed surface (.png, .pdf, .svg)")
    add("--no-priors", bool, "do not use the cross-sections of the visible bands as priors")


def run(args: Any) -> dict[str, Any]:
    """Complete; returns the mapping that ``--json`` prints."""
    import numpy as np

    from ....reconstruction.completion import Completion, read_touches
    from ....reconstruction.completion.touch_registration import register_touches

    model = reconstruction.SurfaceMesh.load(args.model)
    regions = _regions(args)
    number = args.cluster
    if number is None:
        number = int(np.argmin([abs(float(r.distance_m(model.vertices_m).min())) for r in regions]))
    if not 0 <= number < len(regions):
        raise core.InputError(
            args.region or "--hidden", f"has {len(regions)} clusters, no number {number}", field="clusters"
        )
    touches = read_touches(args.touches) if args.touches else []
    pose, rms_m = None, 0.0
    if args.register:
        known = [touch.contact_m for touch in read_touches(args.register) if touch.contact_m is not None]
        pose, rms_m = register_touches(np.array(known).reshape(-1, 3), model)
    _check_reach(touches, args.touches, model.vertices_m, regions[number].hull_m, pose)
    others = [region for region in regions if region is not regions[number]]
    completion = _joined(args, model, regions[number], others, touches, pose)
    completed = completion.completed()
    fields = {"sigma_m": completion.sigma_m(completed.vertices_m)}
    meshes.write_ply(
        args.out, meshes.PlyMesh(completed.vertices_m, completed.faces, completed.colors, fields)
    )
    if args.plot:
        reconstruction.plot_completion(completion, args.plot)
    found: dict[str, Any] = {
        "out": str(args.out),
        "cluster": number,
        "touches": len(touches),
        "vertices": len(completed.vertices_m),
        "triangles": len(completed.faces),
        "expected_error_m": completion.expected_error_m(),
        "done": completion.done(args.bound_m),
    }
    if pose is not None:
        found["registration"] = {"matrix_visual_haptic": pose.matrix.tolist(), "rms_m": rms_m}
    if isinstance(completion, Completion):
        found |= {"supports": len(completion.band.points_m), "gap_m": completion.band.gap_m}
        if (prior := completion.prior) is not None:
            found["symmetry"] = {
                "rotation": prior.p_rotation,
                "mirror": prior.p_mirror,
                "sweep": prior.p_sweep,
            }
    if args.next or args.fingers > 1:
        plans = _plans(completion, args)
        found["next"] = plans[0]
        if args.fingers > 1:
            found["fingers"] = plans
    return found


def _plans(completion: Completion | BodyCompletion, args: Any) -> list[dict[str, Any]]:
    """The next touch of every finger that reaches one; the first finger's is the best."""
    from ....reconstruction.completion.surface_completion import Completion

    if args.fingers == 1:
        return [_planned(completion.next_touch())]
    if not isinstance(completion, Completion):
        raise core.InputError("--fingers", "found --clear, expected a surface with a visible band")
    low_m, high_m = args.apart_m or _APART_M
    if not 0 <= low_m < high_m:
        raise core.InputError("--apart-m", f"found {low_m:g} {high_m:g}, expected 0 <= LOW < HIGH")
    plans = completion.next_touches([(low_m, high_m)] * (args.fingers - 1))
    if len(plans) < args.fingers:
        args.report(
            f"{len(plans)} of {args.fingers} fingers have a target {low_m:g} to {high_m:g} m from the first"
        )
    return [_planned(plan) for plan in plans]


def _regions(args: Any) -> list[HoleRegion]:
    """The transparent regions of a file, or the hidden one of a box."""
    import numpy as np

    from ....reconstruction.completion import HoleRegion, load_hole_regions

    if (args.region is None) == (args.hidden is None):
        raise core.InputError("complete", "found none or both of --region and --hidden, expected one of them")
    if args.region:
        return load_hole_regions(args.region)
    corners_m = np.array(np.meshgrid(*np.reshape(args.hidden, (2, 3)).T)).reshape(3, -1).T
    return [HoleRegion.of_points(corners_m)]


def _joined(
    args: Any,
    model: reconstruction.SurfaceMesh,
    region: HoleRegion,
    others: list[HoleRegion],
    touches: list[Touch],
    pose: core.Pose | None,
) -> Completion | BodyCompletion:
    """The completion with all touches: from the visible band, or of a fully clear vessel from its outlines."""
    from ....reconstruction.body_completion import BodyCompletion
    from ....reconstruction.completion import Completion, CompletionSettings

    if not args.clear:
        settings = CompletionSettings(use_priors=not args.no_priors)
        completion = Completion(model, region, settings, T_visual_haptic=pose)
        for touch in touches:
            completion.add(touch)
        return completion
    if region.body is None:
        raise core.InputError(
            args.region or "--hidden",
            "found no outline of the cluster (axis, radius, height), expected one for --clear",
            remedy="create it with `visuohaptic reconstruct`",
        )
    beside = [other.body for other in others if other.body is not None]
    clear = BodyCompletion.standing(model, region.body, float(region.hull_m[:, 2].max()), beside)
    for touch in touches:
        clear.add(touch if pose is None else touch.moved(pose))
    return clear


def _planned(plan: TouchPlan) -> dict[str, Any]:
    """A planned touch as plain numbers."""
    return picked(plan, "target_m start_m end_m direction score sigma_m")


def _check_reach(touches: Any, path: Any, model_m: Any, region_m: Any, pose: Any) -> None:
    """Reject contacts too far from the object: wrong unit, or wrong frame."""
    import numpy as np

    centre = region_m.mean(axis=0)
    reach_m = float(np.linalg.norm(np.ptp(model_m, axis=0)) + np.linalg.norm(np.ptp(region_m, axis=0)))
    for index, touch in enumerate(touches):
        if touch.contact_m is None:
            continue
        point = touch.contact_m if pose is None else pose.apply(touch.contact_m)
        away_m = float(np.linalg.norm(point - centre))
        if away_m > reach_m:
            raise core.InputError(
                path,
                f"found a contact {away_m:.3g} m from the region, expected at most {reach_m:.3g} m",
                field=f"touch {index + 1}",
                remedy="give metres in the frame of the surface, or --register",
            )
