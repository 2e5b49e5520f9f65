"""The point spread of the whole lens: core and wings.

The share 1 - TIS of a point's light goes into the core (aberration, diffraction, defocus; over the field if it
changes), the share TIS into the scatter wings over the whole image. What diffraction throws beyond the core's square
joins the wings. A lens with nothing but a Gaussian keeps the direct convolution of
:mod:`horizonval.sensor.lens.point_spread`.

Outside the image the core takes the scene to go on as in the border pixel and the wings as the mean of what they see
inside, a Sun excepted, so that an even scene stays even. The second guess is wrong by at most the contrast of the scene
times the wings' share outside, half of TIS on the border. The Sun outside: :mod:`horizonval.sensor.lens.stray_light`.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.geometry.camera import CameraModel, field_angles
from horizonval.sensor.lens import convolution, core_spread, diffraction, field_spread, point_spread, scatter
from horizonval.sensor.lens.convolution import Border
from horizonval.spec.camera import Band
from horizonval.spec.optics import Optics, Scatter


def spread(
    image: FloatArray,
    camera: CameraModel,
    lens: Optics,
    band: Band | None = None,
    pixel_pitch_m: float | None = None,
    border: Border = "edge",
) -> FloatArray:
    """Return the image as the lens spreads it, shape (H, W), in the image's unit.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        Light per pixel, not below 0.
    camera : CameraModel
    lens : Optics
    band, pixel_pitch_m : optional
        For diffraction and defocus.
    border : {"edge", "dark"}
        What is taken to be outside the image: "edge" guesses as above, "dark" is for the bookkeeping of light.

    Raises
    ------
    UserError
        Diffraction or defocus without what they need, or wider than a kernel can be.
    """
    core = None
    for sigma, share in _over_field(camera, lens):
        part = _core_of(image if share is None else share * image, sigma, lens, band, pixel_pitch_m, border)
        core = part if core is None else core + part
    assert core is not None
    return _with_wings(core, image, camera, lens, band, pixel_pitch_m, border)


def check(lens: Optics, band: Band, pixel_pitch_m: float) -> None:
    """Raise :class:`UserError` if the core is wider than a kernel can be."""
    if lens.diffraction or lens.defocus_um != 0:
        _core(lens, band, pixel_pitch_m)


def lost_share(
    camera: CameraModel, lens: Optics, band: Band | None = None, pixel_pitch_m: float | None = None
) -> FloatArray:
    """Return the share of every pixel's light that leaves the image over its border, shape (H, W).

    The kernels being even, a pixel's light goes where light of its own kernel would come from: what stays of it is what
    the same kernel makes of an image of ones that is dark outside.
    """
    ones = np.ones((camera.height, camera.width))
    core = np.zeros_like(ones)
    for sigma, share in _over_field(camera, lens):
        part = _core_of(ones, sigma, lens, band, pixel_pitch_m, "dark")
        core += part if share is None else share * part
    return 1 - _with_wings(core, ones, camera, lens, band, pixel_pitch_m, "dark")


def wing_quadrant(
    camera: CameraModel, lens: Optics, band: Band | None, pixel_pitch_m: float | None
) -> FloatArray | None:
    """Return the wings at offsets (0..H - 1, 0..W - 1), shape (H, W), read-only; None for a lens without."""
    if lens.diffraction:
        _, pitch, chosen, reach = _core(lens, band, pixel_pitch_m)
        assert chosen is not None
        return _wings_with_diffraction(camera, lens.scatter, core_spread.spread_px(chosen, lens.f_number, pitch), reach)
    return None if lens.scatter is None else _scattered(camera, lens.scatter)


def _scattered(camera: CameraModel, rough: Scatter) -> FloatArray:
    return scatter.quadrant(rough, camera.height, camera.width, camera.fx, camera.fy)


@lru_cache(maxsize=2)
def _wings_with_diffraction(camera: CameraModel, rough: Scatter | None, spread_px: float, reach: int) -> FloatArray:
    tail = _diffraction_tail(camera, spread_px, reach)
    tail *= 1.0 if rough is None else 1 - rough.total
    wings = tail if rough is None else _scattered(camera, rough) + tail
    wings.flags.writeable = False
    return wings


def wings_of_point(
    camera: CameraModel, lens: Optics, band: Band | None, pixel_pitch_m: float | None, column: float, row: float
) -> FloatArray:
    """Return the share per pixel of the light of a point outside the image, shape (H, W): wings only."""
    y, x = np.arange(camera.height)[:, None] - row, np.arange(camera.width)[None, :] - column
    out = np.zeros((camera.height, camera.width))
    if lens.scatter is not None:
        rho_squared = (x / camera.fx) ** 2 + (y / camera.fy) ** 2
        out += scatter.image_share(lens.scatter, rho_squared) / (camera.fx * camera.fy)
    if lens.diffraction:
        _, pitch, chosen, reach = _core(lens, band, pixel_pitch_m)
        assert chosen is not None
        # Nearer than the core's reach the power law is no more than a bound: held level from there.
        tail = diffraction.far_pattern(
            np.maximum(np.hypot(x, y), reach), core_spread.spread_px(chosen, lens.f_number, pitch)
        )
        out += tail * (1.0 if lens.scatter is None else 1 - lens.scatter.total)
    return out


def _with_wings(
    core: FloatArray,
    image: FloatArray,
    camera: CameraModel,
    lens: Optics,
    band: Band | None,
    pixel_pitch_m: float | None,
    border: Border,
) -> FloatArray:
    """Return what the scatter leaves of the core, and the wings of the image."""
    scattered = 0.0 if lens.scatter is None else lens.scatter.total
    if lens.scatter is not None:
        core = core * (1 - scattered)
    wings = wing_quadrant(camera, lens, band, pixel_pitch_m)
    if wings is None:
        return core
    if border == "dark":
        return core + convolution.spread_wings(image, wings)
    total = scattered
    if lens.diffraction:
        _, pitch, chosen, reach = _core(lens, band, pixel_pitch_m)
        assert chosen is not None
        spread_px = core_spread.spread_px(chosen, lens.f_number, pitch)
        total += (1 - scattered) * diffraction.share_outside(reach + 0.5, reach + 0.5, spread_px)
    return core + convolution.spread_wings(image, wings, total)


def _over_field(camera: CameraModel, lens: Optics) -> list[tuple[float, FloatArray | None]]:
    """Return the sigmas of the Gaussians and the share of every pixel's light that each spreads; None for all of it."""
    if not lens.psf_field_deg:
        return [(lens.psf_sigma_px, None)]
    angle_deg = np.degrees(field_angles(camera))
    # Pixels outside the image circle have no angle and no light.
    angle_deg = np.where(np.isnan(angle_deg), 180.0, angle_deg)
    return [*field_spread.shares(angle_deg, lens.psf_field_deg, lens.psf_field_sigma_px)]


