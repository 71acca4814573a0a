"""Context managers: resources held during a ``with`` block (device, file, thread), and BLAS limited to one thread.

Starting threads for a matrix of fifty rows costs more than the computation, up to a hundred times
on a busy machine. It is better to distribute objects and grasps over cores.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, Self

__all__ = ["Closing", "one_blas_thread"]


class Closing(ABC):
    """A resource closed at the end of its ``with`` block, also after an error, so that partial results are kept."""

    __slots__ = ()

    @abstractmethod
    def close(self) -> None:
        """Release the resource."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread inside the block; no effect without ``threadpoolctl``."""
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
