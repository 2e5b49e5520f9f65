"""``horizon_limb``: the deterministic limb march as a Mitsuba integrator plugin.

``mi.render`` on a scene with this integrator and a ``horizon_camera`` returns a tensor (height, width, channels): the
radiance of every band, then the energy radiance of every solar band, in W m-2 sr-1
(:mod:`horizonval.earth.spectral.bands`). It makes its own Float64 rays and ignores sample count and seed, because
nothing is random.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace
from typing import Any, NoReturn

import mitsuba as mi
import numpy as np

from horizonval.core.progress import Progress
from horizonval.earth.column import OpticalModel, SpectralNode
from horizonval.renderer.kernel.batching import IMAGE_TABLE, make_batches
from horizonval.renderer.kernel.discs import Disc
from horizonval.renderer.kernel.frame_geometry import FrameGeometry, MoonInFrame
from horizonval.renderer.kernel.gap_map import GapMap, gap_map
from horizonval.renderer.kernel.node_batches import SolarNodes
from horizonval.renderer.kernel.surface import make_ground
from horizonval.renderer.planet import Planet
from horizonval.renderer.plugin.image import render_bands
from horizonval.renderer.plugin.settings import LimbSettings, MoonSettings
from horizonval.renderer.refraction.apparent_radius import ApparentRadiusAir, to_apparent_radius
from horizonval.renderer.refraction.bending import BendingField
from horizonval.renderer.scattering.quality import for_images
from horizonval.renderer.thermal.emission_table import ThermalAir
from horizonval.renderer.types import constant, constant_vector

_KEPT_MODELS = 4


@dataclass(frozen=True)
class Prepared:
    """A model as the march takes it; with refraction over apparent heights, and its apparent planet."""

    model: OpticalModel
    planet: Planet
    batches: list[tuple[list[SpectralNode], SolarNodes]]
    thermal: list[ThermalAir]
    air: ApparentRadiusAir | None
    bending: BendingField | None


_prepared: OrderedDict[tuple[str, str | None], Prepared] = OrderedDict()
"""By digest of the settings and variant."""


def prepare(settings: LimbSettings, progress: Progress | None = None) -> Prepared:
    """Return a model and its kernel tables; those of the last few models stay, suites repeat them.

    Parameters
    ----------
    settings : LimbSettings
    progress : Progress, optional
        Told about tables that take long.
    """
    key = (settings.tables_digest, mi.variant())
    if key not in _prepared:
        _prepared[key] = _make_tables(settings, progress)
        if len(_prepared) > _KEPT_MODELS:
            _prepared.popitem(last=False)
    _prepared.move_to_end(key)
    return _prepared[key]


def _make_tables(settings: LimbSettings, progress: Progress | None) -> Prepared:
    model, planet, air, bending = settings.model, settings.planet, None, None
    if model.refractivity is not None:
        air = to_apparent_radius(model, planet)
        model, planet, bending = air.model, air.planet, BendingField.of(air)
    scattering = for_images(model) if settings.orders == "all" else None
    batches = list(make_batches(model, planet, IMAGE_TABLE, scattering, progress, air))
    thermal = [ThermalAir.of(b, model.emission, air, model.gaps) for b in model.thermal if model.emission]
    return Prepared(model, planet, batches, thermal, air, bending)


def _moon(moon: MoonSettings | None) -> MoonInFrame | None:
    if moon is None:
        return None
    radius = constant(moon.angular_radius_rad)
    disc = Disc(constant_vector(moon.direction_itrs), radius, constant_vector(moon.to_sun_itrs))
    return MoonInFrame(disc, moon.nearness, constant_vector(moon.light_itrs), moon.lights_earth)


def _gap_maps(model: OpticalModel, planet: Planet, origin: tuple[float, float, float]) -> tuple[GapMap | None, ...]:
    """Return the maps of a model's layers with gaps around the point below a camera."""
    if not model.has_gaps:
        return ()
    layers = zip(model.layers, model.gaps, strict=True)
    return tuple(None if gaps is None else gap_map(gaps, planet, origin, top) for (_, top), gaps in layers)


def make_plugin() -> type:
    """Return the integrator class for the active variant (its base class depends on the variant)."""

    class HorizonLimb(mi.SamplingIntegrator):
        def __init__(self, props: mi.Properties, settings: LimbSettings) -> None:
            super().__init__(props)
            self.settings = settings
            self.prepared = prepare(settings)
            self.bands = list(self.prepared.model.bands)
            thermal = {band.name for band in self.prepared.model.thermal}
            self.solar_bands = [band for band in self.bands if band not in thermal]

        def view(self, sensor: Any) -> FrameGeometry:
            """Return the geometry of a frame taken by a ``horizon_camera``, refraction left out."""
            x, y, z = (float(v) for v in sensor.r_itrs)
            settings, model = self.settings, self.prepared.model
            return FrameGeometry(
                sensor.rays,
                sensor.camera.width,
                sensor.camera.height,
                constant_vector((x, y, z)),
                constant_vector(settings.sun_itrs),
                constant(settings.sun_angular_radius_rad),
                settings.planet,
                model.top_m,
                settings.subsamples,
                make_ground(settings.ground, settings.planet, (x, y, z)) if settings.ground else None,
                _moon(settings.moon),
                settings.sunless,
                model.glow_top_m,
                gap_maps=_gap_maps(model, settings.planet, (x, y, z)),
                every_cell=settings.method == "march",
            )

        def apparent_view(self, sensor: Any) -> FrameGeometry:
            """Return the geometry in which light goes straight."""
            view, air = self.view(sensor), self.prepared.air
            if air is None:
                return view
            origin = constant_vector(v[0] for v in air.apparent_position(view.origin))
            return replace(view, planet=air.planet, origin=origin, bending=self.prepared.bending)

        def radiance(self, sensor: Any) -> tuple[dict[str, mi.Float64], dict[str, mi.Float64]]:
            """Return radiance per band and energy radiance per solar band, pixels in row order."""
            prepared = self.prepared
            return render_bands(
                self.apparent_view(sensor),
                prepared.batches,
                self.bands,
                self.settings.nodes,
                prepared.thermal,
                prepared.model.emission,
                self.settings.tables_digest if self.settings.method == "table" else None,
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
                raise TypeError("horizon_limb needs a horizon_camera sensor")
            radiance, energy = self.radiance(sensor)
            channels = [radiance[band] for band in self.bands] + [energy[band] for band in self.solar_bands]
            stack = np.stack([np.array(channel, dtype=np.float32) for channel in channels], axis=-1)
            return mi.TensorXf(stack.reshape(sensor.camera.height, sensor.camera.width, len(channels)))

        def sample(self, *arguments: object, **named: object) -> NoReturn:
            raise NotImplementedError("horizon_limb renders whole frames; use mi.render")

        def aov_names(self) -> list[str]:
            return []

        def to_string(self) -> str:
            return (
                f"HorizonLimb[bands={self.bands}, method={self.settings.method}, nodes={self.settings.nodes}, "
                f"subsamples={self.settings.subsamples}]"
            )

    return HorizonLimb
