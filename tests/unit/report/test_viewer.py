"""What the viewer is given: numbers packed without loss, and a stated choice where not all of them fit."""

from __future__ import annotations

import base64
import zlib

import numpy as np
import pytest
from synthetic import THERMAL_CAMERA, toy_image, truth_at

from horizonval.report import viewer


@pytest.mark.parametrize("shape", [(3, 5), (1, 64), (64, 1)])
def test_packed_numbers_are_the_numbers(shape):
    dn = np.random.default_rng(5).integers(0, 2**16, shape, dtype=np.uint16)
    planes = np.frombuffer(zlib.decompress(base64.b64decode(viewer.packed(dn))), np.uint8).astype(np.uint16)
    steps = (planes[: dn.size] | planes[dn.size :] << 8).reshape(shape)
    np.testing.assert_array_equal(np.cumsum(steps, axis=1, dtype=np.uint16), dn)


def test_the_numbers_chosen_fit_and_are_spread():
    image = toy_image(truth_at(THERMAL_CAMERA))
    images = [image, None, *[image] * 8]
    assert viewer.chosen(images) == {0, *range(2, 10)}
    some = viewer.chosen(images, 3 * image.dn.size)
    assert len(some) == 3
    assert 1 not in some
    assert max(some) >= 6
    assert viewer.chosen(images, image.dn.size - 1) == set()
