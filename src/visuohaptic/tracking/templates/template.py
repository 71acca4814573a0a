"""Templates: images of known size that are detected and tracked, and a prediction of their quality.

Frame of a template: origin in the centre of the image, x to its right, y down, z into
the paper. A template that faces the camera upright has the identity rotation.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, UInt8

from ...core import POSITIVE, InputError, check_numbers, decode_image, read_bytes
from ...core.files.image_dpi import pixels_per_metre
from .alignment.esm_template import MIN_SIDE_PX, EsmTemplate

_log = logging.getLogger(__name__)

#: Maximum length of the longer side of the tracked image [px]; more costs time and gains little.
MAX_SIDE_PX = 400

#: Maximum number of features of an image: the strongest are kept.
_MAX_FEATURES = 800

#: An image tilted by 60 degrees is half as wide; simulated tilts are about this number of directions.
_NARROWED, _DIRECTIONS = 2, 4

#: Cells across an AprilTag 36h11 with its black border.
TAG_CELLS = 8

#: Template pixels per cell of a tag, and white cells around it (half of the usual quiet zone).
_TAG_CELL_PX = 40
_TAG_MARGIN_CELLS = 0.5

_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm")


def _cell_means(rows: Float[np.ndarray, "R C"], step: float) -> Float[np.ndarray, "r C"]:
    """Means over as many cells of ``step`` rows as fit, about the same centre.

    Cells remain square: sides rounded to whole pixels would stretch a printed image by up to half a pixel.
    """
    count = int(np.floor(len(rows) / step + 1e-9))
    ends = np.clip(0.5 * (len(rows) - count * step) + step * np.arange(count + 1), 0, len(rows))
    sums = np.vstack([np.zeros(rows.shape[1]), np.cumsum(rows, axis=0)])
    below = np.minimum(ends.astype(int), len(rows) - 1)
    part = (ends - below)[:, None]
    return np.diff(sums[below] * (1 - part) + sums[below + 1] * part, axis=0) / step


@dataclass(frozen=True, slots=True, eq=False)
class Template:
    """A planar image of known size, ready for detection and tracking.

    Examples
    --------
    >>> tag = Template.from_tag(7, size_m=0.04)
    >>> tag.tag_id, [round(side_m, 3) for side_m in tag.size_m]  # half a cell of white around its 8 cells
    (7, [0.045, 0.045])
    """

    name: str
    image: UInt8[np.ndarray, "R C"] = field(repr=False)  #: grey, at most 400 px on the longer side
    pixel_m: float  #: printed size of one pixel of ``image``
    tag_id: int | None  #: number in the AprilTag family 36h11; None for an image
    esm: EsmTemplate = field(repr=False)
    #: SIFT features of all views (column, row); none for a tag
    keypoints: Float[np.ndarray, "n 2"] = field(repr=False)
    descriptors: Float32[np.ndarray, "n 128"] = field(repr=False)

    @property
    def size_m(self) -> tuple[float, float]:
        """Printed width and height of the whole image [m]."""
        rows, columns = self.image.shape
        return columns * self.pixel_m, rows * self.pixel_m

    def points_m(self, pixels: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 3"]:
        """Convert template pixels (column, row) to points in the template's frame [m].

        Parameters
        ----------
        pixels
            Pixels (column, row) of the template.
        """
        rows, columns = self.image.shape
        pixels = np.asarray(pixels, dtype=np.float64)
        centre = np.array([(columns - 1) / 2, (rows - 1) / 2])
        return np.concatenate([(pixels - centre) * self.pixel_m, np.zeros((*pixels.shape[:-1], 1))], axis=-1)

    @property
    def tag_corners(self) -> Float[np.ndarray, "4 2"]:
        """Corners of the black border of a tag, in template pixels, clockwise from the top left."""
        low = _TAG_MARGIN_CELLS * _TAG_CELL_PX - 0.5
        high = low + TAG_CELLS * _TAG_CELL_PX
        return np.array([[low, low], [high, low], [high, high], [low, high]])

    @classmethod
    def from_image(cls, name: str, image: UInt8[np.ndarray, "R C"], *, width_m: float) -> Template:
        """Create a template from a grey image of known printed width [m].

        Parameters
        ----------
        name
            Name of the template.
        image
            Grey image.
        width_m
            Printed width [m].
        """
        image = np.asarray(image)
        if image.dtype != np.uint8 or image.ndim != 2:
            raise InputError(
                f"template {name}", f"found {image.dtype} {image.shape}, expected uint8 (rows, columns)"
            )
        check_numbers(f"template {name}", POSITIVE, width_m=width_m)
        pixel_m = width_m / image.shape[1]
        shrink = max(image.shape) / MAX_SIDE_PX
        if shrink > 1:
            if min(image.shape) < MIN_SIDE_PX * shrink:
                raise InputError(f"template {name}", f"found {image.shape}, which is too narrow a strip")
            means = _cell_means(_cell_means(image.astype(np.float64), shrink).T, shrink).T
            image, pixel_m = np.rint(np.ascontiguousarray(means)).astype(np.uint8), pixel_m * shrink
        try:
            esm = EsmTemplate.from_image(image)
        except InputError as error:
            raise InputError(f"template {name}", error.problem, remedy=error.remedy) from error
        return cls(name, image, pixel_m, None, esm, *_features_of_views(image))

    @classmethod
    def from_file(cls, path: Path | str, *, width_m: float | None = None) -> Template:
        """Create a template from an image file; its size from ``width_m`` or the file's resolution (dpi).

        Parameters
        ----------
        path
            Image file; its name without suffix becomes the template's name.
        width_m
            Printed width [m]; by default from the file's resolution.

        Raises
        ------
        InputError
            Not an image, no contrast, or neither a resolution in the file nor a given width.
        """
        path = Path(path)
        data = read_bytes(path)
        image = decode_image(data, path, "grey", upright=True)
        if width_m is None:
            resolution = pixels_per_metre(data)
            if resolution is None:
                raise InputError(
                    path,
                    "states no resolution (dpi), so its printed size is unknown",
                    remedy="give its width, or save it with a dpi value",
                )
            if abs(resolution[0] / resolution[1] - 1) > 0.01:
                raise InputError(
                    path, f"found {resolution} pixels per metre, expected the same both ways", field="dpi"
                )
            width_m = image.shape[1] / resolution[0]
        try:
            return cls.from_image(path.stem, image, width_m=width_m)
        except InputError as error:
            raise InputError(path, error.problem, field=error.field, remedy=error.remedy) from error

    @classmethod
    def from_tag(cls, tag_id: int, *, size_m: float, name: str | None = None) -> Template:
        """An AprilTag 36h11 as a template.

        The image has half a cell of white around it, which must be present in print.

        Parameters
        ----------
        tag_id, size_m
            Number of the tag, 0 to 586, and the side of its black border [m].
        name
            Name of the template; by default derived from the number.
        """
        import cv2

        check_numbers("tag", POSITIVE, size_m=size_m)
        image = tag_image(tag_id, _TAG_CELL_PX, round(_TAG_MARGIN_CELLS * _TAG_CELL_PX))
        # A camera never sees a step between two pixels, and steps are unfavourable for the tracker's gradients.
        image = cv2.GaussianBlur(image, (0, 0), 0.8)
        return cls(
            name if name is not None else f"tag_{tag_id}",
            image,
            size_m / (TAG_CELLS * _TAG_CELL_PX),
            tag_id,
            EsmTemplate.from_image(image, sharp=True),
            np.zeros((0, 2)),
            np.zeros((0, 128), np.float32),
        )


def tag_image(tag_id: int, cell_px: int, margin_px: int) -> UInt8[np.ndarray, "side side"]:
    """An AprilTag 36h11 with a white margin around its black border.

    Parameters
    ----------
    tag_id
        Number of the tag, 0 to 586.
    cell_px, margin_px
        Edge of a cell, and width of the margin.

    Raises
    ------
    InputError
        There is no such tag.
    """
    import cv2

    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    count = len(family.bytesList)
    if not 0 <= tag_id < count:
        raise InputError("tag", f"found {tag_id}, expected 0..{count - 1}", field="id")
    tag = cv2.aruco.generateImageMarker(family, tag_id, TAG_CELLS * cell_px)
    return np.pad(tag, margin_px, constant_values=255)


def load_templates(folder: Path | str) -> tuple[Template, ...]:
    """All templates of a folder: image files with a dpi value, and ``tags.yaml``.

    ``tags.yaml`` maps names to ``{id: 7, size_m: 0.04}``; optional ``widths_m`` in the same
    file gives the printed width of images that state no dpi.

    Parameters
    ----------
    folder
        Folder of images and, for tags, ``tags.yaml``.

    Raises
    ------
    InputError
        There is no template, or one of them cannot be used.
    """
    from ._template_file import TemplateFolderFile

    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(folder, "is not a folder", remedy="give a folder with template images")
    described = TemplateFolderFile.read(folder / "tags.yaml")
    images = [
        path
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in _SUFFIXES and not path.name.startswith(".")
    ]
    # Otherwise a misspelt name would leave an image with the dpi that its file states, of a screen for example.
    missing = sorted(set(described.widths_m) - {path.name for path in images})
    if missing:
        raise InputError(
            folder / "tags.yaml",
            f"names {missing[0]!r}, which is not an image of the folder",
            field="widths_m",
            remedy="write the file's name with its suffix, upper and lower case as it is",
        )
    templates = [Template.from_file(path, width_m=described.widths_m.get(path.name)) for path in images]
    templates += [
        Template.from_tag(tag.id, size_m=tag.size_m, name=name) for name, tag in described.tags.items()
    ]
    if not templates:
        raise InputError(folder, "has no template", remedy="put PNG or JPEG images or a tags.yaml there")
    names = [template.name for template in templates]
    double = sorted({name for name in names if names.count(name) > 1})
    if double:
        raise InputError(folder, f"found the name {double[0]!r} twice, expected different names")
    _log.info("%d templates from %s", len(templates), folder)
    return tuple(templates)


@dataclass(frozen=True, slots=True)
class TemplateQuality:
    """Expected detection and tracking performance of a template."""

    score: float  #: 0 (unusable) .. 1 (best), the minimum of the three criteria below
    corner_sigma_px: float  #: Cramer-Rao bound of the corners at noise 5, seen at 200 px on the longer side
    ambiguity: float  #: correlation of its quarters with other positions in it, 0 (unique) .. 1 (repeats)
    features: int  #: number of usable SIFT features; a tag is detected by its code instead
    problems: tuple[str, ...]  #: descriptions of what to change


def template_quality(template: Template) -> TemplateQuality:
    """Predict tracking noise, risk of a false lock, and detectability from the image alone.

    The noise is the Cramer-Rao bound of the eight parameters of a homography from all
    pixels; the risk is the autocorrelation of the image away from zero shift.

    Parameters
    ----------
    template
        The template.
    """
    import cv2

    from .alignment.warp import velocity_fields

    image = template.image
    scale = 200.0 / max(image.shape)
    small = cv2.resize(
        image,
        (max(MIN_SIDE_PX, round(image.shape[1] * scale)), max(MIN_SIDE_PX, round(image.shape[0] * scale))),
        interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC,
    ).astype(np.float64)
    gy, gx = np.gradient(small)
    rows, columns = small.shape
    unit = max(rows, columns) / 2
    y, x = np.mgrid[:rows, :columns]
    points = np.stack([(x - (columns - 1) / 2) / unit, (y - (rows - 1) / 2) / unit], -1).reshape(-1, 2)
    fields = velocity_fields(points)
    jacobian = gx.reshape(-1, 1) * fields[:, 0] + gy.reshape(-1, 1) * fields[:, 1]
    jacobian = np.column_stack([jacobian * unit, small.ravel(), np.ones(small.size)])
    corners = velocity_fields(points[[0, columns - 1, -1, -columns]]).reshape(8, 8) * unit
    covariance = 25.0 * np.linalg.pinv(jacobian.T @ jacobian)[:8, :8]
    sigma = float(np.sqrt(max(np.trace(corners @ covariance @ corners.T) / 4, 0.0)))

    ambiguity = _resemblance(
        cv2.resize(small.astype(np.float32), None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    )

    features = 0 if template.tag_id is not None else len(_features(template.image)[0])
    parts = {
        # 0.02 px is a typical photo; ten times that is hardly trackable.
        "noise": 1.0 / (1.0 + (sigma / 0.1) ** 2),
        "ambiguity": float(np.clip((1.0 - ambiguity) / 0.3, 0, 1)),
        "features": 1.0 if template.tag_id is not None else float(np.clip(features / 60.0, 0, 1)),
    }
    problems = []
    if parts["noise"] < 0.5:
        problems.append(
            f"too little texture: corner noise {sigma:.2f} px; add contrast and detail everywhere"
        )
    if parts["ambiguity"] < 0.5:
        problems.append(
            f"it repeats itself (correlation {ambiguity:.2f} when shifted); use an image without pattern"
        )
    if parts["features"] < 0.5:
        problems.append(f"only {features} SIFT features, 60 expected; add corners and blobs, or use a tag")
    return TemplateQuality(min(parts.values()), sigma, ambiguity, features, tuple(problems))


def _resemblance(image: Float32[np.ndarray, "R C"]) -> float:
    """How well the four quarters of an image match other positions in it: mean of the best correlations, 0..1."""
    import cv2

    rows, columns = image.shape[0] // 2, image.shape[1] // 2
    best = []
    for top in (0, image.shape[0] - rows):
        for left in (0, image.shape[1] - columns):
            part = image[top : top + rows, left : left + columns]
            if part.std() < 1.0:
                continue
            match = cv2.matchTemplate(image, part, cv2.TM_CCOEFF_NORMED)
            v, u = np.mgrid[: match.shape[0], : match.shape[1]]
            away = np.hypot(u - left, v - top) >= max(3.0, 0.16 * max(rows, columns))
            # Only peaks: the flank of the true position is not a second match.
            peaks = match >= cv2.dilate(match, np.ones((3, 3), np.uint8))
            best.append(float(np.clip(match[away & peaks].max(initial=0.0), 0, 1)))
    return float(np.mean(best)) if best else 1.0


def _features(image: UInt8[np.ndarray, "R C"]) -> tuple[np.ndarray, np.ndarray]:
    """SIFT features of one image (column, row), and their descriptors."""
    import cv2

    points, descriptors = cv2.SIFT.create(_MAX_FEATURES).detectAndCompute(image, None)
    if descriptors is None:
        descriptors = np.zeros((0, 128), np.float32)
    return np.array([point.pt for point in points], dtype=np.float64).reshape(-1, 2), descriptors


def _features_of_views(image: UInt8[np.ndarray, "R C"]) -> tuple[np.ndarray, np.ndarray]:
    """Features of an image and of its simulated tilted views; all in the pixels of the image.

    SIFT tolerates tilts up to about 40 degrees. As in Morel and Yu (SIAM J. Imaging Sciences 2, 2009), the image
    is rotated, blurred according to the compression (0.8 px at each remaining pixel), and compressed.
    """
    import cv2

    size = np.array(image.shape[::-1])
    side, middle = int(np.ceil(np.hypot(*size))), 0.5 * (size - 1.0)
    found = [_features(image)]
    for turn_deg in 180.0 / _DIRECTIONS * np.arange(_DIRECTIONS):
        turn = cv2.getRotationMatrix2D(middle.tolist(), float(turn_deg), 1.0)
        turn[:, 2] += 0.5 * (side - 1.0) - middle
        turned = cv2.warpAffine(image, turn, (side, side), borderMode=cv2.BORDER_REPLICATE)
        soft = cv2.GaussianBlur(turned, (0, 0), sigmaX=0.8 * (_NARROWED**2 - 1) ** 0.5, sigmaY=1e-3)
        points, descriptors = _features(np.ascontiguousarray(soft[:, ::_NARROWED]))
        back = cv2.invertAffineTransform(turn)
        points = points * [_NARROWED, 1] @ back[:, :2].T + back[:, 2]
        inside = ((points >= 0) & (points <= size - 1)).all(axis=1)
        found.append((points[inside], descriptors[inside]))
    return np.concatenate([one for one, _ in found]), np.concatenate([one for _, one in found])
