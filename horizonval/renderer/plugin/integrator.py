"""``horizon_limb``: the deterministic limb march as a Mitsuba integrator plugin.

``mi.render`` on a scene with this integrator and a ``horizon_camera`` returns a tensor (height, width, bands): radiance
in W m-2 sr-1 per band. It makes its own Float64 rays and ignores sample count and seed, because nothing is random.
"""

from __future__ import annotations

import json
from collections import OrderedDict
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.progress import Progress
from horizonval.earth.column import OpticalModel, SpectralNode
from horizonval.earth.surface.surface import GroundModel
from horizonval.renderer.kernel.batching import IMAGE_TABLE, make_batches
from horizonval.renderer.kernel.cells import FrameGeometry, MoonInFrame
from horizonval.renderer.kernel.discs import Disc
from horizonval.renderer.kernel.node_batches import SolarNodes, ThermalNodes
from horizonval.renderer.kernel.surface import dump_ground, load_ground, make_ground
from horizonval.renderer.planet import Planet
from horizonval.renderer.plugin import camera_plugin
from horizonval.renderer.plugin.image import render_bands
from horizonval.renderer.plugin.model_text import dump_model, load_model
from horizonval.renderer.refraction.apparent_radius import ApparentRadiusAir, to_apparent_radius
from horizonval.renderer.refraction.bending import BendingField
from horizonval.renderer.scattering.multiple_scattering import STANDARD
from horizonval.renderer.thermal.emission_columns import AirColumns
from horizonval.renderer.thermal.emission_table import ThermalAir
from horizonval.renderer.types import constant, constant_vector

PLUGIN = "horizon_limb"
_KEPT_MODELS = 4


@dataclass(frozen=True)
class _Prepared:
    """A model as the march takes it; with refraction over apparent heights, and its apparent planet."""

    model: OpticalModel
    planet: Planet
    batches: list[tuple[list[SpectralNode], SolarNodes | ThermalNodes]]
    thermal: list[ThermalAir]
    air: ApparentRadiusAir | None
    bending: BendingField | None


_prepared: OrderedDict[tuple[str, Planet, str], _Prepared] = OrderedDict()


def limb_properties(
    model: OpticalModel,
    planet: Planet,
    sun_itrs: tuple[float, float, float],
    sun_angular_radius_rad: float,
    subsamples: int,
    nodes: int,
    orders: str,
    ground: GroundModel | None = None,
    moon: dict[str, Any] | None = None,
    sunless: bool = False,
) -> dict[str, Any]:
    """Return the plugin's properties.

    ``orders`` of scattering are "single" or "all". Without ``ground`` the model's albedo is all there is.
    ``moon``: ``direction_itrs`` (from the camera), ``angular_radius_rad``, ``to_sun_itrs`` (unit vector from the Moon),
    ``light_itrs`` (unit vector from the Earth's centre), ``nearness`` and ``lights_earth``; see
    :class:`horizonval.renderer.kernel.cells.MoonInFrame`. ``sunless``: see its ``FrameGeometry``.
    """
    sun = {"direction_itrs": list(sun_itrs), "angular_radius_rad": sun_angular_radius_rad}
    return {
        **({} if ground is None else {"ground": dump_ground(ground)}),
        "type": PLUGIN,
        "planet": json.dumps({"a_m": planet.a_m, "b_m": planet.b_m}),
        "model": dump_model(model),
        "sun": json.dumps(sun),
        "moon": json.dumps(moon),
        "sunless": sunless,
        "subsamples": subsamples,
        "nodes": nodes,
        "orders": orders,
    }


def register_plugins() -> None:
    """Register integrator and camera with the active variant."""
    limb, camera = _make_plugin(), camera_plugin.make_plugin()
    mi.register_integrator(PLUGIN, lambda props: limb(props))
    mi.register_sensor(camera_plugin.PLUGIN, lambda props: camera(props))


def prepare(properties: dict[str, Any], progress: Progress | None = None) -> None:
    """Make the tables of :func:`limb_properties` now, telling about those that take long."""
    planet = json.loads(properties["planet"])
    _prepare(properties["model"], Planet(planet["a_m"], planet["b_m"]), properties["orders"], progress)


