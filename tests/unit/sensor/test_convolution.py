"""The convolution engine against a convolution done pixel by pixel."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.signal import convolve2d

from horizonval.geometry.camera import CameraModel
from horizonval.sensor.lens import convolution, lens_spread
from horizonval.spec.camera import Band
from horizonval.spec.optics import Optics, Scatter

RNG = np.random.default_rng(5)


def even_kernel(rows: int, columns: int) -> np.ndarray:
    """Return a kernel over all offsets, shape (2 rows - 1, 2 columns - 1), falling from its centre."""
    y, x = np.mgrid[:rows, :columns]
    quadrant = 1e-3 / (1 + np.hypot(x, 1.3 * y)) ** 2
    right = np.concatenate([quadrant[:, :0:-1], quadrant], axis=1)
    return np.concatenate([right[:0:-1], right])


def with_sun(shape: tuple[int, int], sun: float = 1e9) -> np.ndarray:
    """Return a scene of the usual sort: space at 0, Earth about 1, the Sun at the border and inside."""
    image = np.zeros(shape)
    image[shape[0] // 2 :] = 1 + RNG.random((shape[0] - shape[0] // 2, shape[1]))
    image[0, 3:6] = sun
    image[4:7, 11:14] = sun
    return image


def test_core_beside_the_sun():
    image = with_sun((40, 53))
    core = np.outer(*[np.exp(-(np.arange(-6, 7) ** 2) / 3.0)] * 2)
    core /= core.sum()
    exact = convolve2d(image, core, mode="same")
    found = convolution.spread_core(image, core, "dark")
    # 1e-12 of every pixel's own value: the Sun leaves no ripple.
    np.testing.assert_allclose(found, exact, rtol=1e-12, atol=1e-14)
    far = convolve2d(image > 1e8, np.ones((13, 13)), mode="same") == 0
    assert found[far].max() < 2.1
    assert found.min() >= 0


def test_core_keeps_even_images_even_and_may_be_larger_than_the_image():
    core = np.full((9, 9), 1 / 81)
    np.testing.assert_allclose(convolution.spread_core(np.full((20, 31), 3.3), core), 3.3, rtol=1e-13)
    dark = convolution.spread_core(np.full((20, 31), 3.3), core, "dark")
    assert dark[0, 0] == pytest.approx(3.3 * 25 / 81)
    image = RNG.random((7, 5))
    core = np.full((21, 21), 1 / 441)
    np.testing.assert_allclose(convolution.spread_core(image, core, "dark"), image.sum() / 441, rtol=1e-12)


def test_wings_against_a_direct_sum():
    image = with_sun((40, 53))
    kernel = even_kernel(40, 53)
    exact = convolve2d(image, kernel, mode="full")[39 : 39 + 40, 52 : 52 + 53]
    found = convolution.spread_wings(image, kernel[39:, 52:])
    # The Sun's 12 pixels with a kernel of norm 2e-3: rounding leaves 1e-9; on the faintest pixel that is 1e-15.
    np.testing.assert_allclose(found, exact, rtol=1e-11)


def test_same_bytes_on_any_number_of_cores(monkeypatch):
    image = with_sun((211, 307))
    kernel = even_kernel(211, 307)[210:, 306:]
    core = np.full((17, 17), 1 / 289)
    results = set()
    for cores in (1, 2, 3, 8):
        monkeypatch.setattr(convolution, "_ALL_CORES", cores)
        results.add(convolution.spread_wings(image, kernel).tobytes() + convolution.spread_core(image, core).tobytes())
    assert len(results) == 1


def test_values_that_rounding_cannot_explain_are_refused():
    with pytest.raises(ArithmeticError, match="rounding explains"):
        convolution.spread_wings(np.ones((8, 8)), np.full((8, 8), -1.0))


def test_an_even_scene_stays_even_in_an_image_smaller_than_the_core():
    """No pixel sees another through the wings, which begin where the core ends."""
    quadrant = np.zeros((6, 7))
    out = convolution.spread_wings(np.full((6, 7), 3.0), quadrant, 0.2)
    np.testing.assert_allclose(out, 0.6, rtol=1e-12)
    # Only the outermost offset is in reach: of the corners, that is.
    quadrant[5, 6] = 0.01
    np.testing.assert_allclose(convolution.spread_wings(np.full((6, 7), 3.0), quadrant, 0.2), 0.6, rtol=1e-9)


CAMERA = CameraModel(96, 64, 90.0, 90.0, 47.5, 31.5, (-0.1, 0.01, 0.0, 0.0, 0.0), "pinhole", None)
BAND = Band(name="vis", kind="solar", lo_um=0.5, hi_um=0.6)


def test_kernels_of_a_camera_are_transformed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    lens = Optics(f_number=4.0, diffraction=True, psf_sigma_px=0.5, scatter=Scatter(tis=0.01, l_rad=0.005, s=-2.0))
    image = np.random.default_rng(1).uniform(1.0, 2.0, (64, 96))
    convolution._kept.clear()
    first = lens_spread.spread(image, CAMERA, lens, BAND, 5e-6)
    transforms, rfft2 = [], convolution.fft.rfft2

    def counted(values: Any, *arguments: Any, **named: Any) -> Any:
        transforms.append(values)
        return rfft2(values, *arguments, **named)

    monkeypatch.setattr(convolution.fft, "rfft2", counted)
    np.testing.assert_array_equal(lens_spread.spread(image, CAMERA, lens, BAND, 5e-6), first)
    images, kernels = len(transforms), 2
    convolution._kept.clear()
    np.testing.assert_array_equal(lens_spread.spread(image, CAMERA, lens, BAND, 5e-6), first)
    assert (images, len(transforms)) == (2, 2 * images + kernels)


def test_transforms_are_dropped_beyond_their_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(convolution, "_KEPT_BYTES", 300_000)
    convolution._kept.clear()
    for size in range(32, 64, 2):
        quadrant = np.full((size, size), 1.0 / size**2)
        quadrant.flags.writeable = False
        convolution.spread_wings(np.ones((size, size)), quadrant)
    assert 0 < sum(one.spectrum.nbytes for one in convolution._kept.values()) <= 300_000
    kept = len(convolution._kept)
    convolution.spread_wings(np.ones((8, 8)), np.full((8, 8), 0.01))
    assert len(convolution._kept) == kept
