"""Prints what weather does to the infrared horizon: real states, drawn weather, and figures published by others.

Run it as ``python tests/physics/make_weather_horizon.py``; it takes about a minute of one processor. The tables of
``docs/explanation/weather.md`` are its output.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
from column_horizon import LEVEL_M, half_plateau_m, level_m, limb

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.air import real_profile, weather_columns
from horizonval.earth.atmosphere.profiles import profile
from horizonval.earth.gases.gas_state import GasState
from horizonval.earth.weather import hydrostatic, real_states
from horizonval.earth.weather.field import WeatherField

EVERY = tuple(range(1, 13))
CLASSES: dict[str, tuple[float, float, tuple[int, ...]]] = {
    "tropics, to 25 deg": (0.0, 25.0, EVERY),
    "25 to 50 deg": (25.0, 50.0, EVERY),
    "poleward of 50, winter": (50.0, 90.0, (11, 12, 1, 2, 3)),
    "poleward of 50, summer": (50.0, 90.0, (5, 6, 7, 8, 9)),
    "poleward of 50, April, October": (50.0, 90.0, (4, 10)),
}
"""Latitudes and northern months; in the south half a year later."""
RADIUS_KM, FLATTENING = 6378.137, 1.0 / 298.257


def together(states: list[GasState]) -> GasState:
    """Return columns side by side."""
    gases = {gas: np.concatenate([s.vmr[gas] for s in states]) for gas in states[0].vmr}
    pressure, kelvin = (np.concatenate([getattr(s, key) for s in states]) for key in ("pressure_pa", "temperature_k"))
    return GasState(LEVEL_M, pressure, kelvin, gases)


def class_of_state(latitude_deg: float, month: int) -> str:
    north = month if latitude_deg >= 0.0 else (month + 5) % 12 + 1
    for name, (low, high, months) in CLASSES.items():
        if low <= abs(latitude_deg) <= high and north in months and (abs(latitude_deg) > low or low == 0.0):
            return name
    raise ValueError(f"no class for {latitude_deg} deg in month {month}")


def real_heights() -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return heights of half of the plateau [km] and plateaus of the 96 states, by class."""
    names = real_states.names()
    states = [real_profile(name).at(LEVEL_M).gas_state().columns() for name in names]
    height, plateau = half_plateau_m(limb(together(states)))
    about = [real_states.real_state(name) for name in names]
    owner = np.array([class_of_state(s.latitude_deg, s.date.month) for s in about])
    return {name: (height[owner == name] / 1e3, plateau[owner == name]) for name in CLASSES}


def drawn(
    places: list[tuple[float, float, float, int]], *, warming_k: float | None = None
) -> tuple[GasState, GasState]:
    """Return drawn air and its climate at (latitude, longitude, month, seed)."""
    pair = []
    for calm in (False, True):
        some = [
            weather_columns(
                WeatherField(seed, month, warming_k), np.array([latitude]), np.array([longitude]), LEVEL_M, calm=calm
            )
            for latitude, longitude, month, seed in places
        ]
        pair.append(together(some))
    return pair[0], pair[1]


