"""Processor time, memory and disk of a run, counted before anything is rendered.

**Model.** Solar bands come from view tables, which are computed once for every position, Sun and air and evaluated in
every cell (a pixel's share that sees ground or air); or they are marched cell by cell, in a time proportional to
``cells x nodes along the ray x spectral nodes``. Multiple scattering needs a table for every spectral node of every
column of air. The cache may hold it already, so its time is stated separately. Thermal bands come from tables whose
time grows with the g points, a little with the nodes, and hardly with the pixels. The constants are seconds of
processor time of the LLVM back-end on two x86-64 processors, from six shipped scenes (2026-11-28).

**Accuracy.** On other machines and for other scenes a factor of three; disk within 1.5. The time of foreign estimators
is unknown.

**Neglected.** The first frame of a process (1 to 7 s of compiling), the report's pages (a few seconds), refraction and
airglow (more tables), and parts of the spacecraft (2 s from a new position, 0.4 s at another attitude).
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from horizonval.earth.atmosphere.air import TOP_M, WEATHER
from horizonval.earth.atmosphere.climate import BY_LATITUDE_MONTH
from horizonval.earth.atmosphere.profile_file import has_places
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import camera_from_spec, unproject
from horizonval.geometry.frames import inverse, rotate
from horizonval.jobs.pool import available_cpus
from horizonval.renderer.frame_cost import frame_bytes
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

SOLAR_S_PER_EVALUATION, SOLAR_FRAME_S = 1.1e-8, 0.03
CHUNK = 4
"""Spectral nodes that are computed together."""
TABLE_S_PER_LOOK, TABLE_S_PER_NODE, TWILIGHT_TABLES = 1e-7, 1.7e-3, 2.0
"""View tables: seconds per cell and per node along the rays, for a chunk of spectral nodes; factor in twilight."""
CLOUD_S_PER_LOOK, CLOUD_TABLES = 1.3e-6, 4.5
"""Seconds per cell that ends on a cloud, for a chunk of spectral nodes, and the factor of tables with clouds."""
TWILIGHT_RAD = math.radians(18.0)
"""Depression of the Sun below which no air is sunlit."""
SCATTERING_TABLE_S, PARTICLE_TABLE_S = 2.5, 6.0
"""Seconds of a table of air without and with particles, whose phase function has more moments."""
THERMAL_S_PER_POINT, THERMAL_S_PER_EVALUATION = 0.001, 4e-6
"""Seconds of a g point, and of each node along its rays."""
BY_LATITUDE = 2.5
"""Factor of thermal bands through air that changes with latitude."""
OBSERVE_S_PER_PIXEL = 1.2e-7
ESTIMATE_S, ESTIMATE_S_PER_PIXEL = 0.1, 5e-7
FRAME_BYTES, FRAME_BYTES_PER_VALUE, FRAME_BYTES_PER_THERMAL_VALUE = 2e4, 0.65, 3.4
"""Bytes of a frame, a value of radiance or a truth map, and a value of thermal radiance; twice that with clouds."""
IMAGE_BYTES, IMAGE_BYTES_PER_PIXEL, IMAGE_BYTES_PER_FINE_PIXEL = 1.5e4, 0.7, 2.3
"""Bytes of an image, of a pixel of up to 11 bits, and of one with more."""
RECORD_BYTES = 1e4
TRUTH_MAPS = 4

_GRID = 48


@dataclass(frozen=True)
class FrameCost:
    """Cost of one frame; see :class:`Cost`."""

    cells: float
    evaluations: float
    tables: int
    tables_s: float
    render_s: float
    view_tables_s: float
    observe_s: float
    estimate_s: float
    memory_mb: float
    frame_bytes: float
    image_bytes: float


@dataclass(frozen=True)
class Cost:
    """Cost of a run: processor times of all frames, memory and disk.

    ``cells``: cells of all frames that see ground or air. ``evaluations``: of a march, cells x nodes along the ray x
    spectral nodes. ``render_s`` counts view tables once for every position, Sun and air. ``tables``: tables of multiple
    scattering; ``tables_s``: their time without the cache. ``memory_mb``: one process with the largest frame.
    ``disk_mb``: archive and records.
    """

    frames: int
    cells: float
    evaluations: float
    render_s: float
    observe_s: float
    estimate_s: float
    tables: int
    tables_s: float
    memory_mb: float
    disk_mb: float

    @property
    def processor_s(self) -> float:
        """Processor time without the tables."""
        return self.render_s + self.observe_s + self.estimate_s

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self) | {"processor_s": self.processor_s}


def cost_lines(cost: Cost) -> list[str]:
    """Return what a run takes on all processors of this machine, a line or two."""
    processors = available_cpus()
    frames = f"{cost.frames} frame{'s' if cost.frames != 1 else ''}"
    lines = [
        f"cost: {frames}, about {_time(cost.processor_s / processors)} on {processors} processors "
        f"(to a factor of three), {_size(cost.memory_mb)} a process, {_size(cost.disk_mb)} on disk"
    ]
    if cost.tables:
        lines.append(
            f"      and up to {_time(cost.tables_s / processors)} for {cost.tables} tables of multiple scattering that "
            "no earlier run has left in the cache"
        )
    return lines


def _time(seconds: float) -> str:
    """Return a time as text, to two digits."""
    if seconds < 90:
        return f"{float(f'{seconds:.2g}'):g} s"
    return f"{float(f'{seconds / 60:.2g}'):g} min" if seconds < 5400 else f"{float(f'{seconds / 3600:.2g}'):g} h"


def _size(megabytes: float) -> str:
    """Return a size as text, to two digits."""
    return f"{float(f'{megabytes:.2g}'):g} MB" if megabytes < 950 else f"{float(f'{megabytes / 1000:.2g}'):g} GB"


def marched_cells(truth: FrameTruth, camera: CameraSpec, subsamples: int) -> float:
    """Return the number of cells that see ground or air, from at most 48 x 48 pixels, to 1/50 of the image."""
    geometry = camera_from_spec(camera.camera)
    columns = np.linspace(0, geometry.width - 1, min(geometry.width, _GRID))
    rows = np.linspace(0, geometry.height - 1, min(geometry.height, _GRID))
    uv = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    d_cam = unproject(geometry, uv)
    seen = np.isfinite(d_cam).all(axis=-1)
    itrs = np.array(truth.r_itrs)
    d = rotate(inverse(truth.q_cam_from_itrs), d_cam[seen])
    ellipsoid = truth.ellipsoid
    # The ellipsoid raised by the air's height differs from equal heights by metres.
    axes = ellipsoid.axes_m + TOP_M
    o, d = itrs / axes, d / axes
    nearest = -(d @ o) / (d * d).sum(axis=-1)
    miss = np.linalg.norm(o + nearest[:, None] * d, axis=-1)
    inside = bool(o @ o < 1.0)
    share = float(((miss < 1.0) & ((nearest > 0.0) | inside)).sum()) / len(uv)
    return share * geometry.width * geometry.height * subsamples**2


def frame_cost(
    truth: FrameTruth, scene: SceneSpec, camera: CameraSpec, spectral: dict[str, int], estimators: int
) -> FrameCost:
    """Return the cost of one frame; ``estimators`` see each image.

    ``spectral``: spectral nodes or g points of every band (:func:`horizonval.earth.optical.node_counts`).
    """
    geometry = camera.camera
    pixels, cells = geometry.width * geometry.height, marched_cells(truth, camera, scene.render.subsamples)
    kinds = {band.name: band.kind for band in camera.band}
    solar = sum(count for band, count in spectral.items() if kinds[band] == "solar")
    thermal = sum(count for band, count in spectral.items() if kinds[band] == "thermal")
    evaluations = cells * scene.render.nodes * solar
    by_latitude = thermal and _by_place(scene)
    per_point = THERMAL_S_PER_POINT + THERMAL_S_PER_EVALUATION * scene.render.nodes
    chunks = -(-solar // CHUNK)
    tabulated = scene.render.method == "table"
    cover = 0.0 if scene.clouds is None else scene.clouds.expected_cover
    looks_s = (TABLE_S_PER_LOOK + CLOUD_S_PER_LOOK * cover) * cells * chunks
    render_s = looks_s if tabulated else SOLAR_S_PER_EVALUATION * evaluations
    render_s += SOLAR_FRAME_S if solar else 0.0
    render_s += per_point * thermal * (BY_LATITUDE if by_latitude else 1.0) if cells else 0.0
    tables = solar if scene.render.orders == "all" and not _airless(scene) else 0
    particles = scene.atmosphere.aerosol != "none" or scene.atmosphere.file is not None or bool(scene.layer)
    images = 0 if camera.detector is None else len(camera.band)
    return FrameCost(
        cells=cells,
        evaluations=evaluations,
        tables=tables,
        tables_s=tables
        * (PARTICLE_TABLE_S if particles else SCATTERING_TABLE_S)
        * (LAYERED_TABLES if scene.layer or scene.atmosphere.aerosol.startswith("volcanic") else 1.0),
        render_s=render_s,
        view_tables_s=_view_tables_s(truth, scene.render.nodes * chunks, cover > 0.0) if tabulated and cells else 0.0,
        observe_s=OBSERVE_S_PER_PIXEL * pixels * images,
        estimate_s=(ESTIMATE_S + ESTIMATE_S_PER_PIXEL * pixels) * images * estimators,
        memory_mb=frame_bytes(scene, camera, thermal if by_latitude else 0) / 1e6,
        frame_bytes=FRAME_BYTES + pixels * _bytes_per_pixel(scene, camera),
        image_bytes=(IMAGE_BYTES + _image_bytes_per_pixel(camera) * pixels) * images,
    )


LAYERED_TABLES = 5.0
"""Factor of multiple scattering with layers of thin cloud, compared with haze."""


def _view_tables_s(truth: FrameTruth, nodes: int, clouds: bool) -> float:
    """Return the processor time of view tables of ``nodes`` nodes in all chunks, with those of air before clouds."""
    distance_m = math.hypot(*truth.r_itrs)
    zenith = math.acos(np.clip(np.dot(truth.r_itrs, truth.sun_itrs) / distance_m, -1.0, 1.0))
    horizon = math.acos(min(truth.ellipsoid_b_m / distance_m, 1.0))
    shadow = zenith + horizon > math.pi / 2 and zenith - horizon < math.pi / 2 + TWILIGHT_RAD
    return TABLE_S_PER_NODE * nodes * (TWILIGHT_TABLES if shadow else 1.0) * (CLOUD_TABLES if clouds else 1.0)


def _bytes_per_pixel(scene: SceneSpec, camera: CameraSpec) -> float:
    thermal = sum(band.kind == "thermal" for band in camera.band)
    smooth = FRAME_BYTES_PER_VALUE * (len(camera.band) - thermal + TRUTH_MAPS)
    clouds = 2.0 if scene.clouds is not None else 1.0
    return smooth * clouds + FRAME_BYTES_PER_THERMAL_VALUE * thermal


def _image_bytes_per_pixel(camera: CameraSpec) -> float:
    fine = camera.detector is not None and camera.detector.bits > 11
    return IMAGE_BYTES_PER_FINE_PIXEL if fine else IMAGE_BYTES_PER_PIXEL


def _airless(scene: SceneSpec) -> bool:
    atmosphere = scene.atmosphere
    return atmosphere.file is None and atmosphere.profile_file is None and atmosphere.profile == "none"


def _by_place(scene: SceneSpec) -> bool:
    """Return whether the air varies with position: profiles of many positions cost as much as weather."""
    atmosphere = scene.atmosphere
    if atmosphere.profile_file is not None:
        return has_places(atmosphere.profile_file)
    return atmosphere.file is None and atmosphere.profile in (BY_LATITUDE_MONTH, WEATHER)


def column_key(scene: SceneSpec, camera: CameraSpec) -> tuple[Any, ...]:
    """Return the key of the tables of multiple scattering; equal keys share tables."""
    place: tuple[Any, ...] = ()
    if _by_place(scene) and scene.atmosphere.latitude_deg is None:
        place = (scene.scene.name,)
    radius = scene.earth.model_dump_json()
    return scene.atmosphere.model_dump_json(), radius, json_of_bands(camera), scene.render.band_error, place


def json_of_bands(camera: CameraSpec) -> str:
    """Return a camera's bands as text."""
    return "".join(band.model_dump_json() for band in camera.band)
