"""The code metrics of ``benchmarks.house``, on a package with one fault of each kind."""

from __future__ import annotations

import sys

import pytest

from benchmarks import house

LONG = "\n".join(["def long():", "    x = 0", *["    x += 1"] * 70, "    return x", ""])

CUP = '''"""A cup."""

__all__ = ["Cup", "fill"]

from .table import Table

SIZE_m = 0.1


class Cup:
    """A cup."""

    table: Table

    def lift(self, height_m):
        """Lift it.

        Parameters
        ----------
        height_m
            How far.
        """


def fill(cup, share):
    """Fill it.

    Parameters
    ----------
    cup
        Which one.
    """
'''

TABLE = '''__all__ = ["Cup", "Table"]


class Cup:
    """A cup on a table."""


class Table:
    """Imports a cup inside a function."""

    def cup(self):
        """Give it.

        Parameters are none.
        """
        from .cup import Cup

        return Cup()
'''


@pytest.fixture
def source(tmp_path):
    """A package in which every figure finds one thing."""
    files = {
        "__init__.py": "",
        "cup.py": CUP,
        "table.py": TABLE,
        "long.py": LONG,
        "wide_kernels.py": "def wide(a, b, c, d, e, f, g, h, i):\n    return a\n",
        "cli/__init__.py": "",
        "cli/main.py": "from ..cup import fill\n\n\ndef main():\n    fill(None, 1.0)\n",
        "clients.py": "def unreached():\n    return 1\n",
    }
    for name, text in files.items():
        path = tmp_path / "src" / "tiny" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "src"


def test_every_figure_finds_its_fault(source):
    found = house.measure(source)
    assert found["circles of imports"] == ["tiny.cup <-> tiny.table"]
    assert found["functions over 60 lines or 8 arguments"] == ["tiny.long:long 73 lines, 0 arguments"]
    assert found["public class names that occur twice"] == ["Cup tiny.cup tiny.table"]
    assert found["public functions, parameters not"] == ["tiny.cup:fill"]
    documented = ["cli.main:main", "clients:unreached", "cup:Cup.lift", "long:long", "table:Table.cup"]
    assert found["public functions, parameters documented"] == [f"tiny.{name}" for name in documented]
    assert found["module constants with a number"] == ["tiny.cup:SIZE_m"]
    unreached = next(places for title, places in found.items() if title.startswith("lines not reached"))
    assert unreached == ["tiny.clients 2", "tiny.long 73", "tiny.wide_kernels 2"]


def test_figures_are_counts_sums_of_lines_and_a_percentage(source):
    values = house.figures(house.measure(source))
    assert values["circles of imports"] == 1
    assert values["files over 400 lines"] == 0
    assert values["lines of code"] == sum(
        house.code_lines(module) for module in house.read_modules(source).values()
    )
    assert values["public functions with all parameters documented, %"] == pytest.approx(500 / 6, abs=0.1)


def test_dead_code_is_what_neither_source_nor_tests_use(source):
    pytest.importorskip("vulture")
    (source.parent / "tests").mkdir()
    (source.parent / "tests" / "test_tiny.py").write_text("from tiny.long import long\n\nlong()\n")
    dead = house.dead_code(source)
    assert "tiny/clients.py:1 unused function 'unreached'" in dead
    assert not any("'long'" in place for place in dead)


def test_without_vulture_the_table_says_so(source, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "vulture", None)
    monkeypatch.setattr(house, "measure", lambda measure=house.measure: measure(source))
    monkeypatch.setattr("sys.argv", ["house"])
    house.main()
    assert "vulture is not installed" in capsys.readouterr().out


def test_this_library_keeps_the_limits():
    pytest.importorskip("vulture")
    found = house.measure(house.ROOT / "src")
    kept = (
        "folders with more than 14 modules",
        "files over 400 lines",
        "functions over 60 lines or 8 arguments",
        "public class names that occur twice",
        "public functions, parameters not",
        "circles of imports",
        "dead code (functions, classes, imports) by vulture",
    )
    assert {title: found[title] for title in kept} == {title: [] for title in kept}
