"""One self-contained HTML file: texts, tables, plots and images, readable offline."""

from __future__ import annotations

import base64
import html
import io
import math
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from jaxtyping import UInt8

from .._version import __version__
from ..core.errors import InputError
from ..core.files import encode_image, write_text
from ..core.files.figures import replace_undrawable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STYLE = """
:root { color-scheme: light dark; --ink: #1c2430; --soft: #5b6675; --line: #dde2e8; --back: #f6f7f9;
  --card: #ffffff; --mark: #c2571a; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e8ee; --soft: #98a3b3; --line: #333c49;
  --back: #14181e; --card: #1c222b; --mark: #f0935a; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--back); color: var(--ink);
  font: 16px/1.6 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
main { max-width: 62rem; margin: 0 auto; padding: 2.5rem 1.25rem 4rem; }
h1 { font-size: 2rem; line-height: 1.2; margin: 0 0 .3rem; letter-spacing: -.01em; }
h2 { font-size: 1.3rem; margin: 3rem 0 .8rem; padding-top: 1.2rem; border-top: 1px solid var(--line); }
p { max-width: 44rem; margin: .6rem 0; }
.about { color: var(--soft); font-size: .9rem; }
nav { margin: 1.2rem 0 0; font-size: .92rem; display: flex; flex-wrap: wrap; gap: .2rem 1.1rem; }
nav a { color: var(--mark); text-decoration: none; white-space: nowrap; }
nav a:hover { text-decoration: underline; }
figure { margin: 1.2rem 0; padding: .9rem; background: var(--card); border: 1px solid var(--line);
  border-radius: 10px; }
figure img, figure svg { display: block; width: 100%; height: auto; border-radius: 5px; background: #fff; }
figcaption { color: var(--soft); font-size: .9rem; line-height: 1.45; margin-top: .7rem; }
.scroll { overflow-x: auto; margin: 1rem 0; background: var(--card); border: 1px solid var(--line);
  border-radius: 10px; }
table { border-collapse: collapse; width: 100%; font-size: .92rem; font-variant-numeric: tabular-nums; }
caption { caption-side: top; text-align: left; padding: .7rem .9rem 0; color: var(--soft); }
th, td { padding: .45rem .9rem; text-align: left; border-bottom: 1px solid var(--line); }
th { font-weight: 600; white-space: nowrap; }
tr:last-child td { border-bottom: 0; }
.number { text-align: right; white-space: nowrap; }
pre { overflow-x: auto; background: var(--card); border: 1px solid var(--line); border-radius: 10px;
  padding: .8rem 1rem; font-size: .87rem; line-height: 1.45; }
footer { margin-top: 4rem; color: var(--soft); font-size: .85rem; }
@media (max-width: 40rem) { main { padding: 1.5rem .8rem 3rem; } h1 { font-size: 1.6rem; }
  table { font-size: .8rem; } th, td { padding: .35rem .45rem; } figure { padding: .5rem; overflow-x: auto; }
  figcaption { position: sticky; left: 0; } nav a { white-space: normal; } }
@media screen and (max-width: 40rem) { figure:focus svg { width: auto; zoom: .75; } /* a pixel per point */
  figure[tabindex]:not(:focus) figcaption::after { content: " (tap to enlarge)"; } }
@media (max-width: 26rem) { table { font-size: .74rem; } th, td { padding: .3rem; hyphens: auto; } th { white-space: normal; } }
@page { margin: 16mm 14mm; }
@media print { :root { font-size: 13px; color-scheme: light; --ink: #1c2430; --soft: #5b6675; --line: #dde2e8; --card: #fff; --mark: #c2571a; }
  nav { display: none; } body { background: #fff; font-size: 1rem; line-height: 1.45; } main { max-width: none; padding: 0; }
  h1 { font-size: 1.7rem; } h2 { margin: 1.4rem 0 .5rem; padding-top: .7rem; } p { max-width: none; }
  figure, tr, .scroll { break-inside: avoid; } h2, h2 + p { break-after: avoid; } thead { display: table-header-group; }
  .scroll, pre { overflow: visible; } .scroll, figure { margin: .6rem 0; } th, td { padding: .22rem .6rem; }
  figure { padding: .5rem; } figcaption { margin-top: .4rem; } footer { margin-top: 1rem; }
  figure img, figure svg { max-height: 9cm; width: auto; max-width: 100%; margin: 0 auto; } }
"""

