"""Derivatives of a frame by the camera's attitude and position: the chain rule, ray by ray.

The gradient of a ray's radiance by its direction comes from forward differentiation of what the frame's cells read
(two directions across the ray), everything else of pose from geometry::

    attitude:  dd/dtheta_k = e_k x d            position:  dL/do_k = S_k - grad_d L . delta_k   (see transport)

S is marched, differentiated, on patches of splines that are as coarse as it allows (``view_table.patch_table``).
A cell on the hard edge is ``c L_ground + (1 - c) L_limb``: its share and its rays move with the edge.

Left out: jumps, of which a frame has where a cell begins or ceases to be cut by the hard edge, where land meets water
and where clouds end; the discs of Sun and Moon.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.renderer.derivatives.edge_motion import CELL_SHARE, EdgeMotion, edge_motion
from horizonval.renderer.derivatives.frame_rays import FrameRays
from horizonval.renderer.derivatives.parameters import POSE, ROTATIONS, SHIFTS, displaced, level_axes
from horizonval.renderer.derivatives.ray_slopes import slopes
from horizonval.renderer.derivatives.transport import level_transport
from horizonval.renderer.derivatives.vectors import cross, scaled
from horizonval.renderer.derivatives.whole_frames import Images
from horizonval.renderer.kernel.cells import Cells, CutPixels, Rays, group_cells
from horizonval.renderer.kernel.frame_geometry import FrameGeometry
from horizonval.renderer.kernel.ray_coordinates import RayCoordinates
from horizonval.renderer.kernel.rays import RayCamera
from horizonval.renderer.planet import distance_squared, dot
from horizonval.renderer.plugin.settings import CameraSettings
from horizonval.renderer.tables import vectors
from horizonval.renderer.types import Values, Vec, constant_vector, indices_where, inverse_root
from horizonval.renderer.view_table.patch_table import PACKET, PatchTable, Tabulated

SLOW_ERROR = 3e-4
"""Error that S may have between every second node of its table, as a share of the largest derivative by position.
Where S is smooth it then has a sixteenth of it between all nodes."""
LEAST_ELEVATION_RAD = 1e-4
"""A ray that just touches the ground ends there with an infinite slope."""


@dataclass(frozen=True)
class PoseFrame:
    """A frame to be differentiated by pose. ``view`` is that of light that goes straight."""

    integrator: Any
    camera: CameraSettings
    ellipsoid: Ellipsoid
    view: FrameGeometry
    cells: Cells
    rays: FrameRays

    @classmethod
    def of(cls, integrator: Any, camera: CameraSettings, ellipsoid: Ellipsoid) -> PoseFrame:
        """Build from the integrator of a frame and its camera."""
        view = integrator.apparent_view(_sensor(camera))
        cells = group_cells(view, outlines=False)
        settings = integrator.settings
        digest = settings.tables_digest if settings.method == "table" else None
        rays = FrameRays(integrator.prepared, view, cells, settings.nodes, digest)
        return cls(integrator, camera, ellipsoid, view, cells, rays)

    def view_at(self, parameter: str, step: float) -> FrameGeometry:
        """Return the geometry from a displaced pose."""
        return self.integrator.apparent_view(_sensor(displaced(self.camera, self.ellipsoid, parameter, step)))

    def derivatives(self) -> tuple[dict[str, Images], tuple[str, ...]]:
        """Return the derivatives of every band by the parameters of :data:`POSE`, and what of the frame is left out.

        Float64 images of shape (H, W).
        """
        cells = self.cells
        totals = {p: [dr.zeros(mi.Float64, cells.count) for _ in self.rays.bands] for p in POSE}
        groups = [(rays, to_ground) for rays, to_ground in ((cells.ground, True), (cells.limb, False)) if rays.count]
        for rays, to_ground in groups:
            self._add_group(totals, rays, to_ground)
        scale = [
            max(*(float(np.abs(np.array(cells.image(totals[p][b]))).max()) for p in SHIFTS), 1e-300)
            for b in range(len(self.rays.bands))
        ]
        for rays, to_ground in groups:
            self._add_slow(totals, rays, to_ground, scale)
        shape = self.view.height, self.view.width

        def image(total: mi.Float64) -> FloatArray:
            return np.array(cells.image(total), dtype=np.float64).reshape(shape)

        images = {p: dict(zip(self.rays.bands, map(image, bands), strict=True)) for p, bands in totals.items()}
        return images, self.left_out()

    def _largest(self, totals: Values) -> float:
        images = [np.abs(np.array(self.cells.image(total))).max() for total in totals]
        return max(float(max(images)), 1e-300)

    def left_out(self) -> tuple[str, ...]:
        """Return what this frame has that jumps, and whose derivative is left out."""
        ground, cells = self.view.ground, self.cells
        present = {
            "coasts": ground is not None and ground.table is not None,
            "edges of clouds": ground is not None and ground.clouds is not None,
            "the Sun's disc": cells.sun is not None,
            "the Moon's disc": cells.moon is not None and bool(self.rays.prepared.batches),
        }
        return tuple(what for what, there in present.items() if there)

    def _motions(self, slot: mi.UInt32) -> dict[str, EdgeMotion]:
        """Return the motion of cells on the hard edge, by parameter."""
        view, half = self.view, 0.5 / self.view.subsamples
        u, v = CutPixels(view, self.cells.kinds).centre(slot)
        across = distance_squared(view.rays.direction(u + half, v), view.rays.direction(u - half, v))
        angle = math.sqrt(float(dr.mean(across)[0])) * CELL_SHARE
        o1 = view.planet.stretch(view.origin)
        distance = math.sqrt(max(float(dot(o1, o1)[0]) - view.planet.a_m**2, 1e6))
        steps = dict.fromkeys(ROTATIONS, angle) | dict.fromkeys(SHIFTS, angle * distance)
        return {p: edge_motion(partial(self.view_at, p), u, v, steps[p]) for p in POSE}

    def _add_group(self, totals: dict[str, Values], rays: Rays, to_ground: bool) -> None:
        view, d = self.view, rays.direction
        inside = self._inside(to_ground)
        basis = _across(d)
        gradient_by = [(None, t) for t in basis]
        value, gradient = slopes(partial(self.rays.looked, to_ground=to_ground), view.origin, d, gradient_by)
        cut = indices_where((rays.share > 0.0) & (rays.share < 1.0))
        motions = self._motions(dr.gather(mi.UInt32, rays.slot, cut)) if dr.width(cut) else {}
        axes = self._steps()
        for k, parameter in enumerate(POSE):
            turn = parameter in ROTATIONS
            if turn:
                change = cross(constant_vector(self.camera.itrs_from_cam[:, k]), d)
            else:
                change = scaled(level_transport(view.planet, view.origin, d, axes[k - 3], to_ground, inside), -1.0)
            wider = dr.zeros(mi.Float64, rays.count)
            if motions:
                motion = motions[parameter]
                dr.scatter(wider, motion.share if to_ground else -motion.share, cut)
                change = _with_edges(change, motion.inner if to_ground else motion.outer, cut, instead=turn)
            along = [dot(change, t) for t in basis]
            for b in range(len(self.rays.bands)):
                slope = gradient[0][b] * along[0] + gradient[1][b] * along[1]
                total = rays.share * slope + wider * value[b]
                dr.scatter_add(totals[parameter][b], total, rays.slot, mode=dr.ReduceMode.NoConflicts)
            # ground and limb share edge cells: two launches
            dr.eval(totals[parameter])

    def _add_slow(self, totals: dict[str, Values], rays: Rays, to_ground: bool, scale: Sequence[float]) -> None:
        slow = self._slow(rays.direction, to_ground, scale)
        for k, parameter in enumerate(SHIFTS):
            for b, total in enumerate(totals[parameter]):
                value = rays.share * slow[k * len(self.rays.bands) + b]
                dr.scatter_add(total, value, rays.slot, mode=dr.ReduceMode.NoConflicts)
            dr.eval(totals[parameter])

    def _inside(self, to_ground: bool) -> bool:
        return not to_ground and self._coordinates().inside

    def _coordinates(self) -> RayCoordinates:
        origin = np.array([float(c[0]) for c in self.view.origin])
        return RayCoordinates.of(self.view.planet, origin, self.view.highest_m)

    def _steps(self) -> FloatArray:
        """Return how far the rays start from where they did, a metre east, north and up; among straight rays."""
        air = self.integrator.prepared.air
        return level_axes(self.camera.r_itrs, self.ellipsoid) * (1.0 if air is None else air.scale)

    def _slow(self, d: Vec, to_ground: bool, scale: Sequence[float]) -> Values:
        """Return S of rays: by direction of motion, then by band; ``scale``: the largest derivative of every band."""
        coordinates, view = self._coordinates(), self.view
        axis = coordinates.ground if to_ground else coordinates.limb
        place, azimuth = coordinates.place(view.origin, d, to_ground)
        x = place * (1.0 / (axis.count - 1))
        dr.eval(x, azimuth)
        steps = self._steps()

        def along(directions: Vec) -> list[Values]:
            inside = self._inside(to_ground)
            changes = [
                (
                    constant_vector(step),
                    level_transport(view.planet, view.origin, directions, step, to_ground, inside),
                )
                for step in steps
            ]
            total = [[dr.zeros(mi.Float64, dr.width(directions[0])) for _ in self.rays.bands] for _ in changes]
            for bands, radiance in self.rays.marched(to_ground):
                for by_band, more in zip(total, slopes(radiance, view.origin, directions, changes)[1], strict=True):
                    for band, slope in zip(bands, more, strict=True):
                        by_band[band] += slope
                dr.eval(total)
            return total

        def values(x: FloatArray, azimuth: FloatArray) -> FloatArray:
            v = axis.value(x)
            if to_ground:
                v = np.maximum(v, LEAST_ELEVATION_RAD)
            slow = along(vectors(coordinates.directions(v, azimuth, to_ground)))
            found = np.stack([np.array(band) for bands in slow for band in bands], axis=-1)
            return np.pad(found, ((0, 0), (0, -found.shape[1] % PACKET)))

        quantities = len(steps) * len(self.rays.bands)
        # coasts and clouds would cut the table down to its finest patches everywhere
        error = SLOW_ERROR if view.ground is None else math.inf
        allowed = error * np.array([*scale] * len(steps) + [1.0] * (-quantities % PACKET))
        packets = len(allowed) // PACKET
        table = PatchTable(Tabulated(values, lambda found: np.broadcast_to(allowed, found.shape), len(allowed)))
        table.cover(x, azimuth)
        slow = table.look(x, azimuth, range(packets))[:quantities]
        rough = table.rough(x, azimuth)
        dr.eval(slow)
        marched = mi.UInt32() if rough is None else indices_where(rough)
        if dr.width(marched):
            a, b, c = (dr.gather(mi.Float64, component, marched) for component in d)
            exact = [band for bands in along((a, b, c)) for band in bands]
            for replaced, value in zip(slow, exact, strict=True):
                dr.scatter(replaced, value, marched)
            dr.eval(slow)
        return slow


def _sensor(camera: CameraSettings) -> Any:
    """Return what the integrator asks of a sensor."""
    rays = RayCamera.of(camera.camera, camera.itrs_from_cam)
    return SimpleNamespace(rays=rays, camera=camera.camera, r_itrs=camera.r_itrs)


def _across(d: Vec) -> Sequence[Vec]:
    """Return two unit vectors across directions and each other."""
    flat = dr.abs(d[2]) < 0.9
    zero = dr.zeros(mi.Float64, dr.width(d[0]))
    helper = (dr.select(flat, zero, 1.0), zero, dr.select(flat, mi.Float64(1.0), 0.0))
    first = cross(helper, d)
    first = scaled(first, inverse_root(dot(first, first)))
    second = cross(d, first)
    dr.eval(first, second)
    return first, second


def _with_edges(change: Vec, moved: Vec, cut: mi.UInt32, instead: bool) -> Vec:
    """Return changes of directions with those of edge cells added, or in their place."""
    out = []
    for component, motion in zip(change, moved, strict=True):
        full = component + 0.0
        dr.eval(full)
        dr.scatter(full, motion if instead else dr.gather(mi.Float64, full, cut) + motion, cut)
        out.append(full)
    return out[0], out[1], out[2]
