"""The arguments of every long verb: how many processes of this machine, or which cluster."""

from __future__ import annotations

from typing import Any

from ..core import InputError, available_cores

#: More processes than any one machine has cores [1].
MAX_WORKERS = 1024


def add_worker_arguments(add: Any, default: str = "1") -> None:
    """``--workers N`` and ``--cluster ADDRESS``.

    Parameters
    ----------
    add
        Of the verb.
    default
        What is done without ``--workers``, for the help.
    """
    add("--workers", "--jobs", int, f"processes of this machine ({default})", metavar="N")
    add("--cluster", str, "dask scheduler, like tcp://10.0.0.1:8786", metavar="ADDRESS")


def chosen_workers(args: Any, default: int = 1) -> int | str:
    """Where :func:`.map_tasks` shall work: processes of this machine, or the address of a scheduler.

    Parameters
    ----------
    args
        As parsed.
    default
        Processes without ``--workers``; 0 for one on each core.

    Raises
    ------
    InputError
        A number that no machine has, or a cluster and processes of this machine.
    """
    if args.workers is not None and not 1 <= args.workers <= MAX_WORKERS:
        raise InputError("--workers", f"found {args.workers}, expected 1 to {MAX_WORKERS}")
    if args.workers is not None and args.cluster is not None:
        raise InputError("--workers", "found --cluster as well, expected one of them")
    return args.cluster or args.workers or default or available_cores()