#: Makes the browser refuse to load any external content.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"

#: Images with more pixels are stored as WebP, unless they are longer than this format allows.
_LARGE_PX, _WEBP_PX = 200_000, 16_383


class Report:
    """A page that is written from top to bottom, then saved.

    The file is self-contained: it loads no script, font or image. All texts are escaped.

    Parameters
    ----------
    title
        Headline of the page.
    about
        Subtitle: what was run, when, with which seed.

    Examples
    --------
    >>> report = Report("Three pushes", about="seed 7")
    >>> _ = report.section("Forces").table([{"object": "box", "force [N]": 1.25}])
    >>> "<td class=\\"number\\">1.25</td>" in report.html()
    True
    """

    def __init__(self, title: str, *, about: str = "") -> None:
        self.title = title
        self.about = about
        self._parts: list[str] = []
        self._sections: list[tuple[str, str]] = []
        self._drawings = 0

    def section(self, title: str) -> Self:
        """Start a section; it is listed in the table of contents.

        Parameters
        ----------
        title
            Heading.
        """
        anchor = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-") or "section"
        anchor = f"{anchor}-{len(self._sections) + 1}"
        self._sections.append((anchor, title))
        self._parts.append(f'<h2 id="{anchor}">{html.escape(title)}</h2>')
        return self

    def text(self, text: str) -> Self:
        """Add paragraphs; an empty line separates them.

        Parameters
        ----------
        text
            Plain text.
        """
        for paragraph in re.split(r"\n\s*\n", text.strip()):
            self._parts.append(f"<p>{html.escape(paragraph)}</p>")
        return self

    def code(self, text: str) -> Self:
        """Add a command or a file verbatim.

        Parameters
        ----------
        text
            Text, shown verbatim.
        """
        self._parts.append(f"<pre>{html.escape(text)}</pre>")
        return self

    def table(self, rows: Sequence[Mapping[str, Any]], caption: str = "") -> Self:
        """Add a table.

        Parameters
        ----------
        rows
            One mapping per row; the keys are the headings, with units. Numbers
            are rounded to four digits, ``None`` is shown as "not observed" and NaN
            as a dash.
        caption
            One line above the table.
        """
        names = list(dict.fromkeys(name for row in rows for name in row))
        numeric = {name: all(_is_number(row.get(name)) for row in rows) for name in names}

        def cell(tag: str, name: str, content: str) -> str:
            return (
                f'<{tag} class="number">{content}</{tag}>' if numeric[name] else f"<{tag}>{content}</{tag}>"
            )

        head = "".join(cell("th", name, html.escape(name)) for name in names)
        body = "".join(
            "<tr>" + "".join(cell("td", name, _shown(row.get(name, ""))) for name in names) + "</tr>\n"
            for row in rows
        )
        above = f"<caption>{html.escape(caption)}</caption>" if caption else ""
        self._parts.append(
            f'<div class="scroll"><table>{above}<thead><tr>{head}</tr></thead>\n'
            f"<tbody>{body}</tbody></table></div>"
        )
        return self

    def figure(self, figure: Figure, caption: str = "") -> Self:
        """Add a matplotlib figure as vector graphics, and close it.

        Parameters
        ----------
        figure
            Figure; it is closed.
        caption
            Caption below the figure.
        """
        import matplotlib

        replace_undrawable(figure)
        self._drawings += 1
        stream = io.StringIO()
        # A salt per drawing makes the ids of different drawings unique and reproducible.
        with matplotlib.rc_context({"svg.hashsalt": f"drawing{self._drawings}", "svg.fonttype": "path"}):
            figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
        if (pyplot := sys.modules.get("matplotlib.pyplot")) is not None:
            pyplot.close(figure)  # otherwise its global list keeps every figure alive
        drawing = stream.getvalue()
        drawing = drawing[drawing.index("<svg") :]
        drawing = re.sub(r"<metadata>.*?</metadata>", "", drawing, flags=re.DOTALL)
        return self._picture(_unique_ids(drawing, f"d{self._drawings}-"), caption)

    def image(self, image: UInt8[np.ndarray, "rows columns *colour"], caption: str = "") -> Self:
        """Add an image, grey or in OpenCV's order blue, green, red.

        Large images are compressed as WebP: camera noise makes a PNG thirty times as large.

        Parameters
        ----------
        image
            8-bit image.
        caption
            Caption below the image.

        Raises
        ------
        InputError
            It is not an 8-bit image.
        """
        colours = image.shape[2:] or (1,)
        if image.dtype != np.uint8 or 0 in image.shape or colours not in ((1,), (3,), (4,)):
            raise InputError(
                "Report", f"found {image.dtype} of shape {image.shape}, expected 8-bit pixels", field="image"
            )
        large = image.shape[0] * image.shape[1] > _LARGE_PX and max(image.shape) <= _WEBP_PX
        kind = "webp" if large else "png"
        quality = 80 if kind == "webp" else None
        data = base64.b64encode(encode_image(image, kind, quality=quality, where="Report")).decode("ascii")
        alternative = html.escape(caption, quote=True)
        return self._picture(f'<img alt="{alternative}" src="data:image/{kind};base64,{data}">', caption)

    def _picture(self, picture: str, caption: str) -> Self:
        below = f"<figcaption>{html.escape(caption)}</figcaption>" if caption else ""
        drawing = ' tabindex="0"' if "<svg" in picture else ""  # it can be enlarged on a phone
        self._parts.append(f"<figure{drawing}>{picture}{below}</figure>")
        return self

    def html(self) -> str:
        """The whole page."""
        title = html.escape(self.title)
        about = f'<p class="about">{html.escape(self.about)}</p>' if self.about else ""
        links = "".join(f'<a href="#{anchor}">{html.escape(name)}</a>' for anchor, name in self._sections)
        menu = f"<nav>{links}</nav>" if links else ""
        body = "\n".join(self._parts)
        return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{_POLICY}">
