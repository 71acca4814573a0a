"""Foams that were not used for tuning: those of the continuum simulation, and their calibrations."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from visuohaptic.sensing.foam.material import FoamCalibration, StrainStress, calibrate_foam


@pytest.fixture(scope="session")
def continuum():
    """The finite-element instrument beside this file."""
    spec = importlib.util.spec_from_file_location("foam_continuum", Path(__file__).with_name("continuum.py"))
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def press_log(stress, *, runs=1, noise_Pa=0.0, rng=None, end=0.6, steps=61) -> StrainStress:
    """Loading points of a stress law, as a press would log them."""
    strain = np.tile(np.linspace(0, end, steps), runs)
    noise = rng.normal(0, noise_Pa, strain.size) if noise_Pa else 0.0
    return StrainStress(strain, stress(strain) + noise, np.ones(strain.size, dtype=np.int64))


@pytest.fixture(scope="session")
def reference_law(continuum):
    """Stress law with a stiff start, a plateau and a densification."""
    return continuum.Foam((33600, 150), (12, -2))


@pytest.fixture(scope="session")
def calibration(reference_law) -> FoamCalibration:
    return calibrate_foam(press_log(reference_law.stress), width_m=0.02, height_m=0.01)


@pytest.fixture(scope="session")
def material(calibration):
    return calibration.material


@pytest.fixture
def make_log():
    return press_log


@pytest.fixture(scope="session")
def grippers():
    """The module beside this file."""
    return _beside("grippers")


def _beside(name: str):
    spec = importlib.util.spec_from_file_location(f"foam_{name}", Path(__file__).with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def striped(grippers, tmp_path_factory):
    """A finger with a colour stripe under a rolling shutter: (maker, sensor)."""
    pytest.importorskip("sklearn")
    return grippers.build(tmp_path_factory.mktemp("striped"), stripe=True)


@pytest.fixture(scope="session")
def plain(grippers, tmp_path_factory):
    """The same without a stripe, in grey."""
    return grippers.build(tmp_path_factory.mktemp("plain"), stripe=False)
