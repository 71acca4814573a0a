"""Templates on real images, compared with published or independently measured references."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from benchmarks.sensing_real import dot_centres

from visuohaptic.core.camera import Camera, Frame
from visuohaptic.tracking.points import apply_homography
from visuohaptic.tracking.templates import EsmTemplate, Template, TemplateTracker, align, detect_templates

pytestmark = pytest.mark.data


def grey(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert image is not None, path
    return image


def test_graf_views_against_published_homographies(data: Path) -> None:
    """Detected and refined in views 2-4; the published matrices themselves are good to 0.2-0.5 px."""
    folder = data / "sensing" / "oxford_graf"
    first = grey(folder / "img1.png")
    x, y, w, h = 280, 200, 360, 300
    template = Template.from_image("graf", first[y : y + h, x : x + w].copy(), width_m=0.36)
    centre = np.array([[(w - 1) / 2, (h - 1) / 2]])
    for view, limit in ((2, 0.6), (3, 1.0), (4, 1.3)):
        image = grey(folder / f"img{view}.png")
        found = detect_templates((template,), image)["graf"]
        refined = align(template.esm, image, found.homography)
        assert refined.valid
        assert refined.ncc > 0.97  # the blur of these views is not given
        published = np.loadtxt(folder / f"H1to{view}p") @ np.array([[1, 0, x], [0, 1, y], [0, 0, 1.0]])
        corners = template.esm.corners
        error = apply_homography(refined.homography, corners) - apply_homography(published, corners)
        assert np.linalg.norm(error, axis=1).max() < limit
        middle = apply_homography(refined.homography, centre) - apply_homography(published, centre)
        assert np.linalg.norm(middle) < 0.5


def test_rendered_tags_with_published_poses(data: Path) -> None:
    """Corners of every tag within 0.4 px of those published for the picture.

    Their coordinates begin at the corner of the first pixel, ours at its centre: half a pixel.
    The rendered edges are not smoothed, which alone makes them uncertain by about 0.3 px.
    """
    folder = data / "sensing" / "visp_images"
    image = grey(folder / "tag36_11_640x480.png")
    text = (folder / "corners_tag36_11.txt").read_text().split("\n")
    assert len(text) > 4
    numbers: dict[int, np.ndarray] = {}
    lines = [line.split() for line in text if line.strip()]
    for k in range(0, len(lines) - 4, 5):
        numbers[int(lines[k][0])] = np.array(lines[k + 1 : k + 5], dtype=float)
    templates = tuple(Template.from_tag(number, size_m=0.1) for number in numbers)
    found = detect_templates(templates, image)
    worst = []
    for template in templates:
        if template.name not in found:
            continue
        refined = align(template.esm, image, found[template.name].homography)
        if not refined.valid:
            continue
        corners = apply_homography(refined.homography, template.tag_corners)
        truth = numbers[template.tag_id] - 0.5
        # The order of the corners differs between the conventions: nearest ones.
        worst.append(np.linalg.norm(corners[:, None] - truth[None], axis=2).min(axis=1).max())
    assert len(worst) >= 0.8 * len(numbers)
    assert np.median(worst) < 0.4


def test_real_tag_photos(data: Path) -> None:
    """Published corners of tags in photographs, each looked for near its place: they all have number 0."""
    folder = data / "sensing" / "apriltag"
    template = Template.from_tag(0, size_m=0.1)
    count, errors = 0, []
    for listing in sorted(folder.glob("*.txt")):
        image = grey(listing.with_suffix(".jpg"))
        for line in listing.read_text().splitlines():
            values = [float(v) for v in re.findall(r"-?\d+\.?\d*", line)]
            if len(values) != 9 or values[0] != 0:
                continue
            # Half a pixel: their origin is the corner of the first pixel.
            quad = np.array(values[1:]).reshape(4, 2) - 0.5
            if cv2.contourArea(quad.astype(np.float32)) < 900:
                continue
            count += 1
            low, high = quad.min(0) - 15, quad.max(0) + 15
            box = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
            found = detect_templates((template,), image, region=box)
            if template.name not in found:
                continue
            refined = align(template.esm, image, found[template.name].homography)
            if refined.valid:
                corners = apply_homography(refined.homography, template.tag_corners)
                near = np.linalg.norm(corners[:, None] - quad[None], axis=2).min(axis=1)
                errors.append(near.max())
    assert count > 0
    assert len(errors) >= 0.7 * count
    # Both sides err: half a pixel for the published ones on photos that were shrunk and compressed.
    assert np.median(errors) < 1.0


def test_hand_moved_target_through_blur(data: Path) -> None:
    """mire-2: a box lid with five white dots; their centroids are an independent check in every frame."""
    paths = sorted((data / "sensing" / "visp_images" / "mire-2").glob("*.png"))
    middle = 29  # a sharp frame; the first ones are blurred by motion
    image = grey(paths[middle])
    low, high = np.array([84, 128]), np.array([266, 246])
    template = EsmTemplate.from_image(image[low[1] : high[1], low[0] : high[0]].copy())
    dots = dot_centres(image)
    dots = dots[((dots > low) & (dots < high)).all(axis=1)]
    assert len(dots) == 5
    place = np.array([[1, 0, low[0]], [0, 1, low[1]], [0, 0, 1.0]])
    tracked, errors = 0, []
    for part in (paths[middle:], paths[middle::-1]):
        homography = place
        for path in part:
            image = grey(path)
            found = align(template, image, homography)
            if not found.valid:
                continue
            tracked += 1
            homography = found.homography
            expected = apply_homography(homography, dots - low)
            distance = np.linalg.norm(expected[:, None] - dot_centres(image)[None], axis=2).min(axis=1)
            # A dot that a threshold cannot separate in this frame says nothing.
            errors.extend(distance[distance < 6.0])
    assert tracked == len(paths) + 1
    assert len(errors) > 4 * len(paths)
    # Blurred centroids are good to a few tenths of a pixel.
    assert np.median(errors) < 0.5


def test_speckle_under_tension(data: Path) -> None:
    """muDIC: a speckled specimen stretches; homography and the mean of small patches must agree."""
    paths = sorted((data / "sensing" / "mudic").glob("*.tif"))
    images = [grey(path) for path in paths]
    rows, columns = images[0].shape
    side = min(rows, columns, 240) // 2 * 2
    x, y = (columns - side) // 2, (rows - side) // 2
    template = EsmTemplate.from_image(images[0][y : y + side, x : x + side].copy())
    start = np.array([[1, 0, x], [0, 1, y], [0, 0, 1.0]])
    for image in images:
        found = align(template, image, start)
        assert found.valid
        start = found.homography
        # The same motion from the four quarters, each aligned on its own.
        half = side // 2
        for u in (0, half):
            for v in (0, half):
                part = EsmTemplate.from_image(images[0][y + v : y + v + half, x + u : x + u + half].copy())
                shift = np.array([[1, 0, u], [0, 1, v], [0, 0, 1.0]])
                own = align(part, image, found.homography @ shift)
                assert own.valid
                middle = np.array([[(half - 1) / 2, (half - 1) / 2]])
                a = apply_homography(own.homography, middle)
                b = apply_homography(found.homography @ shift, middle)
                # The specimen does not deform as a plane exactly; 1 px over a quarter at most.
                assert np.linalg.norm(a - b) < 1.0


def test_a_tag_sequence_end_to_end(data: Path) -> None:
    """The tracker finds the tags of a picture by itself and gives poses in front of the camera."""
    image = grey(data / "sensing" / "visp_images" / "tag36_11_640x480.png")
    camera = Camera.simple(640, 480, 600.0)
    templates = [Template.from_tag(number, size_m=0.1) for number in (0, 1, 2)]
    with TemplateTracker(templates, camera, threaded=False) as tracker:
        for k in range(3):
            poses = tracker.update(Frame(image, 0.1 * k, k))
    assert sum(pose.valid for pose in poses) >= 2
    for pose in poses:
        if pose.valid:
            assert pose.T_camera_template.translation_m[2] > 0
