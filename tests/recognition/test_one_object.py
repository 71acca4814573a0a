from __future__ import annotations

from pathlib import Path

import pytest

from visuohaptic.core import InputError
from visuohaptic.recognition.data import read_curves


def test_curves_of_several_objects_are_not_read_as_one(tmp_path: Path) -> None:
    """A training file: their curves at one place would look like one that opens on another path."""
    rows = [
        f"{label},8,x+,{k * d * 1e-3},{d * 1e-3}"
        for label, k in (("cup", 2e3), ("jar", 9e3))
        for d in (1, 2, 3)
    ]
    path = tmp_path / "own.csv"
    path.write_text("\n".join(["label,height,side,force_N,deformation_m", *rows]))
    with pytest.raises(InputError, match=r"found 2 objects .*, expected the curves of one"):
        read_curves(path)
