"""What the verbs share that write a small recording."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

__all__ = ["NEEDS", "add_arguments", "written"]

#: Modules beyond the core on their way.
NEEDS = ("av",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of these verbs.

    Parameters
    ----------
    parser
        Of the verb.
    """
    parser.add_argument("--out", type=Path, required=True, help="folder")
    parser.add_argument("--seed", type=int, default=1, help="of the noise (1)")


def written(args: Any, write: Callable[..., Path], verb: str) -> dict[str, Any]:
    """Write the recording; the mapping is what ``--json`` prints.

    Parameters
    ----------
    args
        With ``out`` and ``seed``.
    write
        Called with the folder, the seed and where to report.
    verb
        Its words.
    """
    folder = write(args.out, seed=args.seed, say=args.report)
    files = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    args.report(f"written to {folder}: {', '.join(files)}")
    args.report(f"next: visuohaptic {verb} --help shows what to do with them")
    return {"folder": str(folder), "files": files}
