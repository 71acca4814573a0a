"""What is held for the time of a ``with`` block: a device, a file, a thread; and BLAS, to one thread.

Starting threads for a matrix of fifty rows costs more than the work in it, up to a hundred times
on a busy machine. Objects and grasps are the better thing to spread over cores.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, Self

__all__ = ["Closing", "one_blas_thread"]


class Closing(ABC):
    """Closed when its ``with`` block ends, after an error as well: what was done until then is worth as much."""

    __slots__ = ()

    @abstractmethod
    def close(self) -> None:
        """Give back what is held."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Hold BLAS to one thread inside the block; does nothing without ``threadpoolctl``."""
    controller = _controller()
    if controller is None:
        yield
        return
    with controller.limit(limits=1, user_api="blas"):
        yield


@cache
def _controller() -> Any:
    import scipy.linalg.blas  # noqa: F401 - its library has to be loaded to be found

    try:
        from threadpoolctl import ThreadpoolController
    except ImportError:
        return None
    return ThreadpoolController()
