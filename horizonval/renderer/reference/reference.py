"""A frame by Monte Carlo, in Mitsuba: the cross-check of the march, pixel by pixel.

:mod:`horizonval.renderer.reference.reference_scene` says what such a frame holds and leaves out in sunlight,
:mod:`horizonval.renderer.reference.emission_walk` how air emits in thermal bands. Several passes with independent seeds
give the standard error. Thermal bands also record their difference from the deterministic frame of the same scene.

**Scene files** that a Mitsuba user opens hold the deterministic frame, and the same scene in stock plugins. Mitsuba's
writer (``mi.parser.write_file``, 3.9.1) takes transforms apart and writes a wrong scale for the ellipsoid, and it
does not support plugins written in Python.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from horizonval import __version__
from horizonval.core import atomic
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.progress import Progress, Silent
from horizonval.frame import RadianceFrame
from horizonval.geometry.camera import camera_from_spec
from horizonval.renderer.backend import activate
from horizonval.renderer.description import Described, describe
from horizonval.renderer.frame import render_frame
from horizonval.renderer.frame_cost import refuse_too_large
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.truth.frame_truth import with_infrared_horizon

if TYPE_CHECKING:
    from horizonval.renderer.plugins import LimbSettings
    from horizonval.renderer.reference.reference_scene import Placement
    from horizonval.renderer.types import PluginDict

HOLDS = "molecules, ozone, particles, uniform Lambert ground, Sun as a point"
LEAVES_OUT = "refraction, Sun's disc and glare, surface map, clouds, parts of the spacecraft"
THERMAL_HOLDS = "air and thin cloud that emit, ground by kind that emits and reflects the sky"
THERMAL_LEAVES_OUT = "refraction, Sun's disc, clouds, parts of the spacecraft"
STANDARD_ERROR = "standard_error"
"""Map ``standard_error.<band>`` [W m-2 sr-1]: of each pixel's radiance, Monte Carlo noise alone."""
DEFAULT_SPP = 256
MOST_SPP = 1_000_000
LEAST_PASSES = 8
MOST_SUBSAMPLES = 16
LANES = 2**22
"""Most paths of one pass: bounds the memory and the time between two signs of life."""


