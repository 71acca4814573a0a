"""Pages with all results: one next to them, one for the documentation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..core.errors import InputError
from ..core.files import read_image, write_image, write_text
from .runner import EXPERIMENTS, read_result

HEADING = "# The dissertation's figures and tables, reproduced"
#: Figures in the documentation: maximum width [px], quality of WebP.
WIDTH_px, QUALITY = 1000, 80


def write_index(folder: Path | str) -> Path:
    """Write ``index.md``: all results in the folder, with figures, data and numbers.

    Parameters
    ----------
    folder
        Of the results.
    """
    folder = Path(folder)
    lines = [HEADING, ""]
    for key in EXPERIMENTS:
        result = read_result(folder / key)
        if result is not None:
            pictures = [f"{key}/{picture}" for picture in result["pictures"]]
            data = ", ".join(f"[{name}]({key}/{name})" for name in result["tables"])
            made = f"Seed {result['seed']}, {result['seconds']:.0f} s"
            lines += [*_section(key, result, pictures), f"Data: {data}. {made}.", ""]
    path = folder / "index.md"
    write_text(path, "\n".join(lines))
    return path


def write_gallery(folder: Path | str, docs: Path | str) -> Path:
    """Write ``gallery.md`` and ``images/gallery`` of the documentation from the results in a folder.

    Figures are scaled down; no times are written, so that the same results give the same page.

    Parameters
    ----------
    folder
        Of the results.
    docs
        Folder of the documentation.

    Raises
    ------
    InputError
        There is no result in the folder, or one of them is from a quick run.
    """
    folder, docs = Path(folder), Path(docs)
    images = docs / "images" / "gallery"
    results = {key: read_result(folder / key) for key in EXPERIMENTS}
    found = {key: result for key, result in results.items() if result is not None}
    if not found:
        raise InputError(folder, "found no result, expected some", remedy="run visuohaptic reproduce all")
    quick = [key for key, result in found.items() if result["quick"]]
    if quick:
        raise InputError(folder, f"found quick runs of {', '.join(quick)}", remedy="run them without --quick")
    images.mkdir(parents=True, exist_ok=True)
    lines, made = [HEADING, ""], set()
    for key, result in found.items():
        pictures = []
        for picture in result["pictures"]:
            small = images / f"{key}_{Path(picture).stem}.webp"
            _shrink(folder / key / picture, small)
            made.add(small.name)
            pictures.append(f"images/gallery/{small.name}")
        lines += _section(key, result, pictures)
        lines += [f"`visuohaptic reproduce {key}`, seed {result['seed']}.", ""]
    for old in images.glob("*.webp"):
        if old.name not in made:
            old.unlink()
    path = docs / "gallery.md"
    write_text(path, "\n".join(lines))
    return path


def _section(key: str, result: dict[str, Any], pictures: list[str]) -> list[str]:
    lines = [f"## {key.replace('-', ' ').capitalize()} · {result['title']}", ""]
    for picture in pictures:
        lines += [f"![{result['title']}]({picture})", ""]
    lines += [result["caption"], ""]
    if result["comparisons"]:
        lines += ["| figure | ours | dissertation | unit | note |", "|---|---|---|---|---|"]
        for one in result["comparisons"]:
            printed = "" if one["dissertation"] is None else f"{one['dissertation']:.4g}"
            lines.append(f"| {one['name']} | {one['ours']:.4g} | {printed} | {one['unit']} | {one['note']} |")
        lines.append("")
    return lines


def _shrink(source: Path, target: Path) -> None:
    import cv2

    image = read_image(source, "colour")
    scale = WIDTH_px / image.shape[1]
    if scale < 1.0:
        image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    write_image(target, image, quality=QUALITY)
