"""Faults: no effect when off, the documented effect when on, reproducible by seed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from visuohaptic.core import FrameSource, InputError
from visuohaptic.core.camera import Frame
from visuohaptic.simulation import (
    FaultKind,
    FaultyFrames,
    FrameFaults,
    frame_faults,
    wrong_map,
)


class Frames:
    """Ten a second, each with its number as grey."""

    camera = None
    frame_count = None

    def __init__(self, count: int = 200) -> None:
        self.count = count

    def __iter__(self) -> Iterator[Frame]:
        for k in range(self.count):
            yield Frame(np.full((20, 30), k % 200, np.uint8), 0.1 * k, k)

    def close(self) -> None: ...
    def __enter__(self) -> Frames:
        return self

    def __exit__(self, *_: Any) -> None: ...


def through(faults: FrameFaults, seed: int = 0, count: int = 200) -> list[Frame]:
    source = FaultyFrames(Frames(count), faults, np.random.default_rng(seed))
    assert isinstance(source, FrameSource)
    with source:
        return list(source)


def test_off_nothing_changes() -> None:
    frames = through(FrameFaults())
    assert [f.index for f in frames] == list(range(200))
    assert all((f.image == f.index % 200).all() for f in frames)


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.floats(0, 1), st.floats(0, 1), st.floats(0, 1), st.integers(1, 9), st.integers(0, 99))
def test_nothing_is_invented_and_seeds_repeat(
    drop: float, duplicate: float, late: float, late_frames: int, seed: int
) -> None:
    faults = FrameFaults(drop, duplicate, late, late_frames)
    frames = through(faults, seed, 60)
    assert [f.index for f in frames] == [f.index for f in through(faults, seed, 60)]
    counts = np.bincount([f.index for f in frames], minlength=60)
    assert len(counts) == 60
    assert counts.max(initial=0) <= 2
    # No frame overtakes by more than what is late.
    seen = -1
    for frame in frames:
        assert frame.index >= seen - late_frames - 1
        seen = max(seen, frame.index)


def test_shares_are_kept() -> None:
    """200 frames, share 0.2: within four standard deviations, 4 x sqrt(200 x 0.2 x 0.8) = 23."""
    assert abs(len(through(frame_faults(FaultKind.DROPPED_FRAMES))) - 160) < 23
    assert abs(len(through(frame_faults(FaultKind.DUPLICATE_FRAMES))) - 240) < 23
    order = [f.index for f in through(frame_faults(FaultKind.LATE_FRAMES))]
    assert sorted(order) == list(range(200))
    assert order != sorted(order)


def test_light_bump_and_cable() -> None:
    frames = through(frame_faults(FaultKind.LIGHTING, at_s=5.0))
    assert (frames[49].image == 49).all()
    assert (frames[100].image == round(0.45 * 100 + 5)).all()
    assert len(through(FrameFaults(end_at_s=2.0))) == 20
    picture = np.zeros((40, 60), np.uint8)
    picture[20, 30] = 255
    source: Any = [Frame(picture, 0.0, 0), Frame(picture, 1.0, 1)]
    moved = list(
        FaultyFrames(
            source, FrameFaults(bump_at_s=0.5, bump_px=(5.0, 0.0), bump_rad=0.0), np.random.default_rng(0)
        )
    )
    assert np.argwhere(moved[0].image == 255).tolist() == [[20, 30]]
    assert np.argwhere(moved[1].image == 255).tolist() == [[20, 35]]


def test_wrong_maps() -> None:
    cells = np.zeros((60, 80), np.int8)
    cells[20:40, 30:50] = 100
    wrong = wrong_map(cells, np.random.default_rng(1))
    assert wrong.shape == cells.shape
    assert set(np.unique(wrong)) <= {-1, 0, 100}
    assert (wrong != cells).mean() > 0.02
    assert np.array_equal(wrong, wrong_map(cells, np.random.default_rng(1)))
    assert np.array_equal(wrong_map(cells, np.random.default_rng(1), shift_cells=0, blocks=0), cells)
    with pytest.raises(InputError, match="expected rows x columns"):
        wrong_map(np.zeros((0, 3), np.int8), np.random.default_rng(0))


def test_bad_shares_are_refused() -> None:
    with pytest.raises(InputError, match=r"drop: found 1.5, expected 0 to 1"):
        FrameFaults(drop=1.5)
    assert frame_faults(FaultKind.SLIP) == FrameFaults()
    assert math.isinf(frame_faults(FaultKind.WRONG_MAP).end_at_s)
