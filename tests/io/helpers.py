"""Recordings made without our own writers."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np

from visuohaptic.core import Contact, ErrorBudget, ForceProfile, Reason


def picture(number: int, *, size: tuple[int, int] = (64, 48), colour: bool = True) -> np.ndarray:
    """A picture with a pattern of its own; its number can be read from its mean."""
    y, x = np.mgrid[: size[1], : size[0]]
    grey = (20 + 8 * number + (x // 16 + y // 16) % 2 * 10).astype(np.uint8)
    return np.dstack([grey, grey // 2, 255 - grey]) if colour else grey


def write_video(
    path: Path, stamps: list[int], *, codec: str = "ffv1", form: str = "bgr0", rate: int = 1000
) -> None:
    """A video whose frames have the given stamps [1 / rate s]; FFV1 keeps every pixel."""
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate)
        stream.width, stream.height, stream.pix_fmt = 64, 48, form
        stream.codec_context.time_base = Fraction(1, rate)
        for number, stamp in enumerate(stamps):
            frame = av.VideoFrame.from_ndarray(picture(number), format="bgr24").reformat(format=form)
            frame.pts, frame.time_base = stamp, Fraction(1, rate)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def profile(t_s: float = 1.5, *, valid: bool = True, force_N: float = 2.25) -> ForceProfile:
    """A force profile with one contact of five points."""
    s = np.linspace(-0.05, 0.05, 21)
    delta = np.clip(0.004 - 40 * s**2, 0.0, None)
    inside = delta > 0
    budget = ErrorBudget(0.001, 0.02, 0.03, 0.004)
    reason = Reason.OK if valid else Reason.OCCLUDED
    points = np.column_stack([0.02 - delta[inside], s[inside]])
    contact = Contact(
        float(s[inside][0]),
        float(s[inside][-1]),
        force_N,
        budget,
        valid,
        reason,
        points,
        np.full(inside.sum(), 1e-5),
        delta[inside],
    )
    return ForceProfile(
        t_s,
        valid,
        reason,
        force_N,
        budget,
        s,
        delta,
        np.full(21, 1e-5),
        1e4 * delta / 0.02,
        np.full(21, 30.0),
        np.ones(21, dtype=bool),
        (contact,),
    )