def drawn_heights(name: str, count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return heights [km] of drawn weather, of its climate, and plateaus; places even over the class's area."""
    low, high, months = CLASSES[name]
    rng = np.random.default_rng(np.random.SeedSequence(len(name)))
    places = []
    for seed in range(count):
        sign = 1.0 if rng.random() < 0.5 else -1.0
        sine = rng.uniform(math.sin(math.radians(low)), math.sin(math.radians(high)))
        month = float(months[int(rng.integers(len(months)))])
        places.append(
            (
                sign * math.degrees(math.asin(sine)),
                rng.uniform(-180.0, 180.0),
                month if sign > 0.0 else (month + 5.0) % 12.0 + 1.0,
                seed,
            )
        )
    (height, plateau), (calm, _) = (half_plateau_m(limb(state)) for state in drawn(places))
    return height / 1e3, calm / 1e3, plateau


def round_the_orbit(altitude_km: float = 800.0, positions: int = 24, seeds: int = 3) -> dict[str, float]:
    """Return standard deviations of height [km] and errors of pitch [deg, rms] round a polar orbit through a year.

    A sensor with a head forward and one aft, each at half of its own plateau. The horizon of a head lies
    ``acos(R / (R + a))`` ahead; a height too large by dh turns it by ``dh / sqrt((R + a)^2 - R^2)``.
    """
    reach = math.degrees(math.acos(RADIUS_KM / (RADIUS_KM + altitude_km)))
    per_km = math.degrees(1.0 / math.sqrt((RADIUS_KM + altitude_km + 40.0) ** 2 - (RADIUS_KM + 40.0) ** 2))
    places, radius = [], []
    for month in EVERY:
        for seed in range(seeds):
            for k in range(positions):
                for head in (reach, -reach):
                    u = math.radians(360.0 * (k + seed / seeds) / positions + head)
                    latitude = math.degrees(math.asin(math.sin(u)))
                    longitude = 0.0 if math.cos(u) >= 0.0 else 180.0
                    places.append((latitude, longitude, float(month), 100 * month + seed))
                    radius.append(-FLATTENING * RADIUS_KM * math.sin(u) ** 2)
    (height, _), (calm, _) = (half_plateau_m(limb(state)) for state in drawn(places))
    height, calm = height / 1e3, calm / 1e3

    def pitch(values: FloatArray) -> float:
        fore, aft = values.reshape(-1, 2).T
        return per_km * float(np.sqrt(np.mean((0.5 * (fore - aft)) ** 2)))

    return {
        "climate": float(calm.std()),
        "days": float(np.sqrt(np.mean((height - calm) ** 2))),
        "uncorrected": pitch(height + np.array(radius)),
        "oblateness": pitch(height),
        "table": pitch(height - calm),
    }


def sensitivities() -> dict[str, tuple[float, float]]:
    """Return degrees from 500 km at half of the plateau and at a fixed radiance, half of the first plateau."""
    per_km = math.degrees(1.0 / math.sqrt((6371.0 + 540.0) ** 2 - 6411.0**2)) / 1e3
    out = {}

    def change(before: GasState, after: GasState) -> tuple[float, float]:
        first, second = limb(before), limb(after)
        level = 0.5 * float(half_plateau_m(first)[1].mean())
        halves = half_plateau_m(second)[0] - half_plateau_m(first)[0]
        levels = level_m(second, level) - level_m(first, level)
        return float(halves.mean()) * per_km, float(levels.mean()) * per_km

    standard = profile("us_standard").at(LEVEL_M).gas_state().columns()
    balance = partial(hydrostatic.pressure_pa, np.array([45.0]), LEVEL_M, water_share=0.0, ground_pa=1e5)
    for what, more in (
        ("+10 K everywhere", np.full(len(LEVEL_M), 10.0)),
        ("+10 K above 12 km", 10.0 * (LEVEL_M > 12e3)),
    ):
        kelvin = standard.temperature_k + more
        ratio = balance(kelvin) / balance(standard.temperature_k)
        out[what] = change(standard, replace(standard, temperature_k=kelvin, pressure_pa=standard.pressure_pa * ratio))
    places = [(75.0, 30.0 * k, 2.0, 5) for k in range(12)]
    out["warming of 40 K, 75 N in February"] = change(drawn(places, warming_k=0.0)[0], drawn(places, warming_k=40.0)[0])
    halves, levels = [], []
    for seed in range(20):
        radiance = limb(drawn([(65.0, 30.0 * k, 1.5, seed) for k in range(12)], warming_k=0.0)[0])
        half, plateau = half_plateau_m(radiance)
        halves.append(half.std() * per_km)
        levels.append(level_m(radiance, 0.5 * float(plateau.mean())).std() * per_km)
    out["longitude alone, 65 N in January, standard deviation"] = float(np.mean(halves)), float(np.mean(levels))
    return out


def main() -> None:
    print("| class | 96 states: mean, s.d., range | drawn: mean, s.d., range | climate alone: mean, s.d. | days: rms |")
    print("|---|---|---|---|---|")
    real = real_heights()
    for name in CLASSES:
        found, (height, calm, _) = real[name][0], drawn_heights(name, 200)
        days = float(np.sqrt(np.mean((height - calm) ** 2)))
        print(
            f"| {name} | {found.mean():.1f}, {found.std():.1f}, {found.min():.1f} to {found.max():.1f} "
            f"| {height.mean():.1f}, {height.std():.1f}, {height.min():.1f} to {height.max():.1f} "
            f"| {calm.mean():.1f}, {calm.std():.1f} | {days:.1f} |"
        )
    print()
    for key, value in round_the_orbit().items():
        print(f"{key}: {value:.4f}")
    for what, (half, level) in sensitivities().items():
        print(f"{what}: {half:.3f} deg at half of the plateau, {level:.3f} at a fixed radiance")


if __name__ == "__main__":
    main()
