"""Vignetting, pupil, spread over the field and ghosts, each against its formula."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import dblquad, quad

from horizonval.geometry.camera import CameraModel, field_angles
from horizonval.sensor.lens import lens_spread, optics, scatter, stray_light
from horizonval.spec.optics import Ghost, Optics, Scatter

CAMERA = CameraModel(width=81, height=61, fx=60.0, fy=60.0, cx=40.0, cy=30.0)
RNG = np.random.default_rng(3)


def test_vignetting_multiplies_the_cosine_law():
    lens = Optics(vignetting_deg=[10, 30], vignetting=[1.0, 0.6])
    share = optics.relative_illumination(CAMERA, lens) / optics.relative_illumination(CAMERA, Optics())
    angle = np.degrees(field_angles(CAMERA))
    assert share[30, 40] == share[30, 45] == 1
    row, column = 30, 40 + round(60 * math.tan(math.radians(20)))
    assert share[row, column] == pytest.approx(1 - 0.4 * (angle[row, column] - 10) / 20, rel=1e-12)
    assert share[0, 0] == pytest.approx(0.6)


def test_a_constant_pupil_leaves_the_cosine_out():
    """180 deg of an equal-angle lens: what is left is its solid angle, with a flat pupil nothing at the border."""
    camera = CameraModel(width=201, height=201, fx=63.67, fy=63.67, cx=100.0, cy=100.0, projection="equal_angle")
    # Along the middle row the equal-angle grid has a solid angle without change; along a column it is the cosine.
    constant = optics.relative_illumination(camera, Optics(pupil="constant"))
    flat = optics.relative_illumination(camera, Optics())
    np.testing.assert_allclose(constant[100], 1.0, rtol=1e-12)
    angle = (np.arange(201) - 100) / 63.67
    np.testing.assert_allclose(constant[:, 100], np.cos(angle), atol=1e-12)
    np.testing.assert_allclose(flat[100], np.maximum(np.cos(angle), 0), atol=1e-12)


def test_field_shares_have_the_wanted_variance():
    angle = np.linspace(0, 50, 101)
    shares = lens_spread.field_shares(angle, [5, 20, 40], [0.7, 1.0, 2.5])
    total = sum(share for _, share in shares)
    variance = sum(sigma**2 * share for sigma, share in shares)
    np.testing.assert_allclose(total, 1, rtol=1e-14)
    np.testing.assert_allclose(variance, np.interp(angle, [5, 20, 40], [0.7, 1.0, 2.5]) ** 2, rtol=1e-12)
    assert min(share.min() for _, share in shares) >= 0


@pytest.mark.parametrize("table", [([0.0], [1.5]), ([0.0, 30.0], [1.5, 1.5])])
def test_a_field_table_of_one_value_is_the_plain_gaussian(table):
    image = RNG.random((61, 81))
    plain = lens_spread.spread(image, CAMERA, Optics(psf_sigma_px=1.5))
    over_field = lens_spread.spread(image, CAMERA, Optics(psf_field_deg=table[0], psf_field_sigma_px=table[1]))
    np.testing.assert_allclose(over_field, plain, rtol=1e-12)


def test_points_far_from_the_axis_are_wider():
    lens = Optics(psf_field_deg=[0, 30], psf_field_sigma_px=[0.8, 2.0])
    y, x = np.mgrid[:61, :81]
    for row, column in ((30, 40), (30, 65), (12, 20)):
        image = np.zeros((61, 81))
        image[row, column] = 2.0
        spread = lens_spread.spread(image, CAMERA, lens)
        angle = np.degrees(field_angles(CAMERA))[row, column]
        wanted = np.interp(angle, [0, 30], [0.8, 2.0])
        # All but what the widest Gaussian throws over the border at 6 sigma.
        assert spread.sum() == pytest.approx(2, rel=1e-8)
        # Sampled Gaussians have their variance to 0.3 % from 0.7 pixels on.
        assert (spread * (x - column) ** 2).sum() / 2 == pytest.approx(wanted**2, rel=4e-3)
        assert (spread * (y - row) ** 2).sum() / 2 == pytest.approx(wanted**2, rel=4e-3)


def test_mirrored_ghost_is_the_image_turned_about_the_principal_point():
    image = RNG.random((61, 81))
    found = stray_light.ghost_image(image, CAMERA, Ghost(ratio=0.01))
    np.testing.assert_allclose(found, 0.01 * image[::-1, ::-1], rtol=1e-12)


@pytest.mark.parametrize("scale", [-0.8, 0.37, 1.7, -2.5, 0.05])
@pytest.mark.parametrize("blur", [0.0, 1.5])
def test_ghosts_keep_their_light_and_their_place(scale, blur):
    image = np.zeros((61, 81))
    image[28:33, 44:47] = 1e9
    found = stray_light.ghost_image(image, CAMERA, Ghost(ratio=1e-4, scale=scale, blur_px=blur))
    assert found.min() >= 0
    assert found.sum() == pytest.approx(1e-4 * image.sum(), rel=1e-9)
    y, x = np.mgrid[:61, :81]
    # Smaller than a pixel, the ghost of a pixel can only be put on the nearest.
    nearest = 1e-6 if abs(scale) > 0.5 else 0.5
    assert (found * x).sum() / found.sum() == pytest.approx(40 + 5 * scale, abs=nearest)
    assert (found * y).sum() / found.sum() == pytest.approx(30, abs=1e-6)


def test_ghost_light_off_the_image_is_lost():
    image = np.zeros((61, 81))
    image[30, 60] = 1.0
    assert stray_light.ghost_image(image, CAMERA, Ghost(ratio=0.1, scale=3.0)).sum() == 0


SHAPES = [(0.3, -1.5), (0.01, -1.5), (0.01, -2.0), (0.004, -3.0), (1e-4, -2.0)]


@pytest.mark.parametrize(("l_rad", "s"), SHAPES)
def test_total_integrated_scatter(l_rad, s):
    given = Scatter(b0=0.1, l_rad=l_rad, s=s)
    parts = [0, l_rad / 10, l_rad, min(10 * l_rad, 0.99), 1]
    exact = sum(
        quad(lambda x: 2 * math.pi * x * 0.1 * (1 + (x / l_rad) ** 2) ** (s / 2), a, b, epsabs=0, epsrel=1e-11)[0]
        for a, b in pairwise(parts)
    )
    assert given.total == pytest.approx(exact, rel=1e-9)
    assert Scatter(tis=exact, l_rad=l_rad, s=s).level == pytest.approx(0.1, rel=1e-9)


@pytest.mark.parametrize(("l_rad", "s"), SHAPES)
def test_image_plane_holds_the_total(l_rad, s):
    """Over the whole plane it is all; over a rectangle what a double integral finds."""
    given = Scatter(tis=0.01, l_rad=l_rad, s=s)
    assert scatter.share_in_rectangle(given, 1e5, 1e5) == pytest.approx(0.01, rel=1e-4)
    if l_rad >= 0.01:
        exact = 4 * dblquad(lambda y, x: float(scatter.image_share(given, x * x + y * y)), 0, 0.5, 0, 0.3)[0]
        assert scatter.share_in_rectangle(given, 0.5, 0.3) == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize(("l_rad", "s"), SHAPES)
def test_kernel_on_pixels(l_rad, s):
    given = Scatter(tis=0.01, l_rad=l_rad, s=s)
    kernel = scatter.quadrant(given, 300, 400, 350.0, 360.0)
    assert kernel.min() > 0
    inside = scatter.share_in_rectangle(given, 399.5 / 350, 299.5 / 360)
    assert scatter.quadrant_sum(kernel) == pytest.approx(inside, rel=1e-12)
    # The scale to that sum is the error of taking pixels by their centre: small.
    law = scatter.bsdf(given, np.sin(np.arctan(200 / 350))) * math.cos(math.atan(200 / 350)) ** 4 / (350 * 360)
    assert kernel[0, 200] == pytest.approx(law, rel=1e-3)
