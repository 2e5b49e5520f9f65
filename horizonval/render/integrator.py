"""``horizon_limb``: the deterministic limb march as a Mitsuba integrator plugin.

``mi.render`` on a scene with this integrator and a ``horizon_camera`` returns a tensor (height, width, bands): radiance
in W m-2 sr-1 per band. It makes its own Float64 rays and ignores sample count and seed, because nothing is random.
"""

from __future__ import annotations

import json
from collections import OrderedDict
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.earth.column import OpticalModel, SpectralNode
from horizonval.render import camera_plugin
from horizonval.render.chunks import IMAGE_TABLE, TableProgress, make_chunks
from horizonval.render.image import View, render_bands
from horizonval.render.march import Chunk
from horizonval.render.model_text import dump_model, load_model
from horizonval.render.multiple_scattering import STANDARD
from horizonval.render.planet import Planet

PLUGIN = "horizon_limb"
_KEPT_MODELS = 4
_Key = tuple[str, Planet, str]
_chunks: OrderedDict[_Key, list[tuple[list[SpectralNode], Chunk]]] = OrderedDict()


def limb_properties(
    model: OpticalModel,
    planet: Planet,
    sun_itrs: tuple[float, float, float],
    sun_angular_radius_rad: float,
    subsamples: int,
    nodes: int,
    orders: str,
) -> dict[str, Any]:
    """Return the plugin's properties; ``orders`` of scattering are "single" or "all"."""
    sun = {"direction_itrs": list(sun_itrs), "angular_radius_rad": sun_angular_radius_rad}
    return {
        "type": PLUGIN,
        "planet": json.dumps({"a_m": planet.a_m, "b_m": planet.b_m}),
        "model": dump_model(model),
        "sun": json.dumps(sun),
        "subsamples": subsamples,
        "nodes": nodes,
        "orders": orders,
    }


def register_plugins() -> None:
    """Register integrator and camera with the active variant."""
    limb, camera = _make_plugin(), camera_plugin.make_plugin()
    mi.register_integrator(PLUGIN, lambda props: limb(props))
    mi.register_sensor(camera_plugin.PLUGIN, lambda props: camera(props))


def prepare(properties: dict[str, Any], progress: TableProgress | None = None) -> None:
    """Make the tables of :func:`limb_properties` now, telling about those that take long."""
    planet = json.loads(properties["planet"])
    _cached_chunks(properties["model"], Planet(planet["a_m"], planet["b_m"]), properties["orders"], progress)


def _cached_chunks(
    text: str, planet: Planet, orders: str, progress: TableProgress | None = None
) -> tuple[OpticalModel, list[tuple[list[SpectralNode], Chunk]]]:
    """Return a model and its kernel tables; those of the last few models stay, suites repeat them."""
    model = load_model(text)
    key = (text, planet, orders)
    if key not in _chunks:
        scattering = STANDARD if orders == "all" else None
        _chunks[key] = list(make_chunks(model, planet, IMAGE_TABLE, scattering, progress))
        if len(_chunks) > _KEPT_MODELS:
            _chunks.popitem(last=False)
    _chunks.move_to_end(key)
    return model, _chunks[key]


def _make_plugin() -> type:
    class HorizonLimb(mi.SamplingIntegrator):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            planet = json.loads(props.get("planet"))
            self.planet = Planet(planet["a_m"], planet["b_m"])
            self.model, self.chunks = _cached_chunks(props.get("model"), self.planet, str(props.get("orders", "all")))
            sun = json.loads(props.get("sun"))
            self.sun_itrs = tuple(sun["direction_itrs"])
            self.sun_radius = float(sun["angular_radius_rad"])
            self.subsamples = int(props.get("subsamples", 2))
            self.nodes = int(props.get("nodes", 64))
            self.bands = list(dict.fromkeys(n.band for n in self.model.nodes))

        def view(self, sensor: Any) -> View:
            """Return the geometry of a frame taken by a ``horizon_camera``."""
            return View(
                sensor.rays,
                sensor.camera.width,
                sensor.camera.height,
                tuple(dr.opaque(mi.Float64, float(v), 1) for v in sensor.r_itrs),  # type: ignore[arg-type]
                tuple(dr.opaque(mi.Float64, float(v), 1) for v in self.sun_itrs),  # type: ignore[arg-type]
                dr.opaque(mi.Float64, self.sun_radius, 1),
                self.planet,
                self.model.top_m,
                self.subsamples,
            )

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
            bands = render_bands(self.view(sensor), self.chunks, self.bands, self.nodes)
            stack = np.stack([np.array(bands[b], dtype=np.float32) for b in self.bands], axis=-1)
            return mi.TensorXf(stack.reshape(sensor.camera.height, sensor.camera.width, len(self.bands)))

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            raise NotImplementedError(f"{PLUGIN} renders whole frames; use mi.render")

        def aov_names(self) -> list[str]:
            return []

        def to_string(self) -> str:
            return f"HorizonLimb[bands={self.bands}, nodes={self.nodes}, subsamples={self.subsamples}]"

    return HorizonLimb
