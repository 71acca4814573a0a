"""CPU time of a rendered frame, as a ratio to a warped, blurred, noisy image in plain OpenCV.

python -m benchmarks.renderer    prints the CPU time of each case, and its ratio to OpenCV
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from visuohaptic.core.camera import Camera, Pose
from visuohaptic.simulation.rendering import CameraEffects, FoamScene, Look, SceneObject, SceneRenderer

FRAMES = 15


def pressed(t_s: float, objects: int = 3) -> FoamScene:
    """A bent strip pressed against a box, a cylinder and a table leg while the robot drives."""
    y = np.linspace(-0.125, 0.125, 171)
    back = np.column_stack([-(y**2), y])
    front = back + np.array([0.02, 0.0])
    depth = 0.004 + 0.02 * t_s
    front[:, 0] = np.minimum(front[:, 0], 0.02 - depth + 0.01 * np.maximum(0, np.abs(y - 0.055) / 0.035 - 1))
    box = np.array([[0, 0.02], [0.1, 0.02], [0.1, 0.09], [0, 0.09]]) + np.array([0.02 - depth, 0])
    angle = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    cylinder = 0.025 * np.column_stack([np.cos(angle), np.sin(angle)]) + [0.05, -0.05]
    leg = np.array([[0.05, -0.14], [0.09, -0.14], [0.09, -0.10], [0.05, -0.10]])
    every = (
        SceneObject(box, 0.07, 150.0, 9.0, 1, "cardboard", (95, 140, 170)),
        SceneObject(cylinder, 0.11, 90.0, 5.0, 2, "metal", (150, 110, 60)),
        SceneObject(leg, 0.5, 110.0, 14.0, 3, "wood", (60, 100, 140)),
    )
    driven = Pose.from_rotation_vector([0, 0, 0.1], [0.3 * t_s, 0.0, 0.05])
    return FoamScene(t_s, back, front, every[:objects], T_world_foam=driven)


def median_ms(frame: Callable[[int], object]) -> tuple[float, float]:
    """CPU time of the first call, and the best median of three rounds [ms]."""
    begin = time.process_time()
    frame(0)
    first = time.process_time() - begin
    medians = []
    for _ in range(3):
        times = []
        for i in range(FRAMES):
            begin = time.process_time()
            frame(i + 1)
            times.append(time.process_time() - begin)
        medians.append(np.median(times))
    return 1e3 * first, 1e3 * float(min(medians))


def main() -> None:
    """Print the table."""
    import cv2

    cv2.setNumThreads(1)
    rng = np.random.default_rng(0)
    camera = Camera.simple(1600, 896, 1800.0)
    lens = replace(camera, distortion=np.array([-0.08, 0.02, 0.0, 0.0, 0.0]))
    rolling = replace(lens, row_delay_s=3e-5)
    pose = camera.pose_of_view((-0.11, 0.0, 0.30), (0.03, 0.0, 0.0)).inverse()
    effects = CameraEffects(noise_sigma=2.0, vignetting=0.2)

    picture = rng.integers(0, 255, (896, 1600), dtype=np.uint8)
    noise = np.zeros(picture.shape, np.float32)
    warp = np.array([[1.0, 0.02, 3.0], [0.01, 1.0, 2.0], [1e-5, 1e-5, 1.0]])

    def peer(_: int) -> object:
        warped = cv2.warpPerspective(picture, warp, (1600, 896)).astype(np.float32)
        cv2.randn(noise, 0, 2)
        return np.clip(cv2.GaussianBlur(warped, (0, 0), 0.8) + noise, 0, 255).astype(np.uint8)

    first, peer_ms = median_ms(peer)
    print(f"{'case (1600 x 896, CPU time)':44s} {'first ms':>9s} {'ms':>7s} {'ratio':>6s}")
    print(f"{'cv2 warp + GaussianBlur + randn (peer)':44s} {first:9.1f} {peer_ms:7.1f} {1.0:6.2f}")
    cases = [
        ("no object, flat, grey", camera, Look(), 0),
        ("box, flat, grey", camera, Look(), 1),
        ("box, photo, grey", camera, Look.photo(), 1),
        ("box, cylinder, leg, photo, grey", camera, Look.photo(), 3),
        ("the same with lens distortion", lens, Look.photo(), 3),
        ("the same in colour with stripe", lens, Look.photo(colour=True, stripe=True), 3),
    ]
    for name, model, look, count in cases:
        renderer = SceneRenderer(model, pose, look, effects)
        first, ms = median_ms(lambda i, r=renderer, n=count: r.render(pressed(0.01 * i, n), rng=rng))
        print(f"{name:44s} {first:9.1f} {ms:7.1f} {ms / peer_ms:6.2f}")
    renderer = SceneRenderer(rolling, pose, Look.photo(), effects)
    first, ms = median_ms(lambda i: renderer.render(pressed, rng=rng, t_s=0.01 * i))
    print(f"{'three objects, distortion, rolling shutter':44s} {first:9.1f} {ms:7.1f} {ms / peer_ms:6.2f}")


if __name__ == "__main__":
    main()
