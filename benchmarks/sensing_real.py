"""Trackers on real recordings, each compared with a published truth or an independent measurement.

    python -m benchmarks sensing_real

Needs ``sensing`` of the real data (``VISUOHAPTIC_DATA`` or ``../shared/data``). The references have errors as well,
often larger than the tracker's: the note of each row states them.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from visuohaptic.tracking.contours import ConstraintLines, ContourSettings, ContourTracker
from visuohaptic.tracking.points import apply_homography
from visuohaptic.tracking.templates import EsmTemplate, Template, align, detect_templates, matching_blur

from .harness import ROOT


def data_folder() -> Path | None:
    """Folder of the recordings, if it exists."""
    named = os.environ.get("VISUOHAPTIC_DATA")
    folder = (Path(named) if named else ROOT.parent / "shared" / "data") / "sensing"
    return folder if folder.is_dir() else None


def _grey(path: Path) -> np.ndarray:
    import cv2

    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise FileNotFoundError(path)
    return image


def _refined(template: EsmTemplate, image: np.ndarray, start: np.ndarray):
    """Aligned, its blur matched, and aligned again: what the tracker does over two frames."""
    found = align(template, image, start)
    if not found.valid:
        return found
    again = align(template, image, found.homography, blur=matching_blur(template, image, found))
    return again if again.valid else found


def _row(name: str, ours: float, unit: str, note: str) -> dict:
    return {"name": name, "ours": ours, "unit": unit, "note": note}


def graf(folder: Path) -> Iterator[dict]:
    """A painted wall from six directions; homographies are published."""
    first = _grey(folder / "img1.png")
    x, y, w, h = 280, 200, 360, 300
    template = Template.from_image("graf", first[y : y + h, x : x + w].copy(), width_m=0.36)
    corners = template.esm.corners
    for view in range(2, 7):
        image = _grey(folder / f"img{view}.png")
        published = np.loadtxt(folder / f"H1to{view}p") @ np.array([[1, 0, x], [0, 1, y], [0, 0, 1.0]])
        found = detect_templates((template,), image).get("graf")
        refined = _refined(template.esm, image, found.homography) if found is not None else None
        if refined is None or not refined.valid:
            yield _row(f"graf, view {view}", float("nan"), "px", "not found")
            continue
        error = np.linalg.norm(
            apply_homography(refined.homography, corners) - apply_homography(published, corners), axis=1
        )
        yield _row(
            f"graf, view {view}: rms distance of the corners to the published homography",
            float(np.sqrt(np.mean(error**2))),
            "px",
            f"found and tracked, correlation {refined.ncc:.4f}; that homography is good to 0.2-0.5 px",
        )


def dots(folder: Path) -> Iterator[dict]:
    """A box lid that a hand moves, 60 frames; centroids of its five dots are the check."""
    paths = sorted((folder / "mire-2").glob("*.png"))
    middle = 29  # a sharp frame; the first ones are blurred by motion
    image = _grey(paths[middle])
    low, high = np.array([84, 128]), np.array([266, 246])
    template = EsmTemplate.from_image(image[low[1] : high[1], low[0] : high[0]].copy())
    marks = dot_centres(image)
    marks = marks[((marks > low) & (marks < high)).all(axis=1)]
    place = np.array([[1, 0, low[0]], [0, 1, low[1]], [0, 0, 1.0]])
    tracked, errors = 0, []
    for part in (paths[middle + 1 :], paths[middle::-1]):
        homography, blur = place, 0.0
        for path in part:
            image = _grey(path)
            found = align(template, image, homography, blur=blur)
            if not found.valid:
                continue
            tracked += 1
            homography = found.homography
            blur = matching_blur(template, image, found, start=blur)
            expected = apply_homography(homography, marks - low)
            distance = np.linalg.norm(expected[:, None] - dot_centres(image)[None], axis=2).min(axis=1)
            # A dot that a threshold cannot separate in this frame is skipped.
            errors.extend(distance[distance < 6.0])
    yield _row(
        "visp mire-2: median distance of a dot to its centroid",
        float(np.median(errors)),
        "px",
        f"{tracked} of {len(paths)} frames tracked, {len(errors)} of {5 * len(paths)} dots separable, "
        f"95 % below {np.percentile(errors, 95):.2f} px; centroids of blurred dots err by tenths",
    )


def dot_centres(image: np.ndarray) -> np.ndarray:
    """Grey-weighted centroids of bright round blobs."""
    import cv2

    _, mask = cv2.threshold(image, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
    centres = []
    for k in range(1, count):
        _, _, w, h, area = stats[k]
        if 30 < area < 5000 and 0.5 < w / h < 2 and area > 0.6 * w * h:
            y, x = np.nonzero(labels == k)
            weight = image[y, x].astype(float)
            centres.append([(x * weight).sum() / weight.sum(), (y * weight).sum() / weight.sum()])
    return np.array(centres).reshape(-1, 2)


def boards(folder: Path) -> Iterator[dict]:
    """Rendered boards of tags with published corners, and a photo with published detections."""
    listing = [
        line.split() for line in (folder / "corners_tag36_11.txt").read_text().split("\n") if line.strip()
    ]
    corners = {
        int(listing[k][0]): np.array(listing[k + 1 : k + 5], float) for k in range(0, len(listing) - 4, 5)
    }
    yield _tags(
        "visp board 640 x 480",
        _grey(folder / "tag36_11_640x480.png"),
        corners,
        "edges are not smoothed: 0.3 px",
    )
    lines = (folder / "ground_truth_detection.txt").read_text().split("\n")
    published: dict[int, np.ndarray] = {}
    for k, line in enumerate(lines):
        if match := re.match(r"36h11_id:_?\s*(\d+)", line):
            published[int(match[1])] = np.array([row.split() for row in lines[k + 1 : k + 5]], float)[:, ::-1]
    yield _tags(
        "visp photo of tags",
        _grey(folder / "AprilTag.png"),
        published,
        "published detections, not measured",
        0.0,
    )


def _tags(
    name: str, image: np.ndarray, corners: dict[int, np.ndarray], note: str, shift: float = 0.5
) -> dict:
    templates = tuple(Template.from_tag(number, size_m=0.1) for number in corners)
    found = detect_templates(templates, image)
    errors = []
    for number, template in zip(corners, templates, strict=True):
        if template.name in found:
            refined = _refined(template.esm, image, found[template.name].homography)
            if refined.valid:
                seen = apply_homography(refined.homography, template.tag_corners)
                truth = corners[number] - shift
                errors.append(np.linalg.norm(seen[:, None] - truth[None], axis=2).min(axis=1).max())
    return _row(
        f"{name}: median over the tags of the worst corner",
        float(np.median(errors)) if errors else float("nan"),
        "px",
        f"{len(errors)} of {len(templates)} tags; {note}",
    )


def photos(folder: Path) -> Iterator[dict]:
    """Photos of a field with many tags of one number: each is looked for near its published place."""
    import cv2

    template = Template.from_tag(0, size_m=0.1)
    for listing in sorted(folder.glob("*.txt")):
        image = _grey(listing.with_suffix(".jpg"))
        count, errors = 0, []
        for line in listing.read_text().splitlines():
            values = [float(value) for value in re.findall(r"-?\d+\.?\d*", line)]
            if len(values) != 9 or values[0] != 0:
                continue
            quad = np.array(values[1:]).reshape(4, 2) - 0.5  # their origin is the corner of the first pixel
            if cv2.contourArea(quad.astype(np.float32)) < 400:
                continue
            count += 1
            low, high = quad.min(0) - 15, quad.max(0) + 15
            box = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
            found = detect_templates((template,), image, region=box)
            if template.name in found:
                refined = _refined(template.esm, image, found[template.name].homography)
                if refined.valid:
                    seen = apply_homography(refined.homography, template.tag_corners)
                    errors.append(np.linalg.norm(seen[:, None] - quad[None], axis=2).min(axis=1).max())
        if not count:
            yield _row(
                f"apriltag photo {listing.stem[:8]}", float("nan"), "px", "its tags are smaller than 20 px"
            )
            continue
        yield _row(
            f"apriltag photo {listing.stem[:8]}: median over the tags of the worst corner",
            float(np.median(errors)) if errors else float("nan"),
            "px",
            f"{len(errors)} of {count} tags of 20 px and more; both err on a photo that was shrunk and compressed",
        )


def speckle(folder: Path) -> Iterator[dict]:
    """A specimen with speckle that is pulled: the template's middle against Lucas-Kanade flow of its points."""
    import cv2

    images = [_grey(path) for path in sorted(folder.glob("*.tif"))]
    rows, columns = images[0].shape
    side = 240
    x, y = (columns - side) // 2, (rows - side) // 2
    template = EsmTemplate.from_image(images[0][y : y + side, x : x + side].copy())
    start = np.array([[1, 0, x], [0, 1, y], [0, 0, 1.0]])
    grid = (
        np.stack(np.meshgrid(np.arange(20, 221, 20), np.arange(20, 221, 20)), axis=-1)
        .reshape(-1, 2)
        .astype(float)
    )
    points = (grid + np.array([x, y])).astype(np.float32)
    tracked, medians, spreads, moves = 0, [], [], []
    for image in images[1:]:
        found = align(template, image, start)
        if not found.valid:
            continue
        tracked += 1
        start = found.homography
        ours = apply_homography(found.homography, grid)
        guess = ours.astype(np.float32)[:, None]
        flow, good, _ = cv2.calcOpticalFlowPyrLK(
            images[0],
            image,
            points[:, None],
            guess.copy(),
            winSize=(31, 31),
            maxLevel=0,
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )
        off = (flow[:, 0] - ours)[good.ravel() == 1]
        medians.append(np.abs(np.median(off, axis=0)).max())
        spreads.append(np.sqrt(np.mean((off - np.median(off, axis=0)) ** 2)))
        moves.append(np.abs(ours - grid - np.array([x, y])).max())
    yield _row(
        "muDIC speckle: middle of the template against the flow of its points",
        float(np.max(medians)),
        "px",
        f"{tracked} of {len(images) - 1} frames tracked, up to {max(moves):.1f} px of motion; single points "
        f"scatter by {max(spreads):.2f} px, as the specimen does not deform as a plane",
    )


