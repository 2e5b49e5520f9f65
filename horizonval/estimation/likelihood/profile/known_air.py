r"""The air that a fit leans on: a table of profiles, read where the limb in view is and as the Sun stands there.

With the normal ``u`` of the ellipsoid beneath a place of the limb, the line of sight ``d`` to it, which is level there,
and the direction ``s`` of the Sun: zenith angle ``acos(s . u)``, azimuth from the line of sight ``atan2(s . (u x d),
s . d)``.

How far from the zenith of the observer the Sun stands is known from time and place, whatever the attitude, and how it
stands about it from a Sun sensor, or else from the attitude: a sensor that reads whole degrees would leave a limb near
the terminator half a kilometre off. A sensor that sees the Sun where time and attitude cannot have it is believed
alone: a clock that is hours off, or a scene whose Sun was put somewhere.

A line that passes ``h`` above the limb is turned outwards by ``b = h / l`` at the distance ``l`` of the limb, and its
lowest point lies as much nearer: under another Sun, half a degree away from low orbit at the height of 20 km. Sunlit
tables are read where every line has its own lowest point::

    u' = cos b u - sin b d,      d' = cos b d + sin b u
"""

from __future__ import annotations

from datetime import datetime

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.climate import month_of
from horizonval.estimation.likelihood.knowledge import LimbPose
from horizonval.estimation.likelihood.profile.air import (
    EARTH_RADIUS_M,
    LimbNodes,
    NodeAir,
    before_lowest_rad,
    node_air,
)
from horizonval.estimation.likelihood.templates import LimbTemplates
from horizonval.geometry.rotation import off_axis_angle

FARTHEST_RAD, STEPS = 0.25, 6
"""Of the ends of lines before their lowest points, and at how many places tables are read up to there: deeper lines,
with lowest points 160 km below the source of their light, keep the last."""
CONTRADICTED = 5.0
"""Standard deviations: chance is as far off in both axes once in 270 000, exp(-5^2 / 2)."""
LEAST_LEVEL = 1e-9
"""Of a direction's level part: a Sun that is read straight above or below has no azimuth, and needs none."""
SUNLIT_M = np.linspace(-20e3, 80e3, 6)
"""Heights whose lines' lowest points sunlit tables are read at. Between them light changes evenly with the Sun, which
stands at most 0.8 deg elsewhere from one to the next (200 km); below and above is little more."""


