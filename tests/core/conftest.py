from __future__ import annotations

import pytest

from .kernel_pack import PACK, write_module


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty cache of this test."""
    monkeypatch.setenv("VISUOHAPTIC_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def pack(tmp_path, folder):
    """A package of three modules, one below the other."""
    for name, text in PACK.items():
        write_module(tmp_path, name, text)
    return tmp_path