def resized(camera: CameraSpec, width: int, height: int, where: str) -> CameraSpec:
    """Return the same lens before fewer, larger pixels.

    ``UserError`` if the proportions differ by more than rounding.
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
        "fx": old.fx * (1.0 + old.shape[0]) * x,
        "fy": old.fy * (1.0 + old.shape[0]) * y,
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
    """Return the frame by Monte Carlo, with the map ``standard_error.<band>`` of each band's radiance.

    The seeds come from the scene's identity: the same scene, samples and number of threads give the same frame. Bands
    are sums over the same spectral nodes as in the deterministic frame; ``scene.render.orders`` of scattering. ``spp``:
    samples per pixel and spectral node, 2 to 1e6, rounded up to a multiple of the number of passes; the g points of
    a thermal band share those of the band.

    Raises
    ------
    UserError
        Thermal bands through air that varies with longitude, and errors of
        :func:`horizonval.renderer.frame.render_frame`.
    """
    if not 2 <= spp <= MOST_SPP:
        raise UserError(
            f"{spp} samples per pixel",
            where="samples",
            expected=f"2 to {MOST_SPP}: the standard error needs two passes",
        )
    refuse_too_large(scene, camera)
    progress = progress or Silent()
    described = describe(scene, camera)
    model, intrinsics = described.model, described.camera
    _refuse_weather(described)
    described = replace(described, truth=with_infrared_horizon(described.truth, model))
    passes, each = _passes(spp, intrinsics.width * intrinsics.height)
    progress.start((len(model.nodes) + len(model.thermal)) * passes, 0, unit="passes")
    run = _Passes(passes, each, described, progress)
    bands, sensor = _sunlight(scene, described, run), _sensor(described)
    thermal = _emission(described, run)
    bands |= thermal
    radiance = {band: bands[band].radiance for band in model.bands}
    error = {band: np.sqrt(bands[band].variance) for band in model.bands}
    maps = dict(_truth_maps(described))
    maps |= {f"{STANDARD_ERROR}.{band}": e.astype(np.float32) for band, e in error.items()}
    settings: dict[str, Any] = {
        "version": __version__,
        "kind": "reference",
        "variant": described.variant,
        "integrator": " and ".join(["volpath"] * bool(model.nodes) + ["emission_walk"] * bool(thermal)),
        "sensor": sensor["type"],
        "orders": scene.render.orders,
        "spp": passes * each,
        "passes": passes,
        "relative_standard_error": {band: _relative(radiance[band], error[band]) for band in model.bands},
        "holds": "; ".join([HOLDS] * bool(model.nodes) + [THERMAL_HOLDS] * bool(thermal)),
        "leaves_out": LEAVES_OUT if model.nodes else THERMAL_LEAVES_OUT,
    }
    if thermal:
        settings["deterministic_frame_differs"] = _differences(scene, camera, {b: bands[b] for b in thermal})
    return RadianceFrame(
        radiance={band: r.astype(np.float32) for band, r in radiance.items()},
        maps=maps,
        truth=described.truth,
        render=settings,
        energy_radiance={band: bands[band].energy.astype(np.float32) for band in model.bands if band not in thermal},
    )


@dataclass(frozen=True)
class _Band:
    """Sums over a band's nodes; arrays of the image's shape."""

    radiance: FloatArray
    energy: FloatArray
    variance: FloatArray


@dataclass(frozen=True)
class _Passes:
    """Independent renders of a scene: ``count`` of them with ``each`` samples per pixel."""

    count: int
    each: int
    described: Described
    progress: Progress

    def of(self, mi_scene: Any, name: str, node: int) -> tuple[FloatArray, FloatArray]:
        """Return the mean image and the variance of this mean."""
        import mitsuba as mi

        camera = self.described.camera
        shape = (camera.height, camera.width)
        mean, squares = np.zeros(shape), np.zeros(shape)
        for k in range(self.count):
            seed = _seed(self.described.truth.scene_id, node, k)
            image = np.array(mi.render(mi_scene, spp=self.each, seed=mi.UInt32(seed))).astype(float).reshape(shape)
            # Welford: no list of images, no cancellation
            step = image - mean
            mean += step / (k + 1)
            squares += step * (image - mean)
            self.progress.done(f"{name}, pass {k + 1} of {self.count}")
        return mean, squares / (self.count * (self.count - 1))


def _sunlight(scene: SceneSpec, described: Described, run: _Passes) -> dict[str, _Band]:
    import mitsuba as mi

    from horizonval.renderer.reference import reference_scene as stock

    model, place, sensor = described.model, placement(described), _sensor(described)
    volume = stock.shell_volumes(model, place)
    orders = 1 if scene.render.orders == "single" else None
    bands: dict[str, _Band] = {}
    for i, node in enumerate(model.nodes):
        mi_scene = mi.load_dict(stock.reference_scene(model, node, place, sensor, volume, orders))
        mean, variance = run.of(mi_scene, node.name, i)
        unit = node.weight * node.solar_irradiance
        more = _Band(unit * mean, unit * node.energy_ratio * mean, unit**2 * variance)
        before = bands.get(node.band, _Band(*(np.zeros(mean.shape),) * 3))
        bands[node.band] = _Band(
            before.radiance + more.radiance, before.energy + more.energy, before.variance + more.variance
        )
    return bands


def _emission(described: Described, run: _Passes) -> dict[str, _Band]:
    model = described.model
    if model.emission is None or not model.thermal:
        return {}
    import mitsuba as mi

    from horizonval.renderer.reference.emission_walk import GroundGrid, GroundTables, emission_scene

    place, sensor = placement(described), _sensor(described)
    grid = GroundGrid.below(place, model.emission)
    bands: dict[str, _Band] = {}
    for i, band in enumerate(model.thermal, start=len(model.nodes)):
        ground = GroundTables.of(grid, model.emission, band)
        mean, variance = run.of(mi.load_dict(emission_scene(place, band, ground, sensor)), band.name, i)
        bands[band.name] = _Band(mean, mean, variance)
    return bands


def _sensor(described: Described) -> PluginDict:
    """Return the stock pinhole, or else, the one exception to "stock", our camera plugin in kilometres."""
    from horizonval.renderer.plugins import CameraSettings, camera_properties
    from horizonval.renderer.reference import reference_scene as stock

    intrinsics, place = described.camera, placement(described)
    if stock.is_stock(intrinsics):
        return stock.perspective(intrinsics, place)
    register_plugins()
    lens = CameraSettings(intrinsics, (place.camera_m - place.origin_m) * stock.KM, described.itrs_from_cam)
    return camera_properties(lens) | {"film": stock.film(intrinsics)}


def _refuse_weather(described: Described) -> None:
    if any(band.column_map is not None for band in described.model.thermal):
        raise UserError(
            'is "weather" over the globe, and the camera has thermal bands',
            where="atmosphere.profile",
            expected="air that varies with height and latitude alone",
            fix='name a state, such as "weather:ec2008-12", or a climate, or render without --reference',
        )


def _differences(scene: SceneSpec, camera: CameraSpec, bands: dict[str, _Band]) -> dict[str, dict[str, float]]:
    """Return the difference of the deterministic frame from bands, in standard errors: mean, and rms over pixels.

    Over pixels above a hundredth of the brightest. A perfect frame has an rms of 1.18 with 8 passes (Student's
    t). The frame has as many rays per pixel as possible: pixels of a small image hold much of a limb.
    """
    straight = scene.atmosphere.model_copy(update={"refraction": False})
    fine = scene.render.model_copy(update={"subsamples": MOST_SUBSAMPLES})
    same = scene.model_copy(update={"atmosphere": straight, "clouds": None, "part": [], "render": fine})
    ours = render_frame(same, camera).radiance
    found = {}
    for name, band in bands.items():
        lit = (band.radiance > 0.01 * band.radiance.max()) & (band.variance > 0.0)
        difference, variance = (ours[name].astype(float) - band.radiance)[lit], band.variance[lit]
        if lit.any():
            mean = difference.sum() / np.sqrt(variance.sum())
            rms = float(np.sqrt(np.mean(difference**2 / variance)))
            found[name] = {"mean": float(mean), "rms": rms, "pixels": int(lit.sum())}
    return found


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
    from horizonval.renderer.plugins import mitsuba_scene
    from horizonval.renderer.viewpoint import truth_maps

    # maps need no tables of multiple scattering
    mi_scene = mitsuba_scene(replace(described.limb, orders="single"), described.sensor)
    return truth_maps(mi_scene.integrator().view(mi_scene.sensors()[0]))


SCENE, REFERENCE, README = "scene.xml", "reference.xml", "README.txt"
LOAD = (
    "from horizonval.renderer.reference.reference import register_plugins; register_plugins(); import mitsuba as mi; "
    f"image = mi.render(mi.load_file('{SCENE}'))"
)
"""Python that renders the exported deterministic scene."""
_registered: set[str] = set()
"""Variants that know the plugins."""


def register_plugins() -> None:
    """Select the back-end and register integrator and camera with it, once, for scene files that name them."""
    variant = activate()
    if variant in _registered:
        return
    import mitsuba as mi

    from horizonval.renderer.plugins import INTEGRATOR, SENSOR, camera_settings, plugin_classes

    limb, camera = plugin_classes()
    mi.register_integrator(INTEGRATOR, lambda props: limb(props, limb_settings(props)))
    mi.register_sensor(SENSOR, lambda props: camera(props, camera_settings(props)))
    _registered.add(variant)


def limb_properties(scene: SceneSpec, camera: CameraSpec) -> PluginDict:
    """Return the integrator's properties for a file: the scene as its specification."""
    text = {k: v.model_dump(mode="json", exclude_unset=True) for k, v in (("scene", scene), ("camera", camera))}
    return {"type": "horizon_limb", "scene": json.dumps(text, sort_keys=True)}


