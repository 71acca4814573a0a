"""Image under construction: coverage, textured planes, layers."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Float32

from ...core.camera.model import Camera
from ._coverage import Coverage, coverage, share_facets
from ._render_kernels import add_plane, hide
from .appearance import Surface
from .effects import in_bands
from .rolling_view import ray_table
from .textures import MATERIALS, TILE_TEXELS, blurred_texels

#: Number of cached coverages.
_KEPT_COVERS = 24


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A textured plane: per row (or once) the matrix from rays to plane coordinates (a, b)."""

    matrices: Float[np.ndarray, "rows 3 3"]
    surface: Surface
    light: float = 1.0  #: multiplies the mean level
    #: Shift of its texture at the points of an even grid, (A, B, 2) float32, and the first point and the spacing of
    #: the grid, (3,) [m]; (0, 0, 2) for a rigid surface
    warp: Float32[np.ndarray, "A B 2"] = field(default_factory=lambda: np.zeros((0, 0, 2), np.float32))
    grid: Float[np.ndarray, "3"] = field(default_factory=lambda: np.ones(3))


#: The painted parts of a solid.
Parts = list[tuple[Coverage, Plane]]

#: Signed polygon of a hole [px], and the parts of the solid that is visible through it.
Hole = tuple[np.ndarray, float, Parts]


class Canvas:
    """Float image of a camera: layers are added from far to near, and drawn from near to far.

    Parts that a nearer layer hides are therefore not computed.

    Parameters
    ----------
    camera
        Lens and size of the image.
    channels
        1 grey, 3 blue, green, red.
    blur_px
        Standard deviation of the blur of the lens [px].
    distance_m
        Distance from the camera to the scene [m].
    """

    def __init__(self, camera: Camera, channels: int, blur_px: float, distance_m: float) -> None:
        self.camera = camera
        self.blur_px = blur_px
        self._pixel_m = distance_m / camera.focal_px
        self._image = np.zeros((camera.height, camera.width, channels), np.float32)
        self._clear = np.ones((camera.height, camera.width), np.float32)
        self._layers: list[tuple[Coverage, Parts]] = []
        self._rays = ray_table(camera)
        self._covers: dict[bytes, Coverage | None] = {}

    def cover(self, polygon_px: Float[np.ndarray, "n 2"]) -> Coverage | None:
        """Coverage of a polygon in this image; cached, since much of a scene is static in the image.

        Parameters
        ----------
        polygon_px
            Corners (n, 2) [px].
        """
        key = polygon_px.tobytes()
        if key in self._covers:
            found = self._covers.pop(key)  # and move it to the end of the queue
        else:
            found = coverage(polygon_px, *self._clear.shape, self.blur_px)
        self._covers[key] = found
        while len(self._covers) > _KEPT_COVERS:
            del self._covers[next(iter(self._covers))]
        return found

    def fill(self, plane: Plane, light: Float32[np.ndarray, "rows columns"]) -> None:
        """Start a new image with its farthest layer.

        Parameters
        ----------
        plane
            Textured plane.
        light
            Factor of its levels in each pixel.
        """
        everywhere = Coverage.full(0, 0, light)
        self._layers = [(everywhere, [(everywhere, plane)])]

    def drawn(self) -> Float32[np.ndarray, "rows columns channels"]:
        """The image of all layers; the next one is drawn into the same memory."""
        in_bands(self._draw, len(self._image))
        return self._image

    def _draw(self, low: int, high: int) -> None:
        """Draw the rows from ``low`` to ``high``, without the last."""
        self._image[low:high] = 0.0
        self._clear[low:high] = 1.0
        for i, (whole, parts) in reversed(list(enumerate(self._layers))):
            for cover, plane in parts:
                self._add(plane, _rows(cover, low, high))
            if i > 0:  # nothing is behind the farthest one
                seen = _rows(whole, low, high)
                hide(self._clear, seen.fraction, seen.spans, seen.x0, seen.y0)

    def paint_parts(
        self, polygons: list[np.ndarray], planes: list[Plane], active_rows: np.ndarray | None = None
    ) -> Parts:
        """Paint faces that do not overlap each other but share edges, such as those of a solid.

        Parameters
        ----------
        polygons
            Corners of each face (n, 2) [px].
        planes
            Textured plane of each face.
        active_rows
            Rows of the image that are painted; all by default.
        """
        parts = [(self.cover(p), plane) for p, plane in zip(polygons, planes, strict=True)]
        found = [(c, plane) for c, plane in parts if c is not None]
        if active_rows is not None:
            found = [
                (replace(c, fraction=c.fraction * active_rows[c.window[0], None].astype(np.float32)), plane)
                for c, plane in found
            ]
        if found:
            self._layers.append((_union([c for c, _ in found]), found))
        return found

    def paint_facets(
        self, outline: np.ndarray, rest: Plane, polygons: list[np.ndarray], planes: list[Plane]
    ) -> Parts:
        """Paint the many facets of a round solid inside its outline.

        The outline is exact; edges between facets, which hardly differ, are not blurred. The part of
        the blurred outline outside all facets is painted as ``rest``.

        Parameters
        ----------
        outline
            Corners of the outline (n, 2) [px].
        rest
            Plane of the part that no facet covers.
        polygons
            Corners of each facet (n, 2) [px].
        planes
            Textured plane of each facet.
        """
        whole = self.cover(outline)
        if whole is None:
            return []
        covers = [coverage(p, *self._clear.shape) for p in polygons]
        facets = [(c, plane) for c, plane in zip(covers, planes, strict=True) if c is not None]
        parts: Parts = [(share_facets(whole, [c for c, _ in facets]), rest), *facets]
        self._layers.append((whole, parts))
        return parts

    def paint_nested(self, covers: list[Coverage | None], planes: list[Plane], holes: list[Hole]) -> None:
        """Paint nested regions, with holes through which other solids are visible.

        A hole is the signed sum of its polygons.

        Parameters
        ----------
        covers
            Coverage of each region, the largest first; ``None`` where it is out of view.
        planes
            Textured plane of each region.
        holes
            Polygons with signs, and the faces that are visible through them.
        """
        outer = covers[0]
        if outer is None:
            return
        shape = outer.fraction.shape
        weights = [_in_window(c, outer) for c in covers]
        for i in range(1, len(weights)):
            weights[i] = np.minimum(weights[i], weights[i - 1])
        weights = [w - weights[i + 1] if i + 1 < len(weights) else w for i, w in enumerate(weights)]
        solids: dict[int, tuple[np.ndarray, Parts]] = {}
        for polygon, sign, parts in holes:
            cover = self.cover(polygon)
            if cover is None:
                continue
            hole, _ = solids.setdefault(id(parts), (np.zeros(shape, np.float32), parts))
            there, here = _overlap(cover, outer)
            hole[there] += np.float32(sign) * cover.fraction[here]
        # The nearest solid is the last: its part is subtracted first.
        shown = [
            part
            for hole, parts in reversed(list(solids.values()))
            for part in _fill_hole(hole, parts, weights, outer)
        ]
        shown += [(replace(outer, fraction=w), plane) for w, plane in zip(weights, planes, strict=True)]
        self._layers.append((outer, shown))

    def _add(self, plane: Plane, cover: Coverage) -> None:
        surface = plane.surface
        add_plane(
            self._image,
            self._clear,
            cover.fraction,
            cover.spans,
            cover.x0,
            cover.y0,
            *self._rays,
            plane.matrices,
            self._tile(surface) if surface.texture else _NO_TILE,
            TILE_TEXELS / MATERIALS[surface.material],
            float(surface.texture),
            (plane.light * surface.levels(self._image.shape[2])).astype(np.float32),
            plane.warp,
            plane.grid,
        )

    def _tile(self, surface: Surface) -> np.ndarray:
        """The surface's texture as blurred by lens and pixel at the sensor's distance."""
        texel_m = MATERIALS[surface.material] / TILE_TEXELS
        sigma = float(np.sqrt(self.blur_px**2 + 1 / 12) * self._pixel_m / texel_m)
        return blurred_texels(surface.material, surface.seed, round(sigma, 2))