def beam(folder: Path) -> Iterator[dict]:
    """A vibrating beam at 15000 frames/s: its upper edge by the contour tracker, against optical flow."""
    film = np.fromfile(folder / "data_showcase.mraw", np.uint8).reshape(-1, 40, 640)
    x = np.arange(80.0, 561.0, 12.0)
    count = len(x)
    lines = ConstraintLines(
        np.column_stack([x, np.full(count, 18.0)]),
        np.tile([0.0, 1.0], (count, 1)),
        np.full(count, -4.0),
        np.full(count, 4.0),
        6.0,
    )
    tracker = ContourTracker(ContourSettings(polarity=-1, plateau_px=2.0, window_px=4))
    contours = [tracker.track(image, lines) for image in film]
    valid = np.array([contour.valid for contour in contours])
    ours = np.array([contour.position_px for contour in contours])
    # One-dimensional flow in the same windows: change over slope, against the mean picture.
    mean = film.mean(axis=0)
    slope = np.gradient(mean, axis=0)
    parts = [(slice(15, 22), slice(int(column) - 6, int(column) + 7)) for column in x]
    flow = np.array(
        [[-(slope[p] * (image - mean)[p]).sum() / (slope[p] ** 2).sum() for p in parts] for image in film]
    )
    both = valid.mean(axis=0) > 0.9
    ours[~valid] = np.nan
    ours = (ours - np.nanmean(ours, axis=0))[:, both]
    flow = (flow - flow.mean(axis=0))[:, both]
    whole = np.isfinite(ours).all(axis=1)
    ours, flow = ours[whole], flow[whole]
    off = ours - flow
    # What no smooth bending explains: residual of a polynomial of degree six along the beam.
    basis = np.polynomial.chebyshev.chebvander(np.linspace(-1, 1, int(both.sum())), 6)
    rest = [values.T - basis @ np.linalg.lstsq(basis, values.T, rcond=None)[0] for values in (ours, flow)]
    yield _row(
        "pyidi beam: rms difference of the contour to optical flow",
        float(np.sqrt(np.mean(off**2))),
        "px",
        f"{len(film)} frames, {100 * valid.mean():.1f} % of {count} points valid, motion rms {ours.std():.3f} px; "
        f"off a smooth line by {rest[0].std():.4f} px (flow {rest[1].std():.4f})",
    )


def run() -> list[dict]:
    """Rows of the table, or one row if the data are missing."""
    folder = data_folder()
    if folder is None:
        return [
            _row(
                "real sequences",
                float("nan"),
                "",
                "no data: set VISUOHAPTIC_DATA or put them into ../shared/data",
            )
        ]
    parts = (
        (dots, "visp_images"),
        (graf, "oxford_graf"),
        (boards, "visp_images"),
        (photos, "apriltag"),
        (speckle, "mudic"),
        (beam, "pyidi"),
    )  # fmt: skip
    return [row for measure, name in parts if (folder / name).is_dir() for row in measure(folder / name)]
