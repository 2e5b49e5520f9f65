"""Velocities that contradict the positions are refused with the row and the cause; what is only coarse is not."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from sgp4.api import Satrec

from horizonval.core.errors import UserError
from horizonval.formats.trajectory import TrajectoryPiece, attitude_of_csv, orbit_of_csv, piece_of
from horizonval.geometry.orbit import GM_M3_PER_S2, Elements
from horizonval.geometry.orbit import tod_states as drifting
from horizonval.geometry.rotation import itrs_from_gcrs, turn

EPOCH = datetime(2026, 3, 20, 12, tzinfo=UTC)
LEO = Elements(6.928e6, 0.001, math.radians(97.5), 1.0, 0.5, 0.3)
MOLNIYA = Elements(26.55e6, 0.737, math.radians(63.4), 1.0, math.radians(270.0), -0.2)
GEO = Elements(42.164e6, 0.0003, math.radians(0.1), 1.0, 0.5, 0.3)
SPIN = np.array([0.0, 0.0, 7.292115146706979e-5])


def tod_states(elements: Elements, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions, and velocities that are their rates of change."""
    before, here, after = (drifting(elements, t + d)[0] for d in (-0.05, 0.0, 0.05))
    return here, (after - before) / 0.1


RNG = np.random.default_rng(5)


def piece(t: np.ndarray, r: np.ndarray, v: np.ndarray | None, axes: str = "gcrs") -> TrajectoryPiece:
    return piece_of(axes, EPOCH, t, r, v, "sat.csv")


WRONG = {
    "zero": (lambda r, v: 0.0 * v, "state 1: .*it is zero"),
    "metres a second": (lambda r, v: 1e3 * v, "state 1: .*it looks like m/s in place of km/s"),
    "reversed": (lambda r, v: -v, "state 1: .*its sign looks reversed"),
    "swapped": (lambda r, v: v[:, [1, 0, 2]], "state 1: .*another unit, order"),
    "one sign": (lambda r, v: v * [1.0, -1.0, 1.0], "state 1: .*another unit, order"),
    "relative": (lambda r, v: v - np.cross(SPIN, r), "state 1: .*it looks relative to the turning Earth"),
    "another satellite": (lambda r, v: np.roll(v, 3, axis=0), "state 1: .*another unit"),
    "one row": (lambda r, v: np.where(np.arange(len(v))[:, None] == 7, 0.0, v), "state 8: "),
    "late": (lambda r, v: v + 10.0 * np.gradient(v, axis=0), "state 1: .*another unit"),
}


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize(("elements", "step"), [(LEO, 1.0), (LEO, 60.0), (LEO, 300.0), (MOLNIYA, 60.0), (GEO, 900.0)])
def test_a_contradiction_is_refused_with_its_cause(wrong: str, elements: Elements, step: float) -> None:
    t = step * np.arange(16.0)
    r, v = tod_states(elements, t)
    change, message = WRONG[wrong]
    if (wrong, step) == ("late", 1.0) or (wrong in ("another satellite", "late") and step == 1.0):
        t, r, v = t * 30.0, *tod_states(elements, t * 30.0)
    with pytest.raises(UserError, match=f"^sat.csv: {message}"):
        piece(t, r, change(r, v))
    piece(t, r, v)


@pytest.mark.parametrize(
    ("elements", "axes", "factor", "message"),
    [
        (LEO, "gcrs", 0.0, "the velocity is .* it is zero"),
        (LEO, "gcrs", 1e3, r"a speed of 7.*e.03 km/s"),
        (GEO, "itrs", 0.0, "the velocity is .* it is zero"),
    ],
)
def test_velocities_that_no_satellite_has_are_refused_however_far_apart(elements, axes, factor, message) -> None:
    t = 3600.0 * np.arange(9.0)
    r, v = tod_states(elements, t)
    if axes == "itrs":
        r = turn(itrs_from_gcrs(EPOCH, t), r)
        v = np.gradient(r, 3600.0, axis=0)
    else:
        piece(t, r, v)
    with pytest.raises(UserError, match=f"state 1: {message}"):
        piece(t, r, factor * v, axes)


def test_one_wrong_position_without_velocities_is_refused() -> None:
    """Of a digit, and of a second satellite between the rows of the first."""
    for elements, step in ((LEO, 60.0), (GEO, 900.0), (MOLNIYA, 60.0)):
        t = step * np.arange(16.0)
        r, _ = tod_states(elements, t)
        wrong = r + np.where(np.arange(16)[:, None] == 7, [5e3, 0.0, 0.0], 0.0)
        with pytest.raises(UserError, match=r"state 8: a position .* km off the way through its neighbours"):
            piece(t, wrong, None)
    with pytest.raises(UserError, match=r"state 2: a position that .* km/s would reach"):
        piece(np.sort([*t, *(t + 0.5)]), np.stack([r, -r], axis=1).reshape(-1, 3), None)


