"""Classifiers for tests that show something else than how well probabilities are calibrated."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def explored_less() -> Iterator[None]:
    """Probabilities are calibrated on a tenth of the explorations: how well is tested with all of them, in recognition."""
    from visuohaptic.recognition.touch import calibrate

    with pytest.MonkeyPatch.context() as patch:
        given = inspect.unwrap(calibrate).__kwdefaults__
        patch.setitem(given, "explorations", given["explorations"] // 10)
        yield