class KnownAir:
    """The air of a table at one time, under one Sun.

    Parameters
    ----------
    templates : LimbTemplates
    epoch_utc : datetime
    sun_cam : ndarray, shape (3,), or None
        As a Sun sensor sees it.
    sun_itrs : ndarray, shape (3,), or None
        As the time says it; None where the sensor alone is believed, :func:`sun_of_time`. One of the two is there.
    """

    def __init__(
        self, templates: LimbTemplates, epoch_utc: datetime, sun_cam: FloatArray | None, sun_itrs: FloatArray | None
    ) -> None:
        self._templates, self._epoch = templates, epoch_utc
        self._sun_cam, self._sun_itrs = sun_cam, sun_itrs

    @property
    def heights_m(self) -> tuple[float, float]:
        """First and last height of the table."""
        height = self._templates.height_m
        return float(height[0]), float(height[-1])

    def nodes(
        self,
        normal_cam: FloatArray,
        los_cam: FloatArray,
        pose: LimbPose,
        grid_m: tuple[float, float, float],
        curve: float,
    ) -> NodeAir:
        """Return the air at places along the limb; parameters as for ``ProfileKnowledge.air``."""
        table = self._templates
        first, second = self._place(normal_cam, los_cam, pose)
        mean, modes, left = table.at(first, second)
        if table.band_kind == "thermal":
            mean = self._where_lines_end(mean, normal_cam, los_cam, pose)
        else:
            mean = self._under_own_sun(normal_cam, los_cam, pose, curve)
        places = LimbNodes(normal_cam @ pose.cam_from_itrs, los_cam @ pose.cam_from_itrs)
        return node_air(table.height_m, mean, modes, left, table.lengths_at(first), places, grid_m, curve)

    def _where_lines_end(
        self, mean: FloatArray, normal_cam: FloatArray, los_cam: FloatArray, pose: LimbPose
    ) -> FloatArray:
        """Return means (m, h), every height's from the latitude from which its light comes.

        A thermal table is of one column of air: where a line ends before its lowest point, the column is that of its
        end. Sunlit tables have no places.
        """
        height = self._templates.height_m
        away = before_lowest_rad(height, mean)
        steps = np.linspace(0.0, FARTHEST_RAD, STEPS)
        ends = [np.cos(step) * normal_cam - np.sin(step) * los_cam for step in steps]
        at = np.array([self._templates.mean_at(*self._place(end, los_cam, pose)) for end in ends])
        place = np.minimum(away / steps[1], STEPS - 1.001)
        first = place.astype(np.intp)
        share = place - first
        node, row = np.indices(mean.shape)
        return np.asarray(at[first, node, row] * (1.0 - share) + at[first + 1, node, row] * share)

    def _under_own_sun(self, normal_cam: FloatArray, los_cam: FloatArray, pose: LimbPose, curve: float) -> FloatArray:
        """Return means (m, h), every height's under the Sun of its own line's lowest point."""
        turn = SUNLIT_M * np.sqrt(2.0 * curve / EARTH_RADIUS_M)
        cosine, sine = np.cos(turn)[:, None, None], np.sin(turn)[:, None, None]
        normal, los = cosine * normal_cam - sine * los_cam, cosine * los_cam + sine * normal_cam
        means = self._templates.mean_at(*self._place(normal.reshape(-1, 3), los.reshape(-1, 3), pose))
        all_of_them = means.reshape(len(turn), len(normal_cam), -1)
        place = np.interp(self._templates.height_m, SUNLIT_M, np.arange(len(SUNLIT_M)))
        first = np.minimum(place.astype(np.intp), len(SUNLIT_M) - 2)
        share, row = place - first, np.arange(len(place))
        return np.asarray(
            all_of_them[first, :, row] * (1.0 - share)[:, None] + all_of_them[first + 1, :, row] * share[:, None]
        ).T

    def means(self, normal_cam: FloatArray, los_cam: FloatArray, pose: LimbPose, height_m: FloatArray) -> FloatArray:
        """Return the mean profiles at places (m, 3) on heights (n,), shape (m, n); above the table nothing."""
        known = self._templates.height_m
        mean = self._templates.mean_at(*self._place(normal_cam, los_cam, pose))
        return np.array([np.interp(height_m, known, row, right=0.0) for row in mean])

    def _place(
        self, normal_cam: FloatArray, los_cam: FloatArray, pose: LimbPose
    ) -> tuple[FloatArray, FloatArray | float]:
        """Return where places along the limb lie in the table, as :meth:`.LimbTemplates.at` takes them."""
        if self._templates.band_kind == "thermal":
            latitude = np.arcsin(np.clip(normal_cam @ pose.cam_from_itrs[:, 2], -1.0, 1.0))
            return latitude, month_of(self._epoch)
        sun = self._towards_sun(pose)
        zenith = np.arccos(np.clip(normal_cam @ sun, -1.0, 1.0))
        azimuth = np.arctan2(np.cross(normal_cam, los_cam) @ sun, los_cam @ sun)
        return zenith, azimuth

    def _towards_sun(self, pose: LimbPose) -> FloatArray:
        """Return the direction of the Sun in camera axes, shape (3,)."""
        if self._sun_itrs is None:
            assert self._sun_cam is not None
            return self._sun_cam
        if self._sun_cam is None:
            return np.asarray(pose.cam_from_itrs @ self._sun_itrs)
        nadir = pose.nadir_cam
        down = -float(self._sun_itrs @ pose.r_itrs) / float(np.linalg.norm(pose.r_itrs))
        level = self._sun_cam - float(self._sun_cam @ nadir) * nadir
        size = max(float(np.linalg.norm(level)), LEAST_LEVEL)
        return np.asarray(down * nadir + np.sqrt(max(1.0 - down**2, 0.0)) * level / size)


def sun_of_time(
    sun_itrs: FloatArray, sun_cam: FloatArray | None, cam_from_itrs: FloatArray, sigma_rad: float
) -> FloatArray | None:
    """Return the direction of the Sun as the time says it, or None if a sensor's reading contradicts it.

    Parameters
    ----------
    sun_itrs : ndarray, shape (3,)
        By the time.
    sun_cam : ndarray, shape (3,), or None
        Of the sensor; without one there is nothing to contradict.
    cam_from_itrs : ndarray, shape (3, 3)
        The attitude that is known.
    sigma_rad : float
        Standard deviation of the angle between the two, of attitude and sensor together.
    """
    if sun_cam is None or float(off_axis_angle(sun_cam, cam_from_itrs @ sun_itrs)) <= CONTRADICTED * sigma_rad:
        return sun_itrs
    return None
