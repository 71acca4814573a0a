"""The command that looks into recordings, lazy imports, and hostile files as a whole."""

from __future__ import annotations

import argparse
import contextlib
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import visuohaptic.io
from visuohaptic.cli._arguments import Add
from visuohaptic.cli.verbs.geometry import recording_info
from visuohaptic.core import InputError
from visuohaptic.io.frames import open_source
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.io.sinks import MeasurementWriter

from .helpers import picture, profile, write_video


def info(*words: str) -> dict[str, Any]:
    parser = argparse.ArgumentParser()
    recording_info.add_arguments(Add(parser))
    return recording_info.run(parser.parse_args([*words]))


def test_info_of_every_kind(tmp_path: Path) -> None:
    write_video(tmp_path / "v.mkv", [40 * n for n in range(10) if n != 4])
    video = info(str(tmp_path / "v.mkv"))
    assert (video["frames"], video["missing"], video["width"]) == (9, 1, 64)
    assert video["duration_s"] == pytest.approx(0.36)
    with MeasurementWriter(tmp_path / "a.mcap") as writer:
        writer.write_force(profile(1.0))
        writer.write_force(profile(3.0))
    mcap = info(str(tmp_path / "a.mcap"))
    assert (mcap["duration_s"], mcap["messages"], mcap["damage"]) == (2.0, 8, "none")
    assert mcap["topics"][-1]["type"] == "geometry_msgs/msg/WrenchStamped"
    folder = tmp_path / "photos"
    folder.mkdir()
    cv2.imwrite(str(folder / "a.png"), picture(0, colour=False))
    assert info(str(folder), "--rate-Hz", "5")["colour"] is False
    OccupancyMap(np.zeros((3, 4), np.int8), 0.5).save(tmp_path / "m.yaml")
    assert info(str(tmp_path / "m.yaml"))["free"] == 12


def test_heavy_libraries_are_not_imported_with_the_package() -> None:
    code = (
        "import sys, visuohaptic.io, visuohaptic.core.camera.calibration\n"
        "import visuohaptic.cli.verbs.geometry.recording_info, visuohaptic.cli.verbs.sensing.calibrate_camera\n"
        "heavy = {'cv2', 'av', 'mcap', 'mcap_ros2', 'pyarrow', 'yaml', 'pydantic', 'scipy'}\n"
        "print(sorted(heavy & set(sys.modules)))\n"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_public_names_exist() -> None:
    for name in visuohaptic.io.__all__:
        assert getattr(visuohaptic.io, name).__doc__


@pytest.mark.parametrize("name", ["v.mkv", "v.mp4", "a.png", "a.jpg", "a.tiff", "m.yaml"])
def test_spoilt_files_give_frames_or_an_input_error(tmp_path: Path, name: str) -> None:
    """Random bytes in a good file: a result or an InputError, never anything else."""
    path = tmp_path / name
    if name.startswith("v"):
        codec = {"v.mkv": ("ffv1", "bgr0"), "v.mp4": ("libx264", "yuv420p")}[name]
        write_video(path, [40 * n for n in range(8)], codec=codec[0], form=codec[1])
    elif name.startswith("a"):
        cv2.imwrite(str(path), picture(1))
    else:
        OccupancyMap(np.zeros((30, 40), np.int8), 0.5).save(path)
    good = path.read_bytes()
    rng = np.random.default_rng(3)
    for _ in range(25):
        spoilt = bytearray(good)
        for place in rng.integers(0, min(len(good), 4000), 6):
            spoilt[place] = rng.integers(0, 256)
        path.write_bytes(spoilt[: rng.integers(1, len(good) + 1)] if rng.random() < 0.3 else spoilt)
        with contextlib.suppress(InputError):
            if name == "m.yaml":
                OccupancyMap.load(path)
            else:
                with open_source(tmp_path if name.startswith("a") else path, rate_Hz=10.0) as source:
                    list(source)
