"""The settings of the five printed tables of roll and pitch, and the printed readings of each."""

from __future__ import annotations

from dataclasses import dataclass, field

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
