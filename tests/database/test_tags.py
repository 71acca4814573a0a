"""Tags of two trips are merged into the estimate from all samples."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import Estimate, HapticTag, Primitive, PrimitiveKind
from visuohaptic.database import merge_tags

QUANTITIES = (
    "static_friction_N",
    "dynamic_friction_N",
    "deceleration_s",
    "drift",
    "deformability",
    "stiffness_N_per_m",
    "rotation_rad_per_m",
    "contact_offset_m",
)


def of_samples(samples: np.ndarray, sigma: float) -> Estimate:
    """Mean and scatter, with the error of a mean of independent samples."""
    n = len(samples)
    spread = float(np.std(samples, ddof=1)) if n > 1 else 0.0
    return Estimate(float(np.mean(samples)), sigma / np.sqrt(n), spread, n)


@pytest.mark.parametrize("sizes", [(1, 1), (1, 5), (3, 4), (7, 2)])
def test_every_quantity_is_that_of_all_samples(sizes: tuple[int, int]) -> None:
    rng = np.random.default_rng(sum(sizes))
    samples = {name: rng.normal(3.0, 1.0, sum(sizes)) for name in QUANTITIES}
    parts = (slice(0, sizes[0]), slice(sizes[0], None))
    tags = [
        HapticTag(**{name: of_samples(values[part], 0.3) for name, values in samples.items()})
        for part in parts
    ]
    for merged in (merge_tags(*tags), merge_tags(*reversed(tags))):
        for name, values in samples.items():
            found, truth = getattr(merged, name), of_samples(values, 0.3)
            assert found.samples == truth.samples, name
            assert [found.value, found.sigma, found.spread] == pytest.approx(
                [truth.value, truth.sigma, truth.spread], rel=1e-9
            ), name


def test_what_only_one_knows_is_kept() -> None:
    known = HapticTag(drift=Estimate(1.0, 0.1), explored=2, failed=1)
    for merged in (
        merge_tags(known, HapticTag(explored=3, failed=2)),
        merge_tags(HapticTag(explored=3, failed=2), known),
    ):
        assert merged.drift == known.drift
        assert merged.static_friction_N is None
        assert (merged.explored, merged.failed) == (5, 3)


@pytest.mark.parametrize(
    ("first", "second", "fixed", "falls"),
    [
        (None, None, None, None),
        (True, None, True, True),
        (None, False, False, False),
        (True, True, True, True),
        (True, False, False, True),
        (False, False, False, False),
    ],
)
def test_what_moved_once_is_not_fixed_and_what_fell_once_may_fall(
    first: bool | None, second: bool | None, fixed: bool | None, falls: bool | None
) -> None:
    one, other = (
        HapticTag(fixed=known, falls=known, min_static_friction_N=bound)
        for known, bound in ((first, 9.0), (second, 20.0))
    )
    for merged in (merge_tags(one, other), merge_tags(other, one)):
        assert (merged.fixed, merged.falls) == (fixed, falls)
        # What has moved after all takes the bound back.
        assert merged.min_static_friction_N == (None if fixed is False else 20.0)


def test_the_shape_is_that_of_the_better_fit() -> None:
    def tag(score: float, depth_m: float) -> HapticTag:
        shape = Primitive(PrimitiveKind.LINE, np.zeros(3), np.eye(3), score)
        return HapticTag(primitive=shape, deformation_shape_m=np.array([[0.0, depth_m], [0.1, depth_m]]))

    good, bad, none = tag(0.9, 0.001), tag(0.4, 0.002), HapticTag()
    for first, second in ((good, bad), (bad, good), (good, none), (none, good)):
        merged = merge_tags(first, second)
        assert merged.primitive is good.primitive
        assert merged.deformation_shape_m is good.deformation_shape_m
    assert merge_tags(none, none).primitive is None
    # A better fit without a measured depth does not take away the other's.
    bare = HapticTag(primitive=Primitive(PrimitiveKind.LINE, np.zeros(3), np.eye(3), 0.95))
    for merged in (merge_tags(bare, bad), merge_tags(bad, bare)):
        assert merged.primitive is bare.primitive
        assert merged.deformation_shape_m is bad.deformation_shape_m
