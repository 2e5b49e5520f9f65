"""A frame by Monte Carlo, in stock Mitsuba: the cross-check of the march, pixel by pixel.

:mod:`horizonval.renderer.reference.reference_scene` says what such a frame holds and leaves out. It comes with an
estimate of its own noise: several passes with independent seeds, whose scatter is the standard error.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from horizonval import __version__
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.progress import Progress, Silent
from horizonval.frame import RadianceFrame
from horizonval.geometry.camera import camera_from_spec
from horizonval.renderer.scene.description import Described, describe
from horizonval.renderer.scene.frame_memory import refuse_too_large
from horizonval.spec.scene import SceneSpec
from horizonval.spec.sensor.camera import CameraSpec

if TYPE_CHECKING:
    from horizonval.renderer.reference.reference_scene import Placement

HOLDS = "molecules, ozone, particles, uniform Lambert ground, Sun as a point"
LEAVES_OUT = "Sun's disc and glare, surface map, clouds, parts of the spacecraft"
STANDARD_ERROR = "standard_error"
"""Map ``standard_error.<band>`` [W m-2 sr-1]: of each pixel's radiance, Monte Carlo noise alone."""
DEFAULT_SPP = 256
MOST_SPP = 1_000_000
LEAST_PASSES = 8
LANES = 2**22
"""Most paths of one pass: bounds the memory and the time between two signs of life."""


def check_sunlight(camera: CameraSpec, where: str) -> None:
    """Refuse thermal bands: stock media do not glow."""
    thermal = [band.name for band in camera.band if band.kind == "thermal"]
    if thermal:
        raise UserError(
            f"band {thermal[0]!r} is thermal",
            where=where,
            expected="solar bands only: the reference holds scattered sunlight",
            fix="render it without --reference",
        )


def resized(camera: CameraSpec, width: int, height: int, where: str) -> CameraSpec:
    """Return the same lens in front of a detector of fewer, larger pixels.

    Raises
    ------
    UserError
        If the proportions differ by more than rounding to whole pixels.
    """
    old = camera_from_spec(camera.camera)
    right = max(round(width * old.height / old.width), 1)
    if right != height:
        raise UserError(
            f"{width}x{height} is out of proportion",
            where=where,
            expected=f"the camera's {old.width}:{old.height}, such as {width}x{right}",
        )
    x, y = width / old.width, height / old.height
    data = camera.model_dump()
    del data["camera"]["fov_deg"]
    data["camera"] |= {
        "width": width,
        "height": height,
        "fx": old.fx * x,
        "fy": old.fy * y,
        # the image's outer edge, not the first pixel's centre, stays where it is
        "cx": (old.cx + 0.5) * x - 0.5,
        "cy": (old.cy + 0.5) * y - 0.5,
    }
    data["optics"]["psf_sigma_px"] *= x
    if data["detector"] is not None:
        data["detector"]["pixel_pitch_um"] /= x
    return CameraSpec.model_validate(data)


