"""The arguments of every long verb: how many processes of this machine, or which cluster."""

from __future__ import annotations

from typing import Any

from ..core import available_cores

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
    where = add.one_of()
    said = f"processes of this machine ({default})"
    where("--workers", "--jobs", int, said, metavar="N", low=1, high=MAX_WORKERS)
    where("--cluster", str, "dask scheduler, like tcp://10.0.0.1:8786", metavar="ADDRESS")


def chosen_workers(args: Any, default: int = 1) -> int | str:
    """Where :func:`.map_tasks` shall work: processes of this machine, or the address of a scheduler.

    Parameters
    ----------
    args
        As parsed.
    default
        Processes without ``--workers``; 0 for one on each core.
    """
    return args.cluster or args.workers or default or available_cores()
