from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.recognition.data import FeatureSet, load_feature_set, read_build, save_feature_set
from visuohaptic.recognition.touch import fit_model

from .worlds import build_folder, synthetic


def test_a_build_folder_and_a_file_hold_the_same(tmp_path: Path) -> None:
    data = synthetic(3)
    read = read_build(build_folder(tmp_path / "objects", data, height_m=0.12))
    np.testing.assert_allclose(read.height_m, 0.12)
    save_feature_set(tmp_path / "set.npz", read)
    again = load_feature_set(tmp_path / "set.npz")
    for found in (read, again):
        assert found.label == data.label
        assert found.name == data.name
        np.testing.assert_allclose(found.features, data.features)
        np.testing.assert_allclose(found.width_m, data.width_m)


def test_candidates_may_be_grouped() -> None:
    data = synthetic(4)
    found = data.of_classes(["cup", "flat"], {"cup": ["soft", "rim"]})
    assert found.classes == ("cup", "flat")
    assert found.label.count("cup") == 8
    with pytest.raises(InputError, match=r"found 'mug', expected one of flat, rim, soft"):
        data.of_classes(["mug", "flat"])
    with pytest.raises(InputError, match="at least 2"):
        data.of_classes(["flat"])


def test_measured_arrays_of_another_unit_or_number_are_refused() -> None:
    stiffness, width_m = np.full((2, 16, 4), 5e3), np.full((2, 16, 2), 0.06)
    objects = FeatureSet.of_stiffness(stiffness, width_m, [0, 1])
    assert objects.label == objects.classes == ("0", "1")
    with pytest.raises(InputError, match=r"width_m.*found a width of 60, expected metres, up to 3; divide"):
        FeatureSet.of_stiffness(stiffness, 1e3 * width_m, ["cup", "jar"])
    with pytest.raises(InputError, match=r"label.*found 1 labels of 2 objects, expected one for each"):
        FeatureSet.of_stiffness(stiffness, width_m, ["cup"])


def test_what_is_broken_is_said(tmp_path: Path) -> None:
    folder = build_folder(tmp_path / "objects", synthetic(2))
    with pytest.raises(InputError, match="no features of the state closed=True"):
        read_build(folder, closed=True)
    (folder / "soft" / "soft-00001.npz").write_bytes(b"PK\x03\x04 not really")
    with pytest.raises(InputError, match="is not a result of objects build"):
        read_build(folder)
    with pytest.raises(InputError, match="run visuohaptic objects build first"):
        read_build(tmp_path)
    (tmp_path / "manifest.json").write_text('{"objects": [{"file": "../secret", "class": "x"}]}')
    with pytest.raises(InputError, match="inside the folder"):
        read_build(tmp_path)
    (tmp_path / "bad.npz").write_bytes(b"\0" * 100)
    with pytest.raises(InputError, match="is not a feature set"):
        load_feature_set(tmp_path / "bad.npz")
    data = synthetic(2)
    with pytest.raises(InputError, match="all different"):
        FeatureSet(data.features, data.width_m, data.label, (data.name[0],) * len(data))


@pytest.mark.parametrize("shape", [(6, 2, 16), (6, 2, 16, 3), (5, 2, 16, 4), (6, 0, 16, 4)])
def test_errors_of_the_pose_have_a_change_for_each_side(shape: tuple[int, ...]) -> None:
    data = synthetic(2)
    assert len(data) == 6
    assert replace(data, pose_errors=np.zeros((6, 2, 16, 4))).pose_errors is not None
    with pytest.raises(InputError, match=r"expected \(6, [12], 16, 4\)"):
        replace(data, pose_errors=np.zeros(shape))


@pytest.mark.parametrize("field", ["features", "width_m", "height_m"])
def test_a_file_with_no_stiffness_width_or_height_is_refused(tmp_path: Path, field: str) -> None:
    read = read_build(build_folder(tmp_path / "objects", synthetic(2), height_m=0.12))
    values = getattr(read, field).copy()
    values.flat[0] = 0.0
    save_feature_set(tmp_path / "set.npz", replace(read, **{field: values}))
    with pytest.raises(InputError, match="not positive"):
        load_feature_set(tmp_path / "set.npz")


def test_a_file_in_millimetres_is_refused_with_the_remedy(tmp_path: Path) -> None:
    save_feature_set(tmp_path / "set.npz", synthetic(2))
    with np.load(tmp_path / "set.npz") as kept:
        arrays = dict(kept)
    np.savez(tmp_path / "set.npz", **arrays | {"width_m": 1e3 * arrays["width_m"]})
    with pytest.raises(InputError, match="divide millimetres by 1000"):
        load_feature_set(tmp_path / "set.npz")


@pytest.mark.parametrize("width_m", [0.0, -0.06, np.nan])
def test_a_model_of_objects_without_a_width_is_refused(width_m: float) -> None:
    """Their logarithms would make it NaN."""
    data = synthetic(3)
    data.width_m[0, 0, 0] = width_m
    with pytest.raises(InputError, match="width_m: found a size that is not finite and above 0"):
        fit_model(data)
