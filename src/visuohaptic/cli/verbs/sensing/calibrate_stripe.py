"""``visuohaptic calibrate stripe``: learn the colours of a stripe on the foam.

reads
  IMAGE      a colour image of the untouched sensor (or the first frame of a video, a folder or recording.mcap)
  --config   sensor.yaml with a section stripe; a finger is located by its tag
writes
  --out      stripe.npz, to be named in sensor.yaml as stripe.model
  --mask     the image with the stripe's pixels white and the other training pixels darkened

example
  visuohaptic calibrate stripe rest.png --config sensor.yaml --out stripe.npz --mask mask.png
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .... import core, io
from ....core import files
from ....core.errors import InputError
from ....sensing import foam

#: Optional modules that the verb imports.
NEEDS = ("sklearn",)


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("image", str, "colour image of the untouched sensor", metavar="IMAGE")
    add("--config", Path, "sensor.yaml", required=True)
    add("--out", Path, "NPZ file to write", required=True)
    add("--mask", Path, "draw which pixels were used", metavar="PNG")
    add("--seed", 0, "choice of pixels and start of the fit (0)")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Learn, write, and return what was found."""
    import numpy as np

    setup = foam.FoamSensorConfig.load(args.config)
    frame = _read(args.image, setup.camera)
    if frame.image.ndim != 3:
        raise InputError(args.image, "is grey, expected a colour image")
    plane = core.PlaneView(setup.camera, foam.finger_pose(setup, frame))
    model = foam.train_stripe(setup, frame.image, plane, rng=np.random.default_rng(args.seed))
    model.save(args.out)
    stripe, rest = foam.stripe_masks(setup, plane)
    if args.mask is not None:
        _draw(args.mask, frame, stripe, rest)
    seen = float(model.likelihood(frame.image[stripe]).mean())
    return {
        "out": str(args.out),
        "stripe_pixels": int(stripe.sum()),
        "rest_pixels": int(rest.sum()),
        "mean_probability_on_stripe": seen,
        "mean_probability_elsewhere": float(model.likelihood(frame.image[rest]).mean()),
    }


def _draw(path: Path, frame: core.Frame, stripe: Any, rest: Any) -> None:
    picture = frame.image.copy()
    picture[rest] //= 2
    picture[stripe] = 255
    files.write_image(path, picture)


def _read(source: str, camera: Any) -> core.Frame:
    if Path(source).suffix.lower() in {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"}:
        return core.Frame(files.read_image(source, "colour"), 0.0, 0)
    with io.open_source(source, camera=camera) as frames:
        for frame in frames:
            return frame
    raise InputError(source, "has no frames")
