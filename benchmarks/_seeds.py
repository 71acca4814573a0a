"""Seeds of a campaign: even seeds are open and used for tuning, odd seeds are closed until the final figures are reported."""

from __future__ import annotations

import argparse
from pathlib import Path

__all__ = ["add_seeds", "seeds_of"]


def seeds_of(kind: str, count: int, first: int = 0) -> list[int]:
    """``count`` seeds that are ``open`` (even) or ``closed`` (odd), from the one numbered ``first`` among them."""
    return [2 * index + (kind == "closed") for index in range(first, first + count)]


def add_seeds(
    parser: argparse.ArgumentParser, count: int, what: str = "seeds", *, resumes: bool = False
) -> None:
    """``--seeds``, ``--first`` and ``--count``; ``--report`` of a campaign that resumes."""
    parser.add_argument("--seeds", choices=("open", "closed"), default="open", help="even or odd")
    parser.add_argument("--first", type=int, default=0, help="number of the first one among these (0)")
    parser.add_argument("--count", type=int, default=count, help=f"number of {what} ({count})")
    if resumes:
        parser.add_argument(
            "--report", type=Path, help="JSON lines with all rows; an interrupted campaign is continued"
        )
