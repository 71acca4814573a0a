"""Style of all figures: colours, axes, and creation of figures."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, ParamSpec

from ..core.files import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Given = ParamSpec("Given")

#: Colours that are distinguishable for colour-blind readers (Okabe and Ito).
COLOURS = {
    "blue": "#0072b2",
    "orange": "#d55e00",
    "green": "#009e73",
    "yellow": "#e69f00",
    "sky": "#56b4e9",
    "pink": "#cc79a7",
    "grey": "#7a828c",
    "ink": "#1c2430",
}
#: Line colours in order.
CYCLE = tuple(COLOURS[name] for name in ("blue", "orange", "green", "pink", "yellow", "sky"))

_STYLE = {
    "axes.axisbelow": True,
    "axes.edgecolor": "#b6bdc6",
    "axes.grid": True,
    "axes.labelcolor": COLOURS["ink"],
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 10.5,
    "figure.constrained_layout.use": True,
    "figure.dpi": 110,
    "font.size": 10,
    "grid.color": "#e6e9ed",
    "legend.fontsize": 9,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "xtick.color": "#4a5460",
    "ytick.color": "#4a5460",
}


def styled(draw: Callable[Given, Figure]) -> Callable[Given, Figure]:
    """Decorator of a function that returns a figure: applies the common style locally.

    Parameters
    ----------
    draw
        Creates the figure.
    """

    @wraps(draw)
    def drawn(*args: Given.args, **keywords: Given.kwargs) -> Figure:
        import matplotlib

        with matplotlib.rc_context(_STYLE):
            return draw(*args, **keywords)

    return drawn


@styled
def draw_axes(
    rows: int, columns: int, draw: Callable[..., object], *, size: tuple[float, float] = (9.0, 4.0)
) -> Figure:
    """Create a figure in the common style, filled by a function.

    Parameters
    ----------
    rows, columns
        Number of axes.
    draw
        Called with all axes, row by row.
    size
        Width and height [in].
    """
    figure, axes = new_figure(rows, columns, size=size)
    draw(*axes)
    return figure
