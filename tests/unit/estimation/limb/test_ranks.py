"""Ranks of pixels against NumPy's, to the bit, and the stretch that comes from counts against that from the pixels."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.estimation.limb import picture
from horizonval.estimation.limb.picture import Picture

SIZES = (1, 2, 3, 10, 11, 999, 1000, 4801)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("size", SIZES)
def test_ranks_are_numpys_to_the_bit(kind: type, size: int) -> None:
    values = np.random.default_rng(size).normal(50.0, 30.0, size).astype(kind)
    assert picture.median(values) == float(np.median(values))
    for q in (0.5, 50.0, 99.9):
        assert picture.percentile(values, q) == float(np.percentile(values, q))


@pytest.mark.parametrize("size", SIZES)
def test_counts_have_the_percentiles_of_what_they_count(size: int) -> None:
    levels = np.random.default_rng(size).integers(0, 1000, (size, 3)).astype(np.uint16)
    counts = picture.level_counts(levels, 999)
    assert counts.tolist() == np.bincount(levels.ravel(), minlength=1000).tolist()
    for q in (0.5, 50.0, 99.9):
        assert picture.percentile_of_counts(counts, q) == float(np.percentile(levels, q))


@pytest.mark.parametrize("full_scale", [None, 700.0, 1023.0])
def test_an_image_of_whole_numbers_is_stretched_as_any_other(full_scale: float | None) -> None:
    rng = np.random.default_rng(4)
    whole = np.rint(np.clip(rng.normal(400.0, 200.0, (90, 120)), 3.0, 1023.0))
    assert Picture(whole, full_scale).levels is not None
    # The same image off whole numbers takes the way of any other.
    shifted = Picture(whole - 3.5, None if full_scale is None else full_scale - 3.5)
    assert shifted.levels is None
    # Both formulas round to eight bits, of numbers that differ in the last bits.
    apart = Picture(whole, full_scale).eight_bit.astype(int) - shifted.eight_bit.astype(int)
    assert np.mean(apart != 0) < 1e-3


def test_beyond_sixteen_bits_and_below_zero_are_no_levels() -> None:
    image = np.tile(np.arange(20.0), (20, 1))
    assert Picture(image).levels is not None
    for other in (image - 1.0, image + 65530.0, image + 0.25):
        assert Picture(other).levels is None
