"""Orbits and attitudes of other programs' files: what they mean, by those programs and by the standards' formulas."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import oem
import pytest
from astropy import units
from astropy.coordinates import GCRS, ITRS, TETE, CartesianRepresentation
from astropy.time import Time
from scipy.spatial.transform import Rotation

from horizonval.core.errors import UserError
from horizonval.formats.aem import aem_text, attitude_of_aem
from horizonval.formats.oem import orbit_of_oem
from horizonval.formats.trajectory import Trajectory, attitude_of_csv, orbit_of_csv, piece_of
from horizonval.geometry.clock import instant_of, utc_at

EPOCH = datetime(2026, 3, 20, 12, 0, 0, tzinfo=UTC)
RADIUS_KM, RATE = 6928.0, math.sqrt(398600.4418 / 6928.0**3)
TILT = Rotation.from_euler("x", 97.5, degrees=True).as_matrix()


def circle(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the states of a circular orbit [km, km/s], shape (n, 3) each: the truth between a file's states."""
    u = RATE * np.asarray(t, float)
    flat = np.stack([np.cos(u), np.sin(u), 0.0 * u], axis=-1), np.stack([-np.sin(u), np.cos(u), 0.0 * u], axis=-1)
    return RADIUS_KM * flat[0] @ TILT.T, RADIUS_KM * RATE * flat[1] @ TILT.T


def stamp(seconds: float) -> str:
    return (EPOCH + timedelta(seconds=float(seconds))).replace(tzinfo=None).isoformat(timespec="microseconds")


def oem_of(times: np.ndarray, frame: str = "EME2000", centre: str = "EARTH", states=circle) -> str:
    """Return a message as the standard's annex shows it."""
    rows = [
        f"{stamp(t)} " + " ".join(f"{x:.9f}" for x in (*r, *v)) for t, r, v in zip(times, *states(times), strict=True)
    ]
    return "\n".join(
        [
            "CCSDS_OEM_VERS = 2.0", "CREATION_DATE = 2026-03-19T00:00:00", "ORIGINATOR = TEST", "", "META_START",
            "OBJECT_NAME = SAT", "OBJECT_ID = 2026-001A", f"CENTER_NAME = {centre}", f"REF_FRAME = {frame}",
            "TIME_SYSTEM = UTC", f"START_TIME = {stamp(times[0])}", f"STOP_TIME = {stamp(times[-1])}",
            "INTERPOLATION = HERMITE", "INTERPOLATION_DEGREE = 7", "META_STOP", "", *rows, "",
        ]
    )  # fmt: skip


def written(tmp_path: Path, name: str, text: str) -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


TIMES = np.arange(0.0, 1201.0, 60.0)
BETWEEN = np.linspace(0.0, 1200.0, 47)


def off_m(found: Trajectory, t: np.ndarray = BETWEEN) -> tuple[float, float]:
    r, v = found.states(t)
    true_r, true_v = circle(t)
    return float(np.abs(r - 1e3 * true_r).max()), float(np.abs(v - 1e3 * true_v).max())


def test_an_ephemeris_says_the_same_in_kvn_and_xml_and_between_its_states(tmp_path: Path) -> None:
    """States of a millimetre, a minute apart: nothing more is lost between them; ``oem`` itself interpolates so too."""
    kvn = written(tmp_path, "sat.oem", oem_of(TIMES))
    oem.OrbitEphemerisMessage.convert(str(kvn), str(tmp_path / "sat.xml"), "xml")
    for path in (kvn, tmp_path / "sat.xml"):
        found = orbit_of_oem(path)
        assert found.epoch_utc == EPOCH
        assert off_m(found)[0] < 1e-3
        assert off_m(found)[1] < 1e-4
    theirs = oem.OrbitEphemerisMessage.open(str(kvn))(Time((EPOCH + timedelta(seconds=631.5)).replace(tzinfo=None)))
    r, v = orbit_of_oem(kvn).states(np.array([631.5]))
    assert np.abs(r[0] / 1e3 - theirs.position).max() < 1e-5
    assert np.abs(v[0] / 1e3 - theirs.velocity).max() < 1e-8


