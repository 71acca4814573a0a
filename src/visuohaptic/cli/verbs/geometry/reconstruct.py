"""``visuohaptic reconstruct``: fuse a depth sequence into a surface and detect transparent parts.

reads   a sequence folder: sequence.yaml, camera.yaml, depth/, poses.txt (see `visuohaptic recording import`)
writes  into --out: surface.ply, transparency.ply (points with their score) and regions.json (hull, centroid, size and
        score of each transparent part, and axis, radii and heights of the solid of revolution fitted to its outlines;
        corners of each flat pane; in metres in the frame of the poses)

example: visuohaptic reconstruct scan --out model
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from .... import core, io, reconstruction, viewer
from ....io import depth, meshes
from ....reconstruction import fusion
from ..._console import Arguments

#: Optional modules that the verb imports.
NEEDS = ("skimage",)


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("sequence", Path, "sequence folder")
    add("--out", Path, "folder to write", required=True)
    add("--every", 1, "use one of N images (default: all)", metavar="N", low=1)
    add("--sensor", str, "noise model: kinect, kinect_axial, realsense_d435 (default: by sequence.yaml)")
    add(
        "--space",
        float,
        "corners of the space of interest [m] (default: 1 m around the point that the cameras look at)",
        metavar="X0 Y0 Z0 X1 Y1 Z1",
    )
    add("--voxel-m", 0.005, "edge of a voxel [m] (default: %(default)s)", low=0, high=0.5, above=True)
    add("--false-alarm-rate", 0.02, "expected false transparent parts of a search (default: %(default)s)")
    add(
        "--network",
        Path,
        "your own network as further evidence: ONNX file, or folder with one mask for each depth image",
    )
    add(
        "--network-output",
        "mask",
        "what it returns: a score, or a depth or disparity that sees the glass (default: %(default)s)",
        choices=("mask", "depth", "disparity"),
    )
    add(
        "--network-size",
        int,
        "width and height of its input [px] (default: those of the view)",
        nargs=2,
        low=1,
    )
    add("--no-refine", bool, "do not refine the poses")
    add("--sparse", bool, "fuse the surface everywhere, not only in the space of interest")
    add("--plot", Path, "figure of surface and transparent parts to write (.png, .pdf, .svg)")
    add("--view", bool, "show the result in the browser until interrupted")


def run(args: Arguments) -> dict[str, Any]:
    """Read, detect, fuse, write; returns what is printed."""
    from dataclasses import asdict

    if args.sequence.is_dir() and not (args.sequence / "sequence.yaml").exists():
        within = min(args.sequence.glob("*/sequence.yaml"), default=None)
        raise core.InputError(
            args.sequence,
            "has no sequence.yaml, expected a sequence folder",
            remedy=f"did you mean {within.parent}?"
            if within
            else "convert depth images with `visuohaptic recording import`",
        )
    sequence = io.DepthSequence(args.sequence)
    noise = fusion.sensor_noise(args.sensor) if args.sensor else reconstruction.sequence_noise(sequence)
    frames = sequence.load(args.every)
    if args.space:
        grid = fusion.SpaceGrid.around(args.space[:3], args.space[3:], args.voxel_m)
    else:
        grid = fusion.space_of_interest(frames, voxel_m=args.voxel_m)
    model = None
    if args.network:
        width_height = (args.network_size[0], args.network_size[1]) if args.network_size else None
        model = depth.load_pixel_model(args.network, args.network_output, width_height, len(sequence))
    found = reconstruction.reconstruct(
        frames,
        grid=grid,
        noise=noise,
        refine=not args.no_refine,
        sparse=args.sparse,
        false_alarm_rate=args.false_alarm_rate,
        model=model,
    )
    found.save(args.out)
    for line in _part_lines(found):
        args.report(line)
    parts = f"{len(found.regions)} transparent part{'s' * (len(found.regions) != 1)}"
    args.report(f"{parts}, {len(found.surface.faces)} triangles in {args.out}")
    what = "search" if found.search.found or found.panes else "nothing found"
    args.report(f"{what}: {found.search.text}")
    if args.plot:
        reconstruction.plot_reconstruction(found, args.plot)
    if args.view:
        _show(found, args)
    return {
        "out": str(args.out),
        "regions": [
            {"centroid_m": region.centroid_m, "size_m": region.size_m, "score": region.score}
            | ({"outline": asdict(region.body)} if region.body else {})
            for region in found.regions
        ],
        "panes": [asdict(pane) for pane in found.panes],
        "triangles": len(found.surface.faces),
        "views": found.search.compared,
        "skipped": {**sequence.skipped, **found.search.skipped},
        "search": asdict(found.search),
        "reason": found.search.text,
    }


def _part_lines(found: reconstruction.Reconstruction) -> list[str]:
    """One line for each transparent part and each pane."""
    lines = []
    for region in found.regions:
        x, y, z = region.centroid_m
        size = " x ".join(f"{edge:.3f}" for edge in region.size_m)
        place = f"transparent part at ({x:.3f}, {y:.3f}, {z:.3f}) m, {size} m, score {region.score:.2f}"
        lean_deg = math.degrees(region.body.lean_rad) if region.body else 0.0
        lines.append(place + (f", leans by {lean_deg:.0f} degrees" if lean_deg else ""))
    for pane in found.panes:
        corners = ", ".join("({:.3f}, {:.3f}, {:.3f})".format(*corner) for corner in pane.corners_m)
        lines.append(f"flat pane with corners {corners} m, +- {1e3 * pane.sigma_m:.1f} mm along its normal")
    return lines


def _show(found: Any, args: Arguments) -> None:
    """Serve the surface with the transparent parts and panes in yellow until interrupted."""
    import numpy as np

    from ..system.view import wait

    surface = found.surface
    glass = [(region.hull_m, region.faces) for region in found.regions]
    glass += [(pane.corners_m, np.array([[0, 1, 2], [0, 2, 3]])) for pane in found.panes]
    vertices, faces = zip((surface.vertices_m, surface.faces), *glass, strict=True)
    first = np.cumsum([0, *map(len, vertices)])
    grey = np.full((first[1], 3), 190) if surface.colors is None else surface.colors
    yellow = np.tile([255, 210, 0], (first[-1] - first[1], 1))
    mesh = meshes.PlyMesh(
        np.concatenate(vertices),
        np.concatenate([part + offset for part, offset in zip(faces, first[:-1], strict=True)]),
        np.concatenate([grey, yellow]).astype(np.uint8),
        {},
    )
    with viewer.BrowsePage([viewer.SurfaceView("surface and transparent parts", mesh)]) as page:
        args.report(f"shown at {page.url}, end with Ctrl+C")
        page.show()
        wait(args)
