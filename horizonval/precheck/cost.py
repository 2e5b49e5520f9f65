"""What a run will cost in processor time, memory and disk, counted before anything is rendered.

**Basis.** Solar bands are marched cell by cell; a cell is a pixel's share that sees ground or air, once for the ground
and once for the air where the hard limb cuts it. Time goes with ``cells x nodes along the ray x spectral nodes``.
Multiple scattering needs a table for every spectral node of every column of air, kept in the cache of the machine:
whether it is there is not looked up, so its time stands by itself, "if not kept from an earlier run". Thermal bands
come from tables whose time goes with ``g points x nodes`` and hardly with the pixels. The constants were measured with
the LLVM back-end on x86-64 at 2 to 3 GHz as seconds of processor time, which other work on the machine changes little.

**How far off.** Processor time within a factor of two on such a machine (three on others), not counting the tables;
memory within 1.5; disk within 1.5 for the 16-bit images and float frames of the archive, whose compression hangs on the
noise. What an estimator takes is known for ours only, and to a factor of three.

Left out: the report's pages (a few seconds), the start of the processes, clouds (up to three times a solar frame's
time), refraction, moonlight and airglow (each a march of its own).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from horizonval.earth.atmosphere.air import TOP_M
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import camera_from_spec, unproject
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.geometry.frames import inverse, rotate
from horizonval.spec.scene import SceneSpec
from horizonval.spec.sensor.camera import CameraSpec

SOLAR_S_PER_EVALUATION = 7.0e-9
SOLAR_FRAME_S = 0.5
SCATTERING_TABLE_S = 2.5
THERMAL_S_PER_EVALUATION = 1.4e-4
"""Of a g point and a node along the ray."""
THERMAL_FRAME_S = 0.5
OBSERVE_S_PER_PIXEL = 1.2e-7
ESTIMATE_S, ESTIMATE_S_PER_PIXEL = 0.1, 5e-7
MEMORY_MB, MEMORY_MB_PER_CELL = 250.0, 8e-5
FRAME_BYTES, FRAME_BYTES_PER_VALUE = 2e4, 2.1
IMAGE_BYTES, IMAGE_BYTES_PER_PIXEL = 2.5e4, 2.0
RECORD_BYTES = 1e4
TRUTH_MAPS = 4

_GRID = 48


@dataclass(frozen=True)
class FrameCost:
    """What one frame takes; see :class:`Cost`."""

    cells: float
    evaluations: float
    thermal_evaluations: float
    tables: int
    render_s: float
    observe_s: float
    estimate_s: float
    memory_mb: float
    frame_bytes: float
    image_bytes: float


@dataclass(frozen=True)
class Cost:
    """What a run takes.

    Attributes
    ----------
    frames : int
    cells : float
        Cells of all frames that see ground or air.
    evaluations : float
        Of the march: cells x nodes along the ray x spectral nodes.
    render_s, observe_s, estimate_s : float
        Processor time of all frames.
    tables : int
        Tables of multiple scattering that must exist.
    tables_s : float
        Processor time if none of them is kept from an earlier run.
    memory_mb : float
        Of one process with the largest frame.
    disk_mb : float
        Of the archive and records.
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


def marched_cells(truth: FrameTruth, camera: CameraSpec, subsamples: int) -> float:
    """Return how many cells of a frame see ground or air.

    Counted on a grid of 48 x 48 pixels at most, to one part in fifty of the image.
    """
    geometry = camera_from_spec(camera.camera)
    columns = np.linspace(0, geometry.width - 1, min(geometry.width, _GRID))
    rows = np.linspace(0, geometry.height - 1, min(geometry.height, _GRID))
    uv = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    d_cam = unproject(geometry, uv)
    seen = np.isfinite(d_cam).all(axis=-1)
    itrs = np.array(truth.r_itrs)
    d = rotate(inverse(truth.q_cam_from_itrs), d_cam[seen])
    ellipsoid = Ellipsoid(truth.ellipsoid_a_m, truth.ellipsoid_b_m)
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
    """Return what one frame takes.

    Parameters
    ----------
    truth : FrameTruth
    scene, camera
        Resolved specifications.
    spectral : dict of str to int
        Spectral nodes or g points of every band (:func:`horizonval.earth.optical.node_counts`).
    estimators : int
        How many see each image.
    """
    geometry = camera.camera
    pixels, cells = geometry.width * geometry.height, marched_cells(truth, camera, scene.render.subsamples)
    kinds = {band.name: band.kind for band in camera.band}
    solar = sum(count for band, count in spectral.items() if kinds[band] == "solar")
    thermal = sum(count for band, count in spectral.items() if kinds[band] == "thermal")
    evaluations = cells * scene.render.nodes * solar
    lit = thermal * scene.render.nodes if cells else 0
    render_s = SOLAR_S_PER_EVALUATION * evaluations + THERMAL_S_PER_EVALUATION * lit
    render_s += (SOLAR_FRAME_S if solar else 0.0) + (THERMAL_FRAME_S if thermal else 0.0)
    images = 0 if camera.detector is None else len(camera.band)
    return FrameCost(
        cells=cells,
        evaluations=evaluations,
        thermal_evaluations=lit,
        tables=solar if scene.render.orders == "all" and not _airless(scene) else 0,
        render_s=render_s,
        observe_s=OBSERVE_S_PER_PIXEL * pixels * images,
        estimate_s=(ESTIMATE_S + ESTIMATE_S_PER_PIXEL * pixels) * images * estimators,
        memory_mb=MEMORY_MB + MEMORY_MB_PER_CELL * pixels * scene.render.subsamples**2,
        frame_bytes=FRAME_BYTES + FRAME_BYTES_PER_VALUE * pixels * (len(camera.band) + TRUTH_MAPS),
        image_bytes=(IMAGE_BYTES + IMAGE_BYTES_PER_PIXEL * pixels) * images,
    )


def _airless(scene: SceneSpec) -> bool:
    atmosphere = scene.atmosphere
    return atmosphere.file is None and atmosphere.profile_file is None and atmosphere.profile == "none"


def column_key(scene: SceneSpec, camera: CameraSpec) -> tuple[Any, ...]:
    """Return what the tables of multiple scattering hang on: equal keys share theirs."""
    place: tuple[Any, ...] = ()
    if scene.atmosphere.profile == "by_latitude_month" and scene.atmosphere.latitude_deg is None:
        place = (scene.scene.name,)
    radius = scene.earth.model_dump_json()
    return scene.atmosphere.model_dump_json(), radius, json_of_bands(camera), scene.render.band_error, place


def json_of_bands(camera: CameraSpec) -> str:
    """Return a camera's bands as text."""
    return "".join(band.model_dump_json() for band in camera.band)
