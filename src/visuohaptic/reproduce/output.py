"""Where an experiment writes: data, pictures, and its numbers beside the dissertation's."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.errors import InputError
from ..core.files import atomic_path, write_image, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Columns", "Comparison", "Output"]


@dataclass(frozen=True, slots=True)
class Comparison:
    """One number of ours, beside the one that is printed in the dissertation."""

    name: str
    ours: float
    unit: str  #: empty for a plain number
    dissertation: float | None = None  #: ``None`` where it prints none
    note: str = ""  #: how they compare, or what differs


class Columns(dict[str, list[Any]]):
    """A table that grows row by row: heading with unit -> values.

    Parameters
    ----------
    headings
        With a blank between them.
    """

    def __init__(self, headings: str) -> None:
        super().__init__((heading, []) for heading in headings.split())

    def add(self, *values: Any) -> None:
        """Add a row.

        Parameters
        ----------
        *values
            One for each heading, in their order.
        """
        for column, value in zip(self.values(), values, strict=True):
            column.append(value)


@dataclass
class Output:
    """The folder of one experiment.

    Parameters
    ----------
    folder
        Exists.
    seed
        Of everything random in it; see :meth:`rng`.
    quick
        A small case, for tests: the same steps with fewer samples.
    """

    folder: Path
    seed: int = 0
    quick: bool = False
    comparisons: list[Comparison] = field(default_factory=list)
    tables: list[str] = field(default_factory=list)
    pictures: list[str] = field(default_factory=list)
    rows: int = 0  #: of all tables together

    def rng(self, *stream: int) -> np.random.Generator:
        """A generator of this experiment's own.

        Parameters
        ----------
        *stream
            Numbers of the stream; others give another generator.
        """
        return np.random.default_rng([self.seed, *stream])

    @property
    def shared(self) -> Path:
        """A folder beside the experiments', for what several of them need and is long to make."""
        path = self.folder.parent / "shared"
        path.mkdir(exist_ok=True)
        return path

    def table(self, name: str, columns: Mapping[str, Sequence[Any] | np.ndarray]) -> Path:
        """Write ``NAME.csv``.

        Parameters
        ----------
        name
            Without suffix.
        columns
            Heading with unit -> values; all of one length.

        Raises
        ------
        InputError
            Columns are empty or of different lengths.
        """
        lengths = {len(values) for values in columns.values()}
        if len(lengths) != 1 or 0 in lengths:
            raise InputError(
                "Output.table",
                f"found columns of {sorted(lengths)} rows, expected one length > 0",
                field=name,
            )
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*([_plain(v) for v in values] for values in columns.values()), strict=True))
        path = self.folder / f"{name}.csv"
        write_text(path, text.getvalue())
        self.tables.append(path.name)
        self.rows += lengths.pop()
        return path

    def picture(self, name: str, figure: Figure, *, dpi: float = 110) -> Path:
        """Write ``NAME.png``.

        Parameters
        ----------
        name
            Without suffix.
        figure
            Of matplotlib.
        dpi
            Resolution.
        """
        path = self.folder / f"{name}.png"
        with atomic_path(path) as temporary:
            figure.savefig(temporary, dpi=dpi, format="png")
        self.pictures.append(path.name)
        return path

    def drawn(self, name: str, draw: Callable[[Path], object]) -> Path:
        """Write ``NAME.png`` by a function that draws to a path.

        Parameters
        ----------
        name
            Without suffix.
        draw
            Called with the path.
        """
        path = self.folder / f"{name}.png"
        draw(path)
        self.pictures.append(path.name)
        return path

    def image(self, name: str, image: np.ndarray) -> Path:
        """Write pixels (grey or blue, green, red; 8 bits) as ``NAME.png``.

        Parameters
        ----------
        name
            Without suffix.
        image
            Pixels.

        Raises
        ------
        InputError
            The pixels cannot be encoded.
        """
        return self.drawn(name, lambda path: write_image(path, image))

    def compare(
        self, name: str, ours: float, unit: str = "", *, dissertation: float | None = None, note: str = ""
    ) -> None:
        """Add a number, and what the dissertation prints for it.

        Parameters
        ----------
        name
            What it is.
        ours
            Finite.
        unit
            Empty for a plain number.
        dissertation
            Printed number; ``None`` where there is none.
        note
            How they compare.

        Raises
        ------
        InputError
            The number is not finite.
        """
        value = float(ours)
        if not math.isfinite(value):
            raise InputError("Output.compare", f"found {value}, expected a finite number", field=name)
        self.comparisons.append(Comparison(name, value, unit, dissertation, note))

    def summary(self) -> dict[str, Any]:
        """What goes to ``result.json``."""
        return {
            "comparisons": [asdict(one) for one in self.comparisons],
            "tables": self.tables,
            "pictures": self.pictures,
            "rows": self.rows,
        }


def _plain(value: Any) -> Any:
    """Numbers as short as they stay exact enough to plot and compare."""
    if isinstance(value, np.generic):
        value = value.item()
    return f"{value:.7g}" if isinstance(value, float) else value