def _moon(moon: dict[str, Any] | None) -> MoonInFrame | None:
    if moon is None:
        return None
    radius = constant(moon["angular_radius_rad"])
    disc = Disc(constant_vector(moon["direction_itrs"]), radius, constant_vector(moon["to_sun_itrs"]))
    return MoonInFrame(disc, float(moon["nearness"]), constant_vector(moon["light_itrs"]), bool(moon["lights_earth"]))


def _prepare(text: str, planet: Planet, orders: str, progress: Progress | None = None) -> _Prepared:
    """Return a model and its kernel tables; those of the last few models stay, suites repeat them."""
    key = (text, planet, orders)
    if key not in _prepared:
        model, air, bending = load_model(text), None, None
        if model.refractivity is not None:
            air = to_apparent_radius(model, planet)
            model, bending = air.model, BendingField.of(air)
        apparent = planet if air is None else air.planet
        scattering = STANDARD if orders == "all" else None
        batches = list(make_batches(model, apparent, IMAGE_TABLE, scattering, progress, air))
        thermal = [ThermalAir.of(b, model.emission, AirColumns.of(b, air)) for b in model.thermal if model.emission]
        _prepared[key] = _Prepared(model, apparent, batches, thermal, air, bending)
        if len(_prepared) > _KEPT_MODELS:
            _prepared.popitem(last=False)
    _prepared.move_to_end(key)
    return _prepared[key]


def _make_plugin() -> type:
    class HorizonLimb(mi.SamplingIntegrator):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            planet = json.loads(props.get("planet"))
            self.planet = Planet(planet["a_m"], planet["b_m"])
            self.prepared = _prepare(props.get("model"), self.planet, str(props.get("orders", "all")))
            sun = json.loads(props.get("sun"))
            self.sun_itrs = tuple(sun["direction_itrs"])
            self.sun_radius = float(sun["angular_radius_rad"])
            self.moon = json.loads(props.get("moon", "null"))
            self.sunless = bool(props.get("sunless", False))
            self.subsamples = int(props.get("subsamples", 2))
            self.nodes = int(props.get("nodes", 64))
            self.ground = load_ground(props.get("ground")) if "ground" in props else None
            self.bands = list(self.prepared.model.bands)

        def view(self, sensor: Any) -> FrameGeometry:
            """Return the geometry of a frame taken by a ``horizon_camera``, refraction left out."""
            origin: Any = tuple(float(v) for v in sensor.r_itrs)
            return FrameGeometry(
                sensor.rays,
                sensor.camera.width,
                sensor.camera.height,
                constant_vector(origin),
                constant_vector(self.sun_itrs),
                constant(self.sun_radius),
                self.planet,
                self.prepared.model.top_m,
                self.subsamples,
                make_ground(self.ground, self.planet, origin) if self.ground else None,
                _moon(self.moon),
                self.sunless,
                self.prepared.model.glow_top_m,
            )

        def apparent_view(self, sensor: Any) -> FrameGeometry:
            """Return the geometry in which light goes straight."""
            view, air = self.view(sensor), self.prepared.air
            if air is None:
                return view
            x, y, z = (dr.opaque(mi.Float64, v[0], 1) for v in air.apparent_position(view.origin))
            return replace(view, planet=air.planet, origin=(x, y, z), bending=self.prepared.bending)

        def render(
            self,
            scene: Any,
            sensor: Any = 0,
            seed: Any = 0,
            spp: int = 0,
            develop: bool = True,
            evaluate: bool = True,
        ) -> Any:
            if isinstance(sensor, int):
                sensor = scene.sensors()[sensor]
            if not hasattr(sensor, "rays"):
                raise TypeError(f"{PLUGIN} needs a {camera_plugin.PLUGIN} sensor")
            prepared = self.prepared
            bands = render_bands(
                self.apparent_view(sensor),
                prepared.batches,
                self.bands,
                self.nodes,
                prepared.thermal,
                prepared.model.emission,
            )
            stack = np.stack([np.array(bands[b], dtype=np.float32) for b in self.bands], axis=-1)
            return mi.TensorXf(stack.reshape(sensor.camera.height, sensor.camera.width, len(self.bands)))

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            raise NotImplementedError(f"{PLUGIN} renders whole frames; use mi.render")

        def aov_names(self) -> list[str]:
            return []

        def to_string(self) -> str:
            return f"HorizonLimb[bands={self.bands}, nodes={self.nodes}, subsamples={self.subsamples}]"

    return HorizonLimb