def render_reference(
    scene: SceneSpec,
    camera: CameraSpec,
    spp: int = DEFAULT_SPP,
    progress: Progress | None = None,
) -> RadianceFrame:
    """Return the frame by Monte Carlo, with the map ``standard_error.<band>`` beside its radiance.

    The seeds come from the scene's identity: the same scene, samples and number of threads give the same frame. Bands
    are weighted sums over the same spectral nodes as in the deterministic frame; ``scene.render.orders`` of scattering.

    Parameters
    ----------
    spp : int
        Samples per pixel and spectral node, 2 to 1e6; rounded up to a multiple of the number of passes.
    progress : Progress, optional

    Raises
    ------
    UserError
        Thermal bands, and whatever :func:`horizonval.renderer.scene.frame.render_frame` refuses.
    """
    if not 2 <= spp <= MOST_SPP:
        raise UserError(
            f"{spp} samples per pixel",
            where="samples",
            expected=f"2 to {MOST_SPP}: the standard error needs two passes",
        )
    check_sunlight(camera, scene.camera.file)
    refuse_too_large(scene, camera)
    progress = progress or Silent()
    described = describe(scene, camera)
    import mitsuba as mi

    from horizonval.renderer.plugin.scene_text import camera_properties
    from horizonval.renderer.plugin.settings import CameraSettings
    from horizonval.renderer.reference import reference_scene as stock

    intrinsics, place = described.camera, placement(described)
    if stock.is_stock(intrinsics):
        sensor = stock.perspective(intrinsics, place)
    else:
        # the one exception to "stock": our camera plugin, in kilometres
        origin_km = (place.camera_m - place.origin_m) * stock.KM
        lens = CameraSettings(intrinsics, origin_km, described.itrs_from_cam)
        sensor = camera_properties(lens) | {"film": stock.film(intrinsics)}
    model = described.model
    volume = stock.shell_volumes(model, place)
    orders = 1 if scene.render.orders == "single" else None
    passes, each = _passes(spp, intrinsics.width * intrinsics.height)
    bands = list(dict.fromkeys(node.band for node in model.nodes))
    shape = (intrinsics.height, intrinsics.width)
    radiance = {band: np.zeros(shape) for band in bands}
    energy = {band: np.zeros(shape) for band in bands}
    variance = {band: np.zeros(shape) for band in bands}
    progress.start(len(model.nodes) * passes, 0, unit="passes")
    for i, node in enumerate(model.nodes):
        mi_scene = mi.load_dict(stock.reference_scene(model, node, place, sensor, volume, orders))
        mean, squares = np.zeros(shape), np.zeros(shape)
        for k in range(passes):
            seed = _seed(described.truth.scene_id, i, k)
            image = np.array(mi.render(mi_scene, spp=each, seed=mi.UInt32(seed))).astype(float).reshape(shape)
            # Welford: no list of images, no cancellation
            step = image - mean
            mean += step / (k + 1)
            squares += step * (image - mean)
            progress.done(f"{node.name}, pass {k + 1} of {passes}")
        unit = node.weight * node.solar_irradiance
        radiance[node.band] += unit * mean
        energy[node.band] += unit * node.energy_ratio * mean
        variance[node.band] += unit**2 * squares / (passes * (passes - 1))
    error = {band: np.sqrt(v) for band, v in variance.items()}
    maps = dict(_truth_maps(described))
    maps |= {f"{STANDARD_ERROR}.{band}": e.astype(np.float32) for band, e in error.items()}
    settings: dict[str, Any] = {
        "version": __version__,
        "kind": "reference",
        "variant": described.variant,
        "integrator": "volpath",
        "sensor": sensor["type"],
        "orders": scene.render.orders,
        "spp": passes * each,
        "passes": passes,
        "relative_standard_error": {band: _relative(radiance[band], error[band]) for band in bands},
        "holds": HOLDS,
        "leaves_out": LEAVES_OUT,
    }
    return RadianceFrame(
        radiance={band: r.astype(np.float32) for band, r in radiance.items()},
        maps=maps,
        truth=described.truth,
        render=settings,
        energy_radiance={band: e.astype(np.float32) for band, e in energy.items()},
    )


def placement(described: Described) -> Placement:
    """Return where things are in the reference scene, its origin below the camera."""
    from horizonval.renderer.planet import Planet
    from horizonval.renderer.reference.reference_scene import Placement

    truth = described.truth
    planet = Planet(truth.ellipsoid_a_m, truth.ellipsoid_b_m)
    return Placement.below(planet, np.array(truth.r_itrs), described.itrs_from_cam, truth.sun_itrs)


def _passes(spp: int, pixels: int) -> tuple[int, int]:
    """Return ``(passes, samples per pixel of each)``."""
    passes = min(max(LEAST_PASSES, math.ceil(spp * pixels / LANES)), spp)
    return passes, math.ceil(spp / passes)


def _seed(scene_id: str, node: int, k: int) -> int:
    sequence = np.random.SeedSequence(int(scene_id, 16), spawn_key=(node, k))
    return int(sequence.generate_state(1, np.uint32)[0])


def _relative(radiance: FloatArray, error: FloatArray) -> float:
    """Return the rms of a pixel's relative standard error, pixels above a hundredth of the brightest."""
    lit = radiance > 0.01 * radiance.max()
    return float(np.sqrt(np.mean((error[lit] / radiance[lit]) ** 2))) if lit.any() else 0.0


def _truth_maps(described: Described) -> dict[str, NDArray[np.float32]]:
    from horizonval.renderer.plugin.plugins import mitsuba_scene
    from horizonval.renderer.scene.truth_maps import truth_maps

    # maps need no tables of multiple scattering
    mi_scene = mitsuba_scene(replace(described.limb, orders="single"), described.sensor)
    return truth_maps(mi_scene.integrator().view(mi_scene.sensors()[0]))
