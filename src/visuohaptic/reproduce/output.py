"""Output of an experiment: data, figures, and its numbers compared with the dissertation's."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.errors import InputError
from ..core.files import atomic_path, write_csv, write_image

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class Comparison:
    """One number of this library, and the corresponding printed one of the dissertation."""

    name: str
    ours: float
    unit: str  #: empty for a dimensionless number
    dissertation: float | None = None  #: ``None`` if none is printed
    note: str = ""  #: comparison, or differences in the conditions


class Columns(dict[str, list[Any]]):
    """A table that is filled row by row: heading with unit -> values.

    Parameters
    ----------
    headings
        Headings, separated by blanks.
    """

    def __init__(self, headings: str) -> None:
        super().__init__((heading, []) for heading in headings.split())

    def add(self, *values: Any) -> None:
        """Add a row.

        Parameters
        ----------
        *values
            One for each heading, in the same order.
        """
        for column, value in zip(self.values(), values, strict=True):
            column.append(value)


@dataclass
class Output:
    """The folder of one experiment.

    Parameters
    ----------
    folder
        Existing folder.
    seed
        Of all random numbers; see :meth:`rng`.
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
        """A random generator of this experiment.

        Parameters
        ----------
        *stream
            Numbers that identify the stream; other numbers give an independent generator.
        """
        return np.random.default_rng([self.seed, *stream])

    @property
    def shared(self) -> Path:
        """A folder next to the experiments', for shared data that are expensive to compute."""
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
            Heading with unit -> values; all of the same length.

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
        path = self.folder / f"{name}.csv"
        rows = zip(*(map(_plain, values) for values in columns.values()), strict=True)
        write_csv(path, columns, rows)
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
        """Write ``NAME.png`` with a function that draws to a path.

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
        """Add a number, and the one printed in the dissertation.

        Parameters
        ----------
        name
            Name of the quantity.
        ours
            Finite.
        unit
            Empty for a dimensionless number.
        dissertation
            Printed number; ``None`` if there is none.
        note
            Comparison of both.

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
        """Content of ``result.json``."""
        return {
            "comparisons": [asdict(one) for one in self.comparisons],
            "tables": self.tables,
            "pictures": self.pictures,
            "rows": self.rows,
        }


def _plain(value: Any) -> Any:
    """Numbers rounded to the precision needed for plots and comparisons."""
    if isinstance(value, np.generic):
        value = value.item()
    return f"{value:.7g}" if isinstance(value, float) else value