<title>{title}</title>
<style>{_STYLE}</style>
</head>
<body>
<main>
<header><h1>{title}</h1>{about}{menu}</header>
{body}
<footer>Written by visuohaptic {__version__}. This file is self-contained.</footer>
</main>
</body>
</html>
"""

    def write(self, path: Path | str) -> Path:
        """Save the page atomically.

        Parameters
        ----------
        path
            Path of the HTML file.
        """
        write_text(path, self.html().encode(errors="replace").decode())  # names of files need not be UTF-8
        return Path(path)


def _unique_ids(drawing: str, prefix: str) -> str:
    """Add a prefix to the ids of one drawing: every matplotlib drawing contains a "figure_1"."""
    drawing = re.sub(r'\bid="', f'id="{prefix}', drawing)
    drawing = re.sub(r'href="#', f'href="#{prefix}', drawing)
    return re.sub(r"url\(#", f"url(#{prefix}", drawing)


def _is_number(value: object) -> bool:
    return value is None or (
        isinstance(value, (int, float, np.number)) and not isinstance(value, (bool, np.bool_))
    )


def _shown(value: object) -> str:
    if value is None:
        return '<span class="about">not observed</span>'
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, (float, np.floating)):
        return f"{value:.4g}".replace("-", "\u2212") if math.isfinite(value) else "\u2013"
    return html.escape(str(value))
