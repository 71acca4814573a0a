"""CPU time from a JPEG in memory to the force with its uncertainty, and the part of it that is decoding.

python -m benchmarks foam_pipeline
"""

from __future__ import annotations

import itertools
import tempfile

import numpy as np

from visuohaptic.core.camera import Frame
from visuohaptic.rigs import VirtualSensor
from visuohaptic.simulation.foam import PressShape, press

from .harness import cpu_seconds


def run() -> list[dict]:
    """CPU time on one core at 1600 x 896, both contours, 83 points; the peer tracks one contour."""
    import cv2
    from skimage.filters import gaussian
    from skimage.segmentation import active_contour

    virtual = VirtualSensor()
    rng = np.random.default_rng(7)
    with tempfile.TemporaryDirectory() as folder:
        sensor = virtual.build(folder, rng)
    renderer = virtual.renderer()
    samples = list(
        press(PressShape.CYLINDER_12CM, np.linspace(0.0, 0.005, 13)[1:], geometry=virtual.geometry)
    )
    images = [renderer.render(sample.scene, rng=rng) for sample in samples]
    files = [cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])[1] for image in images]
    # More images than the sensor remembers: it would report a repeated one as a frozen camera.
    turns = itertools.count()

    def decoded() -> np.ndarray:
        image = cv2.imdecode(files[next(turns) % len(files)], cv2.IMREAD_GRAYSCALE)
        assert image is not None
        return image

    def chain() -> None:
        index = next(turns)
        sensor.read(Frame(cv2.imdecode(files[index % len(files)], cv2.IMREAD_GRAYSCALE), index / 30, index))

    def sensing() -> None:
        index = next(turns)
        sensor.read(Frame(images[index % len(images)], index / 30, index))

    sensing()
    assert sensor.strip is not None
    front = sensor.strip.front_points_px[:, ::-1]
    top = max(0, int(front[:, 0].min()) - 100)

    def snake() -> None:
        region = gaussian(decoded()[top : top + 240], 1.0, preserve_range=True)
        active_contour(region, front - [top, 0], boundary_condition="fixed", max_num_iter=500)

    whole = cpu_seconds(chain)
    peer = cpu_seconds(snake, repeats=3)
    return [
        {
            "name": "JPEG to force",
            "ours": 1e3 * whole,
            "unit": "ms",
            "peer": 1e3 * peer,
            "peer_name": "JPEG decoding and skimage active_contour of one contour, warm, 1600 x 240",
            "floor": 10.0,
            "aim": 6.0,
            "note": f"decoding alone {1e3 * cpu_seconds(decoded):.2f} ms, file of {len(files[0]) / 1e3:.0f} kB",
        },
        {
            "name": "image to force",
            "ours": 1e3 * cpu_seconds(sensing),
            "unit": "ms",
            "note": "tracking of both contours, appearance, casting, pressure, uncertainty, judgement",
        },
    ]
