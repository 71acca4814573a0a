"""``visuohaptic example foam``: a recording to try the foam sensor on.

reads
  nothing
writes, into --out
  strain_stress.csv          stress-strain data of the foam, as a press records it
  camera.yaml, sensor.yaml   the camera, and the strip in front of it
  rest.mp4, push.mp4         the untouched strip; a cylinder pressed into it and withdrawn
  truth.csv                  t_s, force_N, depth_m of the simulated physics

example
  visuohaptic example foam --out try
  visuohaptic calibrate foam try/strain_stress.csv --width 0.02 --height 0.01 --out try/foam.yaml --plot try/foam.png
  visuohaptic sense foam --config try/sensor.yaml --source try/rest.mp4 --zero
  visuohaptic sense foam --config try/sensor.yaml --source try/push.mp4 --csv try/run.csv --out try/run.mcap
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .... import rigs

#: Modules with kernels of the verb, the last needed first.
KERNELS = ("simulation.rendering", "simulation.foam")
#: Optional modules that the verb imports.
NEEDS = ("av",)


def add_arguments(add: Any) -> None:
    """Arguments of the verb.

    Parameters
    ----------
    add
        Of the verb.
    """
    add("--out", Path, "folder to write to", required=True)
    add("--seed", 1, "seed of the noise (1)")


def written(args: Any, write: Callable[..., Path], verb: str) -> dict[str, Any]:
    """Write the recording; returns the mapping that ``--json`` prints.

    Parameters
    ----------
    args
        With ``out`` and ``seed``.
    write
        Called with the folder, the seed and a function that prints progress.
    verb
        Its words, such as ``example foam``.
    """
    return report_files(args, write(args.out, seed=args.seed, on_message=args.report), verb)


def report_files(args: Any, folder: Path, verb: str) -> dict[str, Any]:
    """Report what an example has written, and the commands that use it.

    Parameters
    ----------
    args
        Of the verb.
    folder
        Of the files.
    verb
        Its words, such as ``example foam``.
    """
    files = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    args.report(f"written to {folder}: {', '.join(files)}")
    report_next(args, folder, verb)
    return {"folder": str(folder), "files": files}


def report_next(args: Any, folder: Path, verb: str) -> None:
    """Print the commands of the verb's help that follow the first one, with the folder that was written.

    Parameters
    ----------
    args
        Of the verb.
    folder
        Of the files; the examples call it ``try``.
    verb
        Its words, such as ``example foam``.
    """
    text = sys.modules[f"{__package__}.{verb.replace(' ', '_')}"].__doc__ or ""
    commands = [line.strip() for line in text.splitlines() if line.startswith("  visuohaptic ")]
    args.report("next:")
    for command in commands[1:]:
        args.report(f"  {command.replace('try/', f'{folder.as_posix()}/')}")


def run(args: Any) -> dict[str, Any]:
    """Run the verb; returns the mapping that ``--json`` prints."""
    return written(args, rigs.write_example, "example foam")