def limb_settings(properties: Any) -> LimbSettings:
    """Return the settings of :func:`limb_properties`; ``properties`` is Mitsuba's object."""
    text = json.loads(properties.get("scene"))
    return describe(SceneSpec.model_validate(text["scene"]), CameraSpec.model_validate(text["camera"])).limb


def export_scene(scene: SceneSpec, camera: CameraSpec, folder: Path) -> list[Path]:
    """Write ``scene.xml``, ``README.txt`` and, for solar bands, ``reference.xml`` with its grids; return the paths.

    ``folder`` is made if need be; files of these names are replaced. Errors as of
    :func:`horizonval.renderer.frame.render_frame`.
    """
    described = describe(scene, camera)
    from horizonval.renderer.plugins import camera_properties

    atomic.make_folder(folder)
    bands = ", ".join(described.model.bands)
    needs = "needs horizonval and the data files of the scene"
    about = f'{SCENE} ({needs}): python -c "{LOAD}" gives radiance [W m-2 sr-1] of band {bands}.'
    head = f"horizonval scene {scene.scene.name}: deterministic limb march; W m-2 sr-1; bands {bands}"
    plugins = {"integrator": limb_properties(scene, camera), "sensor": camera_properties(described.sensor)}
    atomic.write_text(folder / SCENE, scene_xml({"type": "scene", **plugins}, head))
    reference = _write_reference(scene, described, folder)
    atomic.write_text(folder / README, f"{about}\n{reference}\n")
    return sorted(folder.iterdir())