@pytest.mark.parametrize("elements", [LEO, GEO])
@pytest.mark.parametrize("rows", [2, 3, 12])
def test_inertial_velocities_in_earth_fixed_columns(elements: Elements, rows: int) -> None:
    t = 60.0 * np.arange(float(rows))
    r, v = tod_states(elements, t)
    matrices = itrs_from_gcrs(EPOCH, t)
    r, v = turn(matrices, r), turn(matrices, v)
    piece(t, r, v - np.cross(SPIN, r), "itrs")
    with pytest.raises(UserError, match="it looks inertial, in Earth-fixed columns"):
        piece(t, r, v, "itrs")


@pytest.mark.parametrize("noise_m", [0.0, 1.0])
@pytest.mark.parametrize("step", [1.0, 60.0, 300.0])
@pytest.mark.parametrize("elements", [LEO, MOLNIYA, GEO, Elements(6.9e6, 0.001, 0.01, 1.0, 0.5, 0.3)])
def test_states_of_other_axes_are_refused(elements: Elements, step: float, noise_m: float) -> None:
    """Velocities and positions agree with each other, and not with the axes."""
    t = step * np.arange(400.0 if step == 1.0 else 40.0)
    r, v = tod_states(elements, t)
    r = r + RNG.normal(0.0, noise_m, r.shape)
    matrices = itrs_from_gcrs(EPOCH, t)
    fixed = turn(matrices, r), turn(matrices, v) - np.cross(SPIN, turn(matrices, r))
    for states in ((r, v), (r, None)):
        piece(t, *states)
        with pytest.raises(
            UserError, match=r"sat.csv: the states move as in inertial axes, but are said to be Earth-f"
        ):
            piece(t, *states, "itrs")
    for states in (fixed, (fixed[0], None)):
        piece(t, *states, "itrs")
        with pytest.raises(UserError, match=r"sat.csv: the states move as in Earth-fixed axes, but are said to be ine"):
            piece(t, *states)


def _noisy(step: float, sigma_m: float):
    def states(t):
        r, v = tod_states(LEO, step * t)
        return step * t, r + RNG.normal(0.0, sigma_m, r.shape), v + RNG.normal(0.0, 0.05, v.shape)

    return states


def _burn(delta_v: float, step: float):
    def states(t):
        t = step * t
        r, v = tod_states(LEO, t)
        half = len(t) // 2
        r0, v0 = r[half] + 0.0, v[half] + delta_v * v[half] / np.linalg.norm(v[half])
        # The new orbit by small steps of Stoermer and Verlet.
        for k in range(half + 1, len(t)):
            n = 20
            h = (t[k] - t[k - 1]) / n
            for _ in range(n):
                v0 = v0 - 0.5 * h * GM_M3_PER_S2 * r0 / np.linalg.norm(r0) ** 3
                r0 = r0 + h * v0
                v0 = v0 - 0.5 * h * GM_M3_PER_S2 * r0 / np.linalg.norm(r0) ** 3
            r[k], v[k] = r0, v0
        return t, r, v

    return states


def _sgp4(step: float, digits: tuple[int, int]):
    lines = (
        "1 25544U 98067A   26079.50000000  .00012000  00000-0  22000-3 0  9999",
        "2 25544  51.6400 208.9163 0006703 130.5360 325.0288 15.49560000 00010",
    )

    def states(t):
        satellite = Satrec.twoline2rv(*lines)
        found = [satellite.sgp4_tsince(x * step / 60.0)[1:] for x in t]
        r, v = (np.array(x) for x in zip(*found, strict=True))
        return step * t, 1e3 * np.round(r, digits[0]), 1e3 * np.round(v, digits[1])

    return states


def _balloon(t):
    t = 10.0 * t
    angle = 7.292115e-5 * t + 1e-6 * t
    r = 6.41e6 * np.stack([np.cos(angle), np.sin(angle), 0.0 * t], axis=1)
    return t, r, 6.41e6 * (7.292115e-5 + 1e-6) * np.stack([-np.sin(angle), np.cos(angle), 0.0 * t], axis=1)