def _core_of(
    light: FloatArray, sigma_px: float, lens: Optics, band: Band | None, pixel_pitch_m: float | None, border: Border
) -> FloatArray:
    """Return the light spread by one Gaussian with the diffraction and the defocus."""
    if not lens.diffraction and lens.defocus_um == 0:
        return point_spread.blur(light, sigma_px, border)
    radius, pitch, chosen, reach = _core(lens, band, pixel_pitch_m)
    kernel = core_spread.kernel(sigma_px, radius, chosen, lens.f_number, pitch, reach)
    return convolution.spread_core(light, kernel, border)


def _core(lens: Optics, band: Band | None, pixel_pitch_m: float | None) -> tuple[float, float, Band | None, int]:
    """Return the defocus disc's radius [px], the pitch [m], the band to diffract, and the kernel's reach [px]."""
    if pixel_pitch_m is None or (lens.diffraction and band is None):
        key = "diffraction" if lens.diffraction else "defocus_um"
        raise UserError(f"optics.{key} needs the band and the detector's pixel pitch", where=f"optics.{key}")
    radius = abs(lens.defocus_um) * 1e-6 / (2 * lens.f_number * pixel_pitch_m)
    chosen = band if lens.diffraction else None
    spread_px = 0.0 if chosen is None else core_spread.spread_px(chosen, lens.f_number, pixel_pitch_m)
    widest = max([lens.psf_sigma_px, *lens.psf_field_sigma_px])
    if spread_px > core_spread.MOST_SPREAD_PX:
        raise UserError(
            f"diffraction at f_number = {lens.f_number:g} spreads lambda N = {spread_px:.3g} pixels of "
            f"pixel_pitch_um = {pixel_pitch_m * 1e6:g}",
            where="optics.diffraction",
            expected=f"at most {core_spread.MOST_SPREAD_PX:g} pixels",
        )
    if 4 * widest + radius > core_spread.MOST_REACH:
        raise UserError(
            f"a defocus disc of {radius:.4g} pixels (defocus_um = {lens.defocus_um:g}, f_number = {lens.f_number:g}) "
            f"and a blur of {widest:g} pixels",
            where="optics.defocus_um" if lens.defocus_um else "optics.psf_sigma_px",
            expected=f"radius and four sigma within {core_spread.MOST_REACH} pixels",
        )
    return radius, pixel_pitch_m, chosen, core_spread.reach_px(widest, radius, spread_px)


def _diffraction_tail(camera: CameraModel, spread_px: float, reach: int) -> FloatArray:
    """Return the diffraction beyond the core's square, scaled to hold exactly what the formula puts into the image."""
    y, x = np.arange(camera.height)[:, None], np.arange(camera.width)[None, :]
    outside = (y > reach) | (x > reach)
    tail = np.where(outside, diffraction.far_pattern(np.hypot(np.maximum(x, 1), y), spread_px), 0.0)
    if min(tail.shape) > reach + 1:
        exact = diffraction.share_outside(reach + 0.5, reach + 0.5, spread_px) - diffraction.share_outside(
            camera.width - 0.5, camera.height - 0.5, spread_px
        )
        tail *= exact / scatter.quadrant_sum(tail)
    return tail
