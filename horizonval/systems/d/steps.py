"""Settings and readings of the printed tables; on how many printed steps a reading falls, and how many would by chance.

Every printed figure of the tables is a whole number of steps of ``IFOV / (2 sqrt 2)``, since the crossings A, B, C, D
are whole pixels. With ``p`` and ``r`` the steps of pitch and roll::

    p + r = 2 (A - C),    p - r = 2 (B - D)

so that ``p + r`` is even whatever the four pixels are. That is a rule which the printed tables can break, and a bound:
no whole pixels can give both figures of a column that breaks it.

A bar of two steps is met by the truth itself, by every pixel phase and by every projection. What discriminates is the
number of figures on the very step, against figures that need no sensor (the truth, rounded) and against the same
geometry with the pixels laid elsewhere: a crossing lies at ``floor(x + phase)``, and nothing published says where the
pixels of a head begin. The chance of doing as well is therefore the share of evenly spread phases, one for each head,
that reach the number.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.geometry.frames import nadir_of_roll_pitch
from horizonval.systems.published import published

PUBLISHED = published("D")
QUANTUM_DEG = PUBLISHED.number("element") / 8.0**0.5
"""Weight of one whole pixel in roll and pitch: every published figure is a whole multiple of 0.035355 deg."""


@dataclass(frozen=True)
class Setting:
    """One column of a table: how the satellite stands, and what was read (None: lost in print)."""

    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    altitude_km: float = PUBLISHED.number("altitude")
    read: dict[str, float | None] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """Name of the frames; settings of several tables share theirs."""
        angles = f"roll {self.roll_deg:g}, pitch {self.pitch_deg:g}, yaw {self.yaw_deg:g}"
        return f"{angles}, {self.altitude_km:g} km"

    def true_deg(self, axis: str) -> float:
        """Return the true roll or pitch."""
        return self.roll_deg if axis == "roll" else self.pitch_deg


TABLES = {
    int(number): tuple(Setting(**settings, read=read) for settings, read in table.columns())
    for number, table in PUBLISHED.tables.items()
}
"""Settings by the table's number."""

PRINTED = sum(figure is not None for settings in TABLES.values() for s in settings for figure in s.read.values())
"""How many readings are printed; one more is lost."""

MOMENTS = {
    (int(number), axis): (moments["mean"], moments["deviation"])
    for number, table in PUBLISHED.tables.items()
    for axis, moments in table.errors.items()
}
"""Mean and standard deviation of the errors [deg], by table and axis."""

ALL = {setting.key: setting for settings in TABLES.values() for setting in settings}


RADIUS_KM = PUBLISHED.number("earth_radius")
AIM_DEG = PUBLISHED.number("nadir_angle")
ELEMENT_DEG = PUBLISHED.number("element")
HALF_FIELD_PX = 0.5 * PUBLISHED.number("elements")
HEADS_DEG = (135.0, 225.0, 315.0, 45.0)
"""Azimuths of heads A, B, C, D in the body: the printed ones in a housing turned by 90 deg."""
ROWS_PX = (-0.5, 0.0, 0.5)
"""A picture of 160 rows has no middle row: the array is half a row off the axis, or is a line of its own."""
LIMB_HEIGHTS_KM = (0.0, 30.0, 35.0, 40.0, 45.0)
"""Heights of the limb above a sphere that the heads are not turned up to; the 15 um band has about 40 km."""
PHASES = 20
"""Pixel phases tried, for all heads together and for each one."""
DRAWS = 20_000
PRINTED_STEPS = np.array(
    [
        [math.nan if s.read[axis] is None else round((s.read[axis] or 0.0) / QUANTUM_DEG) for axis in ("pitch", "roll")]
        for settings in TABLES.values()
        for s in settings
    ]
)
"""Printed pitch and roll of every column of the tables in steps, shape (columns, 2); NaN where one is lost."""
COLUMNS = [setting for settings in TABLES.values() for setting in settings]
TRUE_DEG = np.array([[s.pitch_deg, s.roll_deg] for s in COLUMNS])


@dataclass(frozen=True)
class HeadVariant:
    """A way in which the published simulation may have made its rows.

    ``perspective``: flat focal plane of 160 pixels over 16 deg instead of equiangular pixels; ``row_px``: offset of the
    row from the head's axis; ``limb_km``: height of the visible limb.
    """

    perspective: bool
    row_px: float = 0.0
    limb_km: float = 0.0


def crossing(setting: Setting, variant: HeadVariant) -> FloatArray:
    """Return where the limb of a sphere crosses the rows of heads A to D, pixels from the heads' axes, shape (4,).

    In the plane of a row, spanned by the axis ``b`` and the outward direction ``u``, the limb ``d . n = cos rho`` lies
    at the angle ``atan2(u . n, b . n) + acos(cos rho / |(b . n, u . n)|)`` from ``b``. NaN where it is not in view.
    """
    cos_rho = math.cos(math.asin((RADIUS_KM + variant.limb_km) / (RADIUS_KM + setting.altitude_km)))
    nadir = nadir_of_roll_pitch(math.radians(setting.roll_deg), math.radians(setting.pitch_deg))
    focal_px = HALF_FIELD_PX / math.tan(math.radians(HALF_FIELD_PX * ELEMENT_DEG))
    aim = math.radians(AIM_DEG)
    columns = []
    for azimuth_deg in HEADS_DEG:
        azimuth = math.radians(azimuth_deg)
        level = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        side = np.array([-level[1], level[0], 0.0])
        down = np.array([0.0, 0.0, 1.0])
        axis = math.cos(aim) * down + math.sin(aim) * level + variant.row_px / focal_px * side
        outward = math.cos(aim) * level - math.sin(aim) * down
        length = float(np.linalg.norm(axis))
        along, across = float(axis @ nadir) / length, float(outward @ nadir)
        ratio = cos_rho / math.hypot(along, across)
        angle = math.atan2(across, along) + math.acos(ratio) if ratio <= 1.0 else math.nan
        column = focal_px * length * math.tan(angle) if variant.perspective else math.degrees(angle) / ELEMENT_DEG
        columns.append(column if abs(column) < HALF_FIELD_PX else math.nan)
    return np.array(columns)