_NO_TILE = np.zeros((16, 16), np.uint32)


def _fill_hole(hole: np.ndarray, parts: Parts, weights: list[np.ndarray], outer: Coverage) -> Parts:
    """Visible parts of a solid through a hole; subtracted from the weights of the surrounding layers."""
    rows, columns = np.flatnonzero(hole.max(axis=1) > 0), np.flatnonzero(hole.max(axis=0) > 0)
    if not len(rows):
        return []
    area = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    left = np.clip(hole[area], 0, None)
    window = Coverage.full(outer.x0 + int(columns[0]), outer.y0 + int(rows[0]), left)
    faces = [_in_window(c, window) for c, _ in parts]
    total = np.sum(faces, axis=0)
    # Only the area of the solid; its own fraction decreases to zero beyond its blurred outline.
    left[total < 1e-3] = 0
    taken = np.zeros_like(left)
    for w in weights:
        part = np.minimum(w[area], left - taken)
        w[area] -= part
        taken += part
    taken /= np.maximum(total, 1e-3)
    return [
        (replace(window, fraction=face * taken), plane) for face, (_, plane) in zip(faces, parts, strict=True)
    ]


def _overlap(part: Coverage, frame: Coverage) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Position of a coverage in the window of another one: slices of the frame and of the part."""
    there, here = [], []
    for axis, shift in enumerate((part.y0 - frame.y0, part.x0 - frame.x0)):
        start = max(shift, 0)
        stop = max(min(shift + part.fraction.shape[axis], frame.fraction.shape[axis]), start)
        there.append(slice(start, stop))
        here.append(slice(start - shift, stop - shift))
    return (there[0], there[1]), (here[0], here[1])


def _in_window(part: Coverage | None, frame: Coverage) -> np.ndarray:
    """Coverage in the window of another one."""
    result = np.zeros(frame.fraction.shape, np.float32)
    if part is not None:
        there, here = _overlap(part, frame)
        result[there] = part.fraction[here]
    return result


def _rows(cover: Coverage, low: int, high: int) -> Coverage:
    """The part of a coverage in some rows of the image."""
    first = min(max(low - cover.y0, 0), len(cover.fraction))
    kept = slice(first, max(high - cover.y0, first))
    return Coverage(cover.x0, cover.y0 + first, cover.fraction[kept], cover.spans[kept])


def _union(parts: list[Coverage]) -> Coverage:
    """Sum of the coverages in a common window."""
    if len(parts) == 1:
        return parts[0]
    x0, y0 = min(p.x0 for p in parts), min(p.y0 for p in parts)
    x1 = max(p.x0 + p.fraction.shape[1] for p in parts)
    y1 = max(p.y0 + p.fraction.shape[0] for p in parts)
    frame = Coverage.full(x0, y0, np.zeros((y1 - y0, x1 - x0), np.float32))
    for part in parts:
        frame.fraction[
            part.y0 - y0 : part.y0 - y0 + part.fraction.shape[0],
            part.x0 - x0 : part.x0 - x0 + part.fraction.shape[1],
        ] += part.fraction
    return frame
