"""Kernels: intersections of rays from the height axis with a mesh."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.kernels import kernel


@kernel
def ring_crossings(
    points: Any, faces: Any, heights: Any, first_row: Any, around: int, radius: Any, count: Any
) -> None:
    """Radii at which the rays from (0, 0) at ``around`` angles intersect the mesh, at each height.

    ``heights`` ascend, ``first_row`` is the first height that is not below each face. ``radius`` (h, around, most) is unsorted,
    ``count`` (h, around) is the number of intersections, which may exceed ``most``. Each wall is hit once: edges are half-open.
    """
    step = 2 * np.pi / around
    segment = np.empty((2, 2))
    for face in range(faces.shape[0]):
        high = max(points[faces[face, 0], 2], points[faces[face, 1], 2], points[faces[face, 2], 2])
        row = first_row[face]
        while row < heights.size and heights[row] <= high:
            z = heights[row]
            found = 0
            for corner in range(3):
                a, b = faces[face, corner], faces[face, (corner + 1) % 3]
                # An edge has exactly the same intersection in both of its triangles.
                if a > b:
                    a, b = b, a
                if (points[a, 2] >= z) != (points[b, 2] >= z):
                    t = (z - points[a, 2]) / (points[b, 2] - points[a, 2])
                    segment[found, 0] = points[a, 0] + t * (points[b, 0] - points[a, 0])
                    segment[found, 1] = points[a, 1] + t * (points[b, 1] - points[a, 1])
                    found += 1
            if found == 2:
                first = np.arctan2(segment[0, 1], segment[0, 0])
                second = np.arctan2(segment[1, 1], segment[1, 0])
                begin, end = 0, 1
                if first > second:
                    begin, end = 1, 0
                    first, second = second, first
                if second - first > np.pi:
                    # The angle interval contains pi.
                    begin, end = end, begin
                    first, second = second, first + 2 * np.pi
                px, py = segment[begin, 0], segment[begin, 1]
                ex, ey = segment[end, 0] - px, segment[end, 1] - py
                place = int(np.ceil(first / step))
                while place * step < second:
                    across = np.cos(place * step) * ey - np.sin(place * step) * ex
                    if across != 0.0:
                        r = (px * ey - py * ex) / across
                        column = place % around
                        if r > 0.0:
                            if count[row, column] < radius.shape[2]:
                                radius[row, column, count[row, column]] = r
                            count[row, column] += 1
                    place += 1
            row += 1