def _write_reference(scene: SceneSpec, described: Described, folder: Path) -> str:
    """Write the stock scene of the first solar band's heaviest node; return the line that says what it is."""
    from horizonval.renderer.reference import reference_scene as stock
    from horizonval.renderer.reference.reference_scene import grid_volumes, seen_air

    solar = [node for node in described.model.nodes if node.solar_irradiance > 0.0]
    if not solar:
        return f"No {REFERENCE}: the camera has thermal bands only, and stock media do not glow."
    node = max((n for n in solar if n.band == solar[0].band), key=lambda n: n.weight)
    place = placement(described)
    box = seen_air(described.model, place, described.camera, node.extinction_per_m)
    air = "no air in view"
    if box is not None:
        x, y, z = (f"{v * 1e-3:.2g}" for v in box.spacing_m)
        air = f"air on a grid of {x} x {y} x {z} km around what the camera sees, up to {box.top_m * 1e-3:.0f} km"
        volume = grid_volumes(described.model, node, place, box, folder)
    else:
        volume = stock.shell_volumes(described.model, place)
    sensor = stock.perspective(described.camera, place)
    orders = 1 if scene.render.orders == "single" else None
    data = stock.reference_scene(described.model, node, place, sensor, volume, orders)
    data["sun"]["irradiance"]["value"] = node.solar_irradiance
    lens = "" if stock.is_stock(described.camera) else "; undistorted pinhole of the same fx, not the camera's own lens"
    about = (
        f"by Monte Carlo in stock Mitsuba 3, at {node.wavelength_um:.4g} um alone [W m-2 sr-1 um-1]: {HOLDS}; "
        f"without {LEAVES_OUT}; {air}{lens}; kilometres, origin on the ground below the camera"
    )
    atomic.write_text(folder / REFERENCE, scene_xml(data, f"horizonval scene {scene.scene.name} {about}"))
    return f"{REFERENCE} (mitsuba -m llvm_ad_mono {REFERENCE}): {about}."


VERSION = "3.0.0"
_TAGS = {
    "integrator": ("horizon_limb", "volpath"),
    "sensor": ("horizon_camera", "perspective"),
    "film": ("hdrfilm",),
    "rfilter": ("box",),
    "sampler": ("independent",),
    "medium": ("heterogeneous",),
    "volume": ("gridvolume", "constvolume"),
    "phase": ("rayleigh", "isotropic", "hg", "blendphase"),
    "shape": ("sphere", "shapegroup", "instance"),
    "bsdf": ("diffuse", "null"),
    "emitter": ("directional",),
}
_TAG_OF = {plugin: tag for tag, plugins in _TAGS.items() for plugin in plugins}
_POINTS = ("center",)


def scene_xml(scene: dict[str, Any], comment: str) -> str:
    """Return the XML of a scene dictionary that holds our plugins only, headed by ``comment``."""
    root = ElementTree.Element("scene", version=VERSION)
    root.append(ElementTree.Comment(f" {comment.replace('--', '-')} "))
    for name, value in scene.items():
        if name != "type":
            root.append(_element(name, value, named=False))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _element(name: str, value: Any, named: bool = True) -> ElementTree.Element:
    import mitsuba as mi

    if isinstance(value, dict):
        return _plugin(name, value, named)
    if isinstance(value, mi.ScalarTransform4f):
        transform = ElementTree.Element("transform", name=name)
        transform.append(ElementTree.Element("matrix", value=_numbers(np.array(value.matrix).ravel())))
        return transform
    if isinstance(value, list):
        tag = "point" if name in _POINTS else "vector"
        return ElementTree.Element(tag, name=name, value=_numbers(value))
    # bool is an int to Python, so it comes first
    for kind, tag in ((bool, "boolean"), (int, "integer"), (float, "float"), (str, "string")):
        if isinstance(value, kind):
            text = str(value).lower() if kind is bool else str(value)
            return ElementTree.Element(tag, name=name, value=text)
    raise TypeError(f"{name}: {type(value).__name__} has no XML")


def _plugin(name: str, data: dict[str, Any], named: bool) -> ElementTree.Element:
    label: dict[str, str] = {"name": name} if named else {}
    kind = data["type"]
    if kind == "ref":
        return ElementTree.Element("ref", label | {"id": data["id"]})
    if kind == "uniform":
        return ElementTree.Element("spectrum", label | {"value": str(data["value"])})
    element = ElementTree.Element(_TAG_OF[kind], label | {"type": kind})
    if "id" in data:
        element.set("id", data["id"])
    for key, value in data.items():
        if key not in ("type", "id"):
            element.append(_element(key, value))
    return element


def _numbers(values: Iterable[float]) -> str:
    return ", ".join(repr(float(v)) for v in values)
