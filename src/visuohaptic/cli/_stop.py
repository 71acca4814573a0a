"""Ctrl-C and SIGTERM as the end of what runs, instead of the end of the process."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def signals(stop: Callable[[], None]) -> Iterator[None]:
    """Call a function where Ctrl-C or SIGTERM comes, in the main thread; in another one nothing is changed.

    Parameters
    ----------
    stop
        Safe in a signal handler.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda *_: stop()) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