def test_earth_fixed_states_are_turned_as_astropy_turns_them(tmp_path: Path) -> None:
    """To 500 m: UT1 - UTC, below 0.9 s, and the pole's motion are left out here. A velocity is that among the stars."""

    def fixed(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        when = Time([(EPOCH + timedelta(seconds=float(s))).replace(tzinfo=None) for s in t])
        around = [
            GCRS(CartesianRepresentation(circle(t + d)[0].T * units.km), obstime=when + d * units.s)
            for d in (-0.5, 0.0, 0.5)
        ]
        before, here, after = (
            one.transform_to(ITRS(obstime=one.obstime)).cartesian.xyz.to_value("km").T for one in around
        )
        return here, after - before

    found = orbit_of_oem(written(tmp_path, "sat.oem", oem_of(TIMES[:6], "ITRF2014", states=fixed)))
    off_r, off_v = off_m(found, np.linspace(0.0, 300.0, 11))
    assert off_r < 500.0
    assert off_v < 0.6


def test_states_of_date_are_turned_as_astropy_turns_them(tmp_path: Path) -> None:
    """To 0.1 m, 3 mas: of date here is a third of a degree from the axes that keep still, 40 km."""

    def of_date(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        when = Time([(EPOCH + timedelta(seconds=float(s))).replace(tzinfo=None) for s in t])
        r, v = (
            GCRS(CartesianRepresentation(x.T * units.km), obstime=when)
            .transform_to(TETE(obstime=when))
            .cartesian.xyz.to_value("km")
            .T
            for x in circle(t)
        )
        return r, v

    found = orbit_of_oem(written(tmp_path, "sat.oem", oem_of(TIMES[:6], "TOD", states=of_date)))
    off_r, off_v = off_m(found, np.linspace(0.0, 300.0, 11))
    assert off_r < 0.1
    assert off_v < 1e-3


def matrix_of_the_standard(q: np.ndarray) -> np.ndarray:
    """Return the matrix that takes components in A to those in B: CCSDS 504.0-B-1, of ``q1 q2 q3 qc``."""
    q1, q2, q3, qc = q
    return np.array(
        [
            [q1**2 - q2**2 - q3**2 + qc**2, 2 * (q1 * q2 + q3 * qc), 2 * (q1 * q3 - q2 * qc)],
            [2 * (q1 * q2 - q3 * qc), -(q1**2) + q2**2 - q3**2 + qc**2, 2 * (q2 * q3 + q1 * qc)],
            [2 * (q1 * q3 + q2 * qc), 2 * (q2 * q3 - q1 * qc), -(q1**2) - q2**2 + q3**2 + qc**2],
        ]
    )


def aem_of(rows: list[str], version: str = "1.0", **changes: str | None) -> str:
    fields = {
        "OBJECT_NAME": "SAT", "OBJECT_ID": "2026-001A", "CENTER_NAME": "EARTH", "REF_FRAME_A": "EME2000",
        "REF_FRAME_B": "SC_BODY_1", "ATTITUDE_DIR": "A2B", "TIME_SYSTEM": "UTC", "START_TIME": stamp(0),
        "STOP_TIME": stamp(10), "ATTITUDE_TYPE": "QUATERNION", "QUATERNION_TYPE": "LAST", **changes,
    }  # fmt: skip
    keys = [f"{key} = {value}" for key, value in fields.items() if value is not None]
    head = [f"CCSDS_AEM_VERS = {version}", "CREATION_DATE = 2026-03-19T00:00:00", "ORIGINATOR = TEST", "META_START"]
    return "\n".join([*head, *keys, "META_STOP", "DATA_START", *rows, "DATA_STOP", ""])


Q = np.array([[0.56748, 0.03146, 0.45689, 0.68427], [-0.2, 0.4, 0.1, 0.88882]])
Q /= np.linalg.norm(Q, axis=1)[:, None]


def rows_of(q: np.ndarray) -> list[str]:
    return [f"{stamp(t)} " + " ".join(f"{x:.15f}" for x in one) for t, one in zip((0.0, 10.0), q, strict=True)]


def test_an_attitude_is_the_matrix_of_the_standard_whichever_way_it_is_written(tmp_path: Path) -> None:
    expected = np.array([matrix_of_the_standard(q) for q in Q])
    conjugate = Q * [-1, -1, -1, 1]
    turned = {"REF_FRAME_A": "SC_BODY_1", "REF_FRAME_B": "EME2000"}
    for text in (
        aem_of(rows_of(Q)),
        aem_of(rows_of(np.roll(Q, 1, axis=1)), QUATERNION_TYPE="FIRST"),
        aem_of(rows_of(conjugate), ATTITUDE_DIR="B2A"),
        aem_of(rows_of(conjugate), **turned),
        aem_of(rows_of(Q), **turned, ATTITUDE_DIR="B2A"),
        aem_of(rows_of(Q), "2.0", ATTITUDE_DIR=None, QUATERNION_TYPE=None),
        aem_of(
            [f"{row} 0.1 0.2 0.3" for row in rows_of(Q)], "2.0", ATTITUDE_DIR=None, ATTITUDE_TYPE="QUATERNION/ANGVEL"
        ),
    ):
        found = attitude_of_aem(written(tmp_path, "sat.aem", text))
        assert np.abs(found.body_from_gcrs(EPOCH, np.array([0.0, 10.0])) - expected).max() < 1e-12


def test_half_way_a_body_has_made_half_of_its_turn(tmp_path: Path) -> None:
    turn = Rotation.from_rotvec([0.3, -0.7, 0.4])
    both = np.array([Q[0], (Rotation.from_quat(Q[0]) * turn).as_quat()])
    found = attitude_of_aem(written(tmp_path, "sat.aem", aem_of(rows_of(both))))
    begin, half = found.body_from_gcrs(EPOCH, np.array([0.0, 5.0]))
    # The standard's matrices turn components, and the other way than the vectors that the turn is of.
    assert np.allclose(half, Rotation.from_rotvec([-0.15, 0.35, -0.2]).as_matrix() @ begin, atol=1e-12)


def test_an_attitude_in_xml_is_that_in_kvn(tmp_path: Path) -> None:
    states = "".join(
        f"<attitudeState><quaternionState><EPOCH>{stamp(t)}</EPOCH><quaternion>"
        + "".join(f"<{key}>{x!r}</{key}>" for key, x in zip(("Q1", "Q2", "Q3", "QC"), map(float, q), strict=True))
        + "</quaternion></quaternionState></attitudeState>"
        for t, q in zip((0.0, 10.0), Q, strict=True)
    )
    metadata = "".join(
        f"<{key}>{value}</{key}>"
        for key, value in {
            "REF_FRAME_A": "ICRF", "REF_FRAME_B": "SC_BODY_1", "ATTITUDE_DIR": "A2B", "TIME_SYSTEM": "UTC",
            "ATTITUDE_TYPE": "QUATERNION",
        }.items()
    )  # fmt: skip
    text = (
        f'<?xml version="1.0"?><aem id="CCSDS_AEM_VERS" version="1.0"><body><segment><metadata>{metadata}</metadata>'
        f"<data>{states}</data></segment></body></aem>"
    )
    found = attitude_of_aem(written(tmp_path, "sat.xml", text))
    assert np.allclose(found.body_from_gcrs(EPOCH, np.zeros(1))[0], matrix_of_the_standard(Q[0]), atol=1e-12)


def test_what_is_written_is_read_by_another_library_and_by_us(tmp_path: Path) -> None:
    q_body_from_gcrs = Rotation.random(5, random_state=3).as_quat()
    times = [EPOCH + timedelta(seconds=0.25 * k) for k in range(5)]
    text = aem_text(times, q_body_from_gcrs, name="SAT", created_utc=EPOCH, comments=["of a test"])
    found = attitude_of_aem(written(tmp_path, "out.aem", text))
    matrices = Rotation.from_quat(q_body_from_gcrs).as_matrix()
    assert np.abs(found.body_from_gcrs(EPOCH, 0.25 * np.arange(5)) - matrices).max() < 1e-10
    ndm_io = pytest.importorskip(
        "ccsds_ndm.ndm_io", reason="another reader of attitude messages: pip install ccsds-ndm"
    )
    states = ndm_io.NdmIo().from_string(text).body.segment[0].data.attitude_state
    for state, matrix, time in zip(states, matrices, times, strict=True):
        q = state.quaternion_state.quaternion
        components = np.array([float(getattr(q, key)) for key in ("q1", "q2", "q3", "qc")])
        assert np.abs(matrix_of_the_standard(components) - matrix).max() < 1e-10
        assert utc_at(instant_of(state.quaternion_state.epoch, "")) == time


def test_tables_say_axes_units_and_direction_in_their_columns(tmp_path: Path) -> None:
    r, v = circle(TIMES)
    names = "time_utc,x_gcrs_km,y_gcrs_km,z_gcrs_km"
    rows = [
        f"{stamp(t)}Z," + ",".join(f"{x:.9f}" for x in (*one, *two)) for t, one, two in zip(TIMES, r, v, strict=True)
    ]
    moving = written(tmp_path, "a.csv", f"{names},vx_gcrs_km_s,vy_gcrs_km_s,vz_gcrs_km_s\n" + "\n".join(rows))
    assert off_m(orbit_of_csv(moving))[0] < 1e-3
    still = written(
        tmp_path, "b.csv", f"# no velocities\n{names}\n" + "\n".join(",".join(row.split(",")[:4]) for row in rows)
    )
    assert off_m(orbit_of_csv(still))[0] < 2e-2
    assert off_m(orbit_of_csv(still))[1] < 2e-3
    head = "time_utc," + ",".join(f"q_body_from_gcrs_{c}" for c in "xyzw")
    rows = [f"{stamp(t)}," + ",".join(f"{x:.12f}" for x in q) for t, q in zip((0.0, 10.0), Q, strict=True)]
    found = attitude_of_csv(written(tmp_path, "c.csv", "\n".join([head, *rows])))
    assert np.allclose(found.body_from_gcrs(EPOCH, np.zeros(1))[0], Rotation.from_quat(Q[0]).as_matrix(), atol=1e-10)


@pytest.mark.parametrize(
    ("reader", "text", "line"),
    [
        (orbit_of_oem, oem_of(TIMES, "RTN"), "REF_FRAME: axes 'RTN'"),
        (orbit_of_oem, oem_of(TIMES)[:300], 'found "INTERPOLATIO"'),
        (orbit_of_oem, oem_of(TIMES, states=lambda t: tuple(x / 1e3 for x in circle(t))), "are these kilometres?"),
        (attitude_of_aem, aem_of(rows_of(Q), REF_FRAME_B="ICRF"), "EME2000 and ICRF"),
        (attitude_of_aem, aem_of(rows_of(Q)[::-1]), "is not after the row before"),
        (attitude_of_aem, aem_of([f"{stamp(0)} 0 0 one 1"]), 'Q3: found "one"'),
        (attitude_of_aem, aem_of(rows_of(Q), "3.0"), 'CCSDS_AEM_VERS: found "3.0"'),
        (orbit_of_csv, "time_utc,x,y,z\n", "columns time_utc, x, y, z"),
        (orbit_of_csv, "time_utc,x_itrs_km,y_itrs_km,z_itrs_km\nnoon,7000,0,0\n", "line 2, column time_utc"),
        (orbit_of_csv, "time_utc,x_itrs_km,y_itrs_km,z_itrs_km\n2026-03-20T12:00:00,7000,0,0\n", "1 states"),
    ],
)
def test_what_cannot_be_flown_is_one_line(tmp_path: Path, reader, text: str, line: str) -> None:
    path = written(tmp_path, "bad.txt", text)
    with pytest.raises(UserError) as found:
        reader(path)
    assert line in str(found.value)
    assert str(path) in str(found.value)


def test_a_time_outside_the_file_is_refused(tmp_path: Path) -> None:
    found = orbit_of_oem(written(tmp_path, "sat.oem", oem_of(TIMES)))
    with pytest.raises(UserError, match="no state for 2026-03-20T12:20:01"):
        found.states(np.array([1201.0]))


def test_the_way_across_a_gap_is_refused_and_that_beside_it_is_not(tmp_path: Path) -> None:
    times = np.array([*np.arange(0.0, 601.0, 60.0), *np.arange(2400.0, 3001.0, 60.0)])
    found = orbit_of_oem(written(tmp_path, "sat.oem", oem_of(times)))
    assert off_m(found, np.array([597.0, 600.0, 2400.0, 2403.0]))[0] < 0.01
    with pytest.raises(UserError, match=r"no state for 2026-03-20T12:15:00.*12:00:00.* to .*12:10:00.*12:40:00"):
        found.states(np.array([900.0]))


@pytest.mark.parametrize(("velocities", "step"), [(True, 870.0), (True, 960.0), (False, 390.0), (False, 510.0)])
def test_what_is_no_gap_is_right_to_what_is_said(velocities: bool, step: float) -> None:
    """The remainder's estimate, against the circle itself: some intervals are given up, the others hold 100 m."""
    times = step * np.arange(13.0)
    r, v = (1e3 * x for x in circle(times))
    piece = piece_of("gcrs", EPOCH, times, r, v if velocities else None, "")
    found = Trajectory(EPOCH, (piece,), "")
    t = np.linspace(0.0, times[-1], 500)
    known = np.isfinite(found.coverage.around(t)[0])
    assert 0.3 < known.mean() < 1.0
    off = np.linalg.norm(found.states(t[known])[0] - 1e3 * circle(t[known])[0], axis=1)
    assert 10.0 < off.max() < 110.0


def test_what_a_message_calls_unusable_is_not_flown(tmp_path: Path) -> None:
    usable = f"USEABLE_START_TIME = {stamp(120)}\nUSEABLE_STOP_TIME = {stamp(600)}\n"
    found = orbit_of_oem(
        written(tmp_path, "sat.oem", oem_of(TIMES).replace("INTERPOLATION =", usable + "INTERPOLATION ="))
    )
    assert found.span_s == (120.0, 600.0)
    assert off_m(found, np.linspace(120.0, 600.0, 9))[0] < 1e-3
    attitude = attitude_of_aem(
        written(tmp_path, "sat.aem", aem_of(rows_of(Q), USEABLE_START_TIME=stamp(0), USEABLE_STOP_TIME=stamp(4)))
    )
    for ask in (lambda t: found.states(np.array([t])), lambda t: attitude.body_from_gcrs(EPOCH, np.array([t]))):
        with pytest.raises(UserError, match=r"no (state|attitude) for"):
            ask(10.0)


def slow_turn(times: np.ndarray, rate_deg_s: float = 0.06) -> list[str]:
    q = Rotation.from_euler("y", rate_deg_s * times[:, None], degrees=True).as_quat()
    return [f"{stamp(t)} " + " ".join(f"{x:.15f}" for x in one) for t, one in zip(times, q, strict=True)]


def test_attitudes_are_not_known_across_gaps_and_segments(tmp_path: Path) -> None:
    early, late = np.arange(0.0, 101.0, 10.0), np.arange(300.0, 401.0, 10.0)
    one = aem_of(slow_turn(np.concatenate([early, late])))
    second = aem_of(slow_turn(late, -0.06))
    two = aem_of(slow_turn(early)) + second[second.index("META_START") :]
    fast = aem_of(slow_turn(early, 10.0))
    for text, known, unknown in ((one, 95.0, 200.0), (two, 305.0, 200.0), (fast, 10.0, 15.0)):
        found = attitude_of_aem(written(tmp_path, "sat.aem", text))
        assert np.isfinite(found.body_from_gcrs(EPOCH, np.array([known]))).all()
        with pytest.raises(UserError, match="no attitude for"):
            found.body_from_gcrs(EPOCH, np.array([unknown]))
    # Held still, a long interval is none.
    still = attitude_of_aem(written(tmp_path, "sat.aem", aem_of(slow_turn(np.array([0.0, 1.0, 2.0, 900.0]), 0.0))))
    assert np.allclose(still.body_from_gcrs(EPOCH, np.array([450.0])), np.eye(3))