LEGITIMATE = {
    "noise of 1 m each second": _noisy(1.0, 1.0),
    "noise of 10 m each second": _noisy(1.0, 10.0),
    "noise of 5 cm at 10 Hz": _noisy(0.1, 0.05),
    "noise of 200 m each minute": _noisy(60.0, 200.0),
    "whole kilometres, 0.01 km/s": _sgp4(60.0, (0, 2)),
    "metres, mm/s": _sgp4(60.0, (3, 6)),
    "sparse": _sgp4(900.0, (6, 9)),
    "five minutes, kilometres": _sgp4(300.0, (0, 3)),
    "burn of 5 m/s": _burn(5.0, 60.0),
    "burn of 2.4 km/s": _burn(2400.0, 60.0),
    "burn, one second": _burn(100.0, 1.0),
    "perigee of Molniya": lambda t: (600.0 * t, *tod_states(MOLNIYA, 600.0 * t)),
    "uneven steps": lambda t: (70.0 * t + 25.0 * np.sin(t), *tod_states(LEO, 70.0 * t + 25.0 * np.sin(t))),
    "pauses": lambda t: (60.0 * t + 5000.0 * (t // 10), *tod_states(LEO, 60.0 * t + 5000.0 * (t // 10))),
    "a balloon": _balloon,
}


@pytest.mark.parametrize("rows", [2, 3, 4, 40, 400])
@pytest.mark.parametrize("case", LEGITIMATE)
def test_coarse_noisy_or_thrusting_states_are_no_contradiction(case: str, rows: int) -> None:
    piece(*LEGITIMATE[case](np.arange(float(rows))))


HEAD = "time_utc,x_gcrs_km,y_gcrs_km,z_gcrs_km,vx_gcrs_km_s,vy_gcrs_km_s,vz_gcrs_km_s"
ROWS = [
    "2026-03-20T12:00:00+00:00,6928.000000,0.000000,0.000000,0.000000,-0.990063,7.520271",
    "2026-03-20T14:01:00+02:00,6913.056981,-59.361035,450.891828,-0.497921,-0.987927,7.504051",
    "2026-03-20T12:02:00Z,6868.292387,-118.465999,899.838597,-0.993695,-0.981530,7.455459",
]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("vx_gcrs_km_s", "vx_gcrs_kms"), "columns? vx_gcrs_kms, which does not go with"),
        (("vz_gcrs_km_s", "vz_itrs_km_s"), "column vx_gcrs_km_s, which does not go with"),
        (("vy_gcrs_km_s", "vx_gcrs_km_s"), "column vx_gcrs_km_s, which does not go with"),
        (("vy_gcrs_km_s", "y_gcrs_km"), "column y_gcrs_km is given twice"),
        (("vx_gcrs_km_s,vy_gcrs_km_s,vz_gcrs_km_s", "x_itrs_km,y_itrs_km,z_itrs_km"), "column x_itrs_km, which"),
        (("vx_gcrs_km_s,vy_gcrs_km_s,vz_gcrs_km_s", "vel_x,vel_y,vel_z"), "column vel_x, which does not go with"),
        (("14:01:00+02:00", "14:02:00+02:00"), "line 4: the time of the row before"),
        (("14:01:00+02:00", "13:59:00+02:00"), "line 3: 60 s before the row before"),
        (("6928.0", "6928000.0"), "line 2: a state 6.928e.06 km from the Earth's centre; .*are these kilometres"),
        (("7.455459", "-7.455459"), "line 4: the velocity is"),
        (("12:02:00Z", "12:02:60Z"), "line 4, column time_utc: .*no leap second"),
    ],
)  # fmt: skip
def test_tables_that_may_mean_something_else_are_refused(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    path = tmp_path / "sat.csv"
    plain = "\n".join([HEAD + ",mode,mass_kg", *(row + ",nadir,12.5" for row in ROWS)])
    path.write_bytes(b"\xef\xbb\xbf" + plain.replace("\n", "\r\n").encode())
    assert orbit_of_csv(path).pieces[0].seconds.tolist() == [0.0, 60.0, 120.0]
    assert plain.count(change[0]) == 1
    path.write_text(plain.replace(*change))
    with pytest.raises(UserError, match=f"sat.csv: {message}"):
        orbit_of_csv(path)


def test_attitudes_know_their_columns_too(tmp_path: Path) -> None:
    path = tmp_path / "att.csv"
    head = "time_utc,q_body_from_gcrs_x,q_body_from_gcrs_y,q_body_from_gcrs_z,q_body_from_gcrs_w"
    path.write_text(head + ",q_w\n2016-12-31T23:59:59Z,0,0,0,1,1\n")
    with pytest.raises(UserError, match="column q_w, which does not go with"):
        attitude_of_csv(path)
    path.write_text(head + "\n" + "".join(f"2016-12-31T23:59:{s},0,0,0,1\n" for s in ("58", "59", "60", "60.5")))
    assert attitude_of_csv(path).pieces[0].seconds.tolist() == [0.0, 1.0, 2.0, 2.5]