def steps_of(pixels: FloatArray) -> FloatArray:
    """Return pitch and roll in steps from the pixels of A, B, C, D in the last axis."""
    a, b, c, d = np.moveaxis(pixels, -1, 0)
    return np.stack([a + b - c - d, a + d - b - c], axis=-1)


def same_step(steps: FloatArray, printed: FloatArray = PRINTED_STEPS) -> np.ndarray:
    """Return which printed figures are on the same step as ``steps``, shape (..., columns, 2)."""
    return np.asarray(np.rint(steps) == printed)


def count(steps: FloatArray) -> int:
    """Return how many printed figures are on the same step as these, shape (columns, 2); NaN counts as not."""
    return int(same_step(steps).sum())


def cross_axis(printed: FloatArray = PRINTED_STEPS) -> np.ndarray:
    """Return which figures are of an axis that was not turned, and are not printed as zero, shape (columns, 2)."""
    return np.asarray((TRUE_DEG == 0.0) & (printed != 0.0) & np.isfinite(printed))


def odd_columns() -> list[str]:
    """Return the columns whose printed figures no four whole pixels can make, by their settings."""
    odd = np.abs(PRINTED_STEPS.sum(axis=1)) % 2 == 1
    return [s.key for s, one in zip(COLUMNS, odd, strict=True) if one]


def lost_elsewhere() -> dict[str, FloatArray]:
    """Return the printed steps, by setting, with table 2's lost roll where no column breaks the rule.

    The row has six columns and five legible figures, in their order.
    """
    lost = int(np.flatnonzero(np.isnan(PRINTED_STEPS[:, 1]))[0])
    table = len(TABLES[1]) + np.arange(len(TABLES[2]))
    kept = [PRINTED_STEPS[i, 1] for i in table if i != lost]
    possible = {}
    for place, column in enumerate(table):
        moved = PRINTED_STEPS.copy()
        moved[table, 1] = [*kept[:place], math.nan, *kept[place:]]
        if not (np.abs(moved.sum(axis=1)) % 2 == 1).any():
            possible[COLUMNS[column].key] = moved
    return possible


def rendered_steps(readings: dict[str, JsonObject]) -> FloatArray:
    """Return pitch and roll in steps from the published crossings of rendered rows, shape (columns, 2)."""
    pixels = [readings[s.key]["published_px"] for s in COLUMNS]
    seen = [readings[s.key]["sub_pixel"]["status"] == "valid" for s in COLUMNS]
    return np.where(np.array(seen)[:, None], steps_of(np.array(pixels, dtype=float)), math.nan)


def variants() -> dict[HeadVariant, FloatArray]:
    """Return the crossings of all columns for every variant, each of shape (columns, 4)."""
    tried = [HeadVariant(p, row) for p, row in itertools.product((False, True), ROWS_PX)]
    tried += [HeadVariant(p, 0.0, h) for p, h in itertools.product((False, True), LIMB_HEIGHTS_KM[1:])]
    return {one: np.array([crossing(s, one) for s in COLUMNS]) for one in tried}


def alike_phases(crossings: FloatArray) -> list[int]:
    """Return the count for every phase that all heads share."""
    return [count(steps_of(np.floor(crossings + phase / PHASES))) for phase in range(PHASES)]


def chance(crossings: FloatArray, rng: np.random.Generator) -> np.ndarray:
    """Return the counts for evenly spread phases, one for each head and draw, shape (draws,)."""
    phase = rng.random((DRAWS, 1, 4))
    return np.asarray(same_step(steps_of(np.floor(crossings + phase))).sum(axis=(1, 2)))


@dataclass(frozen=True)
class BestPhases:
    """Phases of the four heads with the most figures on the printed step: a fit, not a reproduction.

    ``count``: of all figures; ``across``: of those that :func:`cross_axis` marks; ``ways``: number of equally good
    tries.
    """

    count: int
    across: int
    ways: int


def best_phases(crossings: FloatArray, printed: FloatArray = PRINTED_STEPS) -> BestPhases:
    """Try all combinations of four phases: ``p + r`` depends on A and C, ``p - r`` on B and D, a figure on all."""
    whole = np.floor(crossings[:, None, :] + (np.arange(PHASES) / PHASES)[:, None])
    best, right_across, ways = -1, 0, 0
    marked = cross_axis(printed)
    for i, j in itertools.product(range(PHASES), repeat=2):
        # Phases of A and C fixed, those of B and D along the first two axes.
        a, c = whole[:, i, 0], whole[:, j, 2]
        b, d = whole[:, :, 1].T[:, None, :], whole[:, :, 3].T[None, :, :]
        fits = same_step(np.stack([a + b - c - d, a + d - b - c], axis=-1), printed)
        counts = fits.sum(axis=(2, 3))
        top = int(counts.max())
        if top > best:
            best, ways, right_across = top, 0, 0
        if top == best:
            ways += int((counts == best).sum())
            right_across = max(right_across, int((fits & marked).sum(axis=(2, 3))[counts == best].max()))
    return BestPhases(best, right_across, ways)
