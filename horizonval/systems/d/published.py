"""What Cui and others (2016) print: five tables of roll and pitch [deg], read by four heads of 0.1 deg per element."""

from __future__ import annotations

from dataclasses import dataclass, field

QUANTUM_DEG = 0.1 / 8.0**0.5
"""Weight of one whole pixel in roll and pitch: every published figure is a whole multiple of 0.035355 deg."""
TWO_QUANTA_DEG = 0.0708


@dataclass(frozen=True)
class Setting:
    """One column of a table: how the satellite stands, and what was read (None: lost in print)."""

    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    altitude_km: float = 400.0
    read: dict[str, float | None] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """Name of the frames; settings of several tables share theirs."""
        return f"roll {self.roll:g}, pitch {self.pitch:g}, yaw {self.yaw:g}, {self.altitude_km:g} km"


def _table(readings: dict[str, tuple[float | None, ...]], settings: list[dict[str, float]]) -> tuple[Setting, ...]:
    return tuple(
        Setting(**setting, read={axis: values[i] for axis, values in readings.items()})
        for i, setting in enumerate(settings)
    )


TABLES: dict[int, tuple[Setting, ...]] = {
    1: _table(
        {
            "roll": (0.0, 0.9899, 2.0153, 3.0052, 3.9952, 4.9497),
            "pitch": (0.0, 0.0, -0.0354, -0.0354, -0.0354, 0.0),
        },
        [{"roll": float(k)} for k in range(6)],
    ),
    2: _table(
        {
            "pitch": (0.0, -1.0253, -2.0506, -3.0052, -3.9598, -4.9497),
            "roll": (0.0, -0.0354, 0.0354, 0.0, None, 0.0),
        },
        [{"pitch": 0.0 - k} for k in range(6)],
    ),
    3: _table(
        {
            "pitch": (0.0, -0.9899, -2.0153, -3.0052, -4.0305, -4.9851),
            "roll": (0.0, 0.9899, 2.0153, 3.0052, 3.9598, 4.9851),
        },
        [{"pitch": 0.0 - k, "roll": float(k)} for k in range(6)],
    ),
    4: _table(
        {"pitch": (-4.9851,) * 4, "roll": (4.9851,) * 4},
        [{"pitch": -5.0, "roll": 5.0, "yaw": yaw} for yaw in (45.0, 135.0, 225.0, 315.0)],
    ),
    5: _table(
        {"pitch": (-0.9899,) * 5, "roll": (0.9899,) * 5},
        [{"pitch": -1.0, "roll": 1.0, "altitude_km": h} for h in (200.0, 300.0, 400.0, 500.0, 600.0)],
    ),
}

PRINTED = sum(figure is not None for settings in TABLES.values() for s in settings for figure in s.read.values())
"""How many readings are printed; one more is lost."""

MOMENTS = {
    (1, "roll"): (-0.0074, 0.0227),
    (2, "pitch"): (0.0016, 0.0384),
    (3, "pitch"): (-0.0043, 0.0167),
    (3, "roll"): (-0.0074, 0.0193),
}
"""Mean and standard deviation of the errors [deg], by table and axis."""

ALL = {setting.key: setting for settings in TABLES.values() for setting in settings}
