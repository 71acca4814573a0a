"""Print sheets: images and tags at their exact size, with a bar to check the printer's scale.

A PDF places every image at its physical size, regardless of its pixels; a PNG rounds to
whole dots, and the resulting size is reported.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from ...core import POSITIVE, InputError, at_least, check_choice, check_numbers, within
from ...core.files import atomic_path, check_target, encode_image
from .template import TAG_CELLS, tag_image

#: Width and height of supported papers [m].
PAPERS_M = {"A4": (0.210, 0.297), "A3": (0.297, 0.420), "letter": (0.2159, 0.2794)}

_MARGIN_M = 0.010
_GAP_M = 0.008
_LABEL_M = 0.005
_BAR_M = 0.100
_INCH_M = 0.0254
#: Of the finest printers.
_MAX_DPI = 2400


@dataclass(frozen=True, slots=True, eq=False)
class SheetItem:
    """One image to print."""

    label: str
    image: UInt8[np.ndarray, "R C"]
    width_m: float  #: of the whole image in print


@dataclass(frozen=True, slots=True, eq=False)
class PlacedItem:
    """An image with its position on the paper."""

    item: SheetItem
    left_m: float  #: from the left edge of the paper
    top_m: float  #: from the upper edge of the paper

    @property
    def height_m(self) -> float:
        """Height in print [m]."""
        return self.item.width_m * self.item.image.shape[0] / self.item.image.shape[1]


def tag_item(tag_id: int, size_m: float) -> SheetItem:
    """An AprilTag 36h11 with its white border of one cell.

    Parameters
    ----------
    tag_id
        Number of the tag, 0 to 586.
    size_m
        Side of its black border [m]: a cell is at least one dot of the finest printers.
    """
    check_numbers("tag", at_least(TAG_CELLS * _INCH_M / _MAX_DPI), size_m=size_m)
    image = tag_image(tag_id, 20, 20)
    return SheetItem(f"tag36h11 {tag_id}, {1e3 * size_m:g} mm", image, size_m * (TAG_CELLS + 2) / TAG_CELLS)


def lay_out(items: Sequence[SheetItem], paper: str = "A4") -> tuple[PlacedItem, ...]:
    """Place images in rows from the upper left.

    Parameters
    ----------
    items
        Images with their printed widths.
    paper
        Name of the paper, of ``PAPERS_M``.

    Raises
    ------
    InputError
        The paper is unknown or too small.
    """
    check_choice("sheet", PAPERS_M, paper, field="paper")
    width, height = PAPERS_M[paper]
    bottom = height - _MARGIN_M - 2 * _LABEL_M - _GAP_M
    left = top = _MARGIN_M
    row_height = 0.0
    placed = []
    for item in items:
        check_numbers(f"sheet: {item.label}", POSITIVE, width_m=item.width_m)
        if left > _MARGIN_M and left + item.width_m > width - _MARGIN_M:
            left, top, row_height = _MARGIN_M, top + row_height + _LABEL_M + _GAP_M, 0.0
        place = PlacedItem(item, left, top)
        if left + item.width_m > width - _MARGIN_M or top + place.height_m + _LABEL_M > bottom:
            raise InputError(
                "sheet",
                f"{item.label} ({1e3 * item.width_m:.5g} x {1e3 * place.height_m:.5g} mm) does not fit on {paper}",
                remedy="use fewer or smaller templates, or a larger paper",
            )
        placed.append(place)
        left += item.width_m + _GAP_M
        row_height = max(row_height, place.height_m)
    return tuple(placed)


def save_sheet(
    path: Path | str, items: Sequence[SheetItem], *, paper: str = "A4", dpi: float = 300.0
) -> dict[str, float]:
    """Write a print-ready PDF or PNG; returns the printed width of each image [m] by its label.

    Parameters
    ----------
    path
        Ends with ``.pdf`` or ``.png``.
    items
        Images to print.
    paper
        ``A4``, ``A3`` or ``letter``.
    dpi
        Dots per inch of a PNG.
    """
    path = check_target(path, (".pdf", ".png"))
    placed = lay_out(items, paper)
    if path.suffix.lower() == ".pdf":
        data = _pdf(placed, PAPERS_M[paper])
        widths = {place.item.label: place.item.width_m for place in placed}
    else:
        check_numbers("sheet", within(50, _MAX_DPI), dpi=dpi)
        data, widths = _png(placed, PAPERS_M[paper], dpi)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
    return widths


def _png(
    placed: tuple[PlacedItem, ...], paper_m: tuple[float, float], dpi: float
) -> tuple[bytes, dict[str, float]]:
    import cv2

    dots = dpi / _INCH_M
    page = np.full((round(paper_m[1] * dots), round(paper_m[0] * dots)), 255, np.uint8)
    widths = {}
    for place in placed:
        image = place.item.image
        size = (max(1, round(place.item.width_m * dots)), max(1, round(place.height_m * dots)))
        # Enlarged pixels keep sharp edges; downscaled ones are averaged.
        kind = cv2.INTER_AREA if size[0] < image.shape[1] else cv2.INTER_NEAREST_EXACT
        x, y = round(place.left_m * dots), round(place.top_m * dots)
        page[y : y + size[1], x : x + size[0]] = cv2.resize(image, size, interpolation=kind)
        widths[place.item.label] = size[0] / dots
        _text(page, place.item.label, x, round(y + size[1] + _LABEL_M * dots * 0.8), dots)
    y = page.shape[0] - round((_MARGIN_M + _LABEL_M) * dots)
    x, length = round(_MARGIN_M * dots), round(_BAR_M * dots)
    page[y : y + max(2, round(0.0005 * dots)), x : x + length] = 0
    _text(page, "this bar must measure 100 mm: print without scaling", x, y + round(_LABEL_M * dots), dots)
    encoded = encode_image(page)
    per_metre = round(dots)
    body = b"pHYs" + struct.pack(">IIB", per_metre, per_metre, 1)
    chunk = struct.pack(">I", 9) + body + struct.pack(">I", zlib.crc32(body))
    # The resolution follows the header: 8 bytes of signature, 25 of the IHDR chunk.
    return encoded[:33] + chunk + encoded[33:], widths


def _text(page: np.ndarray, text: str, x: int, y: int, dots: float) -> None:
    import cv2

    # The font is about 22 px high at scale 1; letters of 2.5 mm.
    scale = 0.0025 * dots / 22
    cv2.putText(page, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, scale, 0, max(1, round(2 * scale)), cv2.LINE_AA)


def _pdf(placed: tuple[PlacedItem, ...], paper_m: tuple[float, float]) -> bytes:
    """One page; every image is a compressed grey image, placed in points of 1/72 inch."""
    point = 72 / _INCH_M
    width, height = paper_m[0] * point, paper_m[1] * point
    drawing = []
    images = []
    for number, place in enumerate(placed):
        w, h = place.item.width_m * point, place.height_m * point
        x, y = place.left_m * point, height - place.top_m * point - h
        drawing.append(f"q {w:.4f} 0 0 {h:.4f} {x:.4f} {y:.4f} cm /I{number} Do Q")
        drawing.append(_pdf_text(place.item.label, x, y - 0.004 * point))
        rows, columns = place.item.image.shape
        data = zlib.compress(np.ascontiguousarray(place.item.image).tobytes(), 9)
        images.append(
            (
                f"/Type /XObject /Subtype /Image /Width {columns} /Height {rows} /ColorSpace /DeviceGray "
                f"/BitsPerComponent 8 /Filter /FlateDecode /Length {len(data)}",
                data,
            )
        )
    x, y = _MARGIN_M * point, (_MARGIN_M + _LABEL_M) * point
    drawing.append(f"1 w {x:.4f} {y:.4f} m {x + _BAR_M * point:.4f} {y:.4f} l S")
    drawing.append(_pdf_text("this bar must measure 100 mm: print without scaling", x, y - 0.004 * point))
    content = "\n".join(drawing).encode("latin-1", "replace")
    names = " ".join(f"/I{k} {5 + k + 1} 0 R" for k in range(len(images)))
    parts: list[tuple[str, bytes | None]] = [
        ("/Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >>", None),
        ("/Type /Pages /Kids [3 0 R] /Count 1", None),
        (
            f"/Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.4f} {height:.4f}] /Contents 4 0 R "
            f"/Resources << /Font << /F 5 0 R >> /XObject << {names} >> >>",
            None,
        ),
        (f"/Length {len(content)}", content),
        ("/Type /Font /Subtype /Type1 /BaseFont /Helvetica", None),
        *images,
    ]
    result = bytearray(b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n")
    offsets = []
    for number, (entries, body) in enumerate(parts, start=1):
        offsets.append(len(result))
        stream = b"" if body is None else b"\nstream\n" + body + b"\nendstream"
        result += f"{number} 0 obj\n<< {entries} >>".encode("latin-1") + stream + b"\nendobj\n"
    start = len(result)
    result += f"xref\n0 {len(parts) + 1}\n0000000000 65535 f \n".encode()
    for offset in offsets:
        result += f"{offset:010d} 00000 n \n".encode()
    result += f"trailer\n<< /Size {len(parts) + 1} /Root 1 0 R >>\nstartxref\n{start}\n%%EOF\n".encode()
    return bytes(result)


def _pdf_text(text: str, x: float, y: float) -> str:
    escaped = text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
    return f"BT /F 7 Tf {x:.4f} {y:.4f} Td ({escaped}) Tj ET"
