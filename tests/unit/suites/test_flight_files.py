"""Orbits from files: the same flight as that of the elements that the files were made of."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from horizonval.core.errors import UserError
from horizonval.formats.attitude import aem_text
from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.orbit import ElementSet, gcrs_states, lvlh_matrices
from horizonval.spec.orbit import OrbitSpec
from horizonval.suites.flight import fly

LINES = [
    "1 25544U 98067A   26079.50000000  .00012000  00000-0  22000-3 0  9999",
    "2 25544  51.6400 208.9163 0006703 130.5360 325.0288 15.49560000 00010",
]
EPOCH = datetime(2026, 3, 20, 12, tzinfo=UTC)
SPAN_S, N = 900.0, 6
ANGLES_DEG = (20.0, -5.0, 3.0)
"""Yaw, pitch, roll of the body, as the elements' flight has them and as the files do."""


def flown(beside: Path = Path(), **keys: object) -> list[dict]:
    spec = OrbitSpec.model_validate({"duration_s": SPAN_S, "n": N, **keys})
    return fly(spec, WGS84, 1, "orbit", beside)


def states(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return gcrs_states(ElementSet(*LINES), EPOCH, t)


def quaternions(t: np.ndarray) -> np.ndarray:
    """Return ``q_body_from_gcrs`` of a body at the angles against the local vertical, by its axes' own turns."""
    yaw, pitch, roll = np.radians(ANGLES_DEG)
    body_from_lvlh = Rotation.from_euler("ZYX", [yaw, pitch, roll]).inv().as_matrix()
    return Rotation.from_matrix(body_from_lvlh @ lvlh_matrices(*states(t))).as_quat()


def text_of(t: float) -> str:
    return (EPOCH + timedelta(seconds=float(t))).replace(tzinfo=None).isoformat(timespec="microseconds")


def same(found: list[dict], expected: list[dict]) -> None:
    """Check places to a metre, and angles to an arc second.

    SGP4's velocities are not the derivatives of its positions, by 15 mm/s: half an arc second of heading.
    """
    near = {"latitude_deg": 1e-5, "longitude_deg": 1e-5, "altitude_km": 1e-3, "heading_deg": 3e-4}
    for one, other in zip(found, expected, strict=True):
        assert one["platform"]["epoch_utc"] == other["platform"]["epoch_utc"]
        for key, tolerance in near.items():
            assert one["platform"][key] == pytest.approx(other["platform"][key], abs=tolerance), key
        for key in ("yaw_deg", "pitch_deg", "roll_deg"):
            assert one["attitude"][key] == pytest.approx(other["attitude"][key], abs=3e-4), key


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("files")
    coarse, fine = np.arange(0.0, SPAN_S + 1.0, 60.0), np.arange(0.0, SPAN_S + 1.0, 10.0)
    both = np.hstack(states(coarse)) / 1e3
    rows = [f"{text_of(t)}Z,{','.join(f'{x:.9f}' for x in state)}" for t, state in zip(coarse, both, strict=True)]
    names = "time_utc,x_gcrs_km,y_gcrs_km,z_gcrs_km,vx_gcrs_km_s,vy_gcrs_km_s,vz_gcrs_km_s"
    (folder / "orbit.csv").write_text("\n".join([names, *rows]) + "\n")
    head = ["CCSDS_OEM_VERS = 2.0", "CREATION_DATE = 2026-03-19T00:00:00", "ORIGINATOR = TEST", "META_START"]
    head += ["OBJECT_NAME = SAT", "OBJECT_ID = 2026-001A", "CENTER_NAME = EARTH", "REF_FRAME = ICRF"]
    head += ["TIME_SYSTEM = UTC", f"START_TIME = {text_of(0)}", f"STOP_TIME = {text_of(SPAN_S)}", "META_STOP"]
    (folder / "sat.oem").write_text(
        "\n".join([*head, *(row.replace("Z,", " ").replace(",", " ") for row in rows)]) + "\n"
    )
    times = [EPOCH + timedelta(seconds=float(t)) for t in fine]
    (folder / "sat.aem").write_text(aem_text(times, quaternions(fine), name="SAT", created_utc=EPOCH))
    columns = "time_utc," + ",".join(f"q_body_from_gcrs_{c}" for c in "xyzw")
    rows = [f"{text_of(t)},{','.join(f'{x:.12f}' for x in q)}" for t, q in zip(fine, quaternions(fine), strict=True)]
    (folder / "attitude.csv").write_text("\n".join([columns, *rows]) + "\n")
    return folder


@pytest.mark.parametrize(("orbit", "attitude"), [("sat.oem", "sat.aem"), ("orbit.csv", "attitude.csv")])
def test_files_fly_as_the_elements_that_they_were_made_of(files: Path, orbit: str, attitude: str) -> None:
    expected = flown(tle=LINES, epoch_utc=EPOCH, attitude={"offset_deg": ANGLES_DEG})
    found = flown(files, ephemeris=orbit, attitude={"file": attitude})
    same(found, expected)
    for one in found:
        assert np.abs(one["attitude"].get("rate_deg_s", [0.0] * 3)).max() < 2e-4


def test_a_later_start_and_the_files_own_end(files: Path) -> None:
    whole = flown(files, ephemeris="orbit.csv", duration_s=None)
    assert whole[-1]["platform"]["epoch_utc"] == EPOCH + timedelta(seconds=750)
    later = flown(files, ephemeris="orbit.csv", duration_s=None, epoch_utc=EPOCH + timedelta(seconds=300))
    assert later[0]["platform"] == whole[2]["platform"]


def test_a_rate_is_whole_at_the_ends_of_the_files(files: Path) -> None:
    """A body that keeps still among the stars turns against the local vertical alike at the first sample and later."""
    held = files / "held.csv"
    columns = "time_utc," + ",".join(f"q_body_from_gcrs_{c}" for c in "xyzw")
    held.write_text("\n".join([columns, *(f"{text_of(t)},0,0,0,1" for t in (0.0, SPAN_S))]) + "\n")
    rates = [
        np.linalg.norm(one["attitude"]["rate_deg_s"])
        for one in flown(files, ephemeris="orbit.csv", attitude={"file": "held.csv"})
    ]
    assert rates == pytest.approx([360.0 * 15.4956 / 86400.0] * N, rel=0.01)
    tumbling = flown(files, ephemeris="orbit.csv", attitude={"tumble_deg_s": (0.1, 0.0, 0.0)})
    assert tumbling[0]["attitude"]["rate_deg_s"] == pytest.approx([0.1, 0.0, 0.0], abs=1e-6)


def test_what_does_not_go_together_is_refused(files: Path) -> None:
    with pytest.raises(UserError, match="no state for 2026-03-20T11:59"):
        flown(files, ephemeris="orbit.csv", epoch_utc=EPOCH - timedelta(seconds=60))
    with pytest.raises(UserError, match="no state for 2026-03-20T12:20"):
        flown(files, ephemeris="orbit.csv", duration_s=2 * SPAN_S)
    with pytest.raises(UserError, match="a file of states has no revolutions"):
        flown(files, ephemeris="orbit.csv", duration_s=None, revolutions=1.0)
    with pytest.raises(UserError, match="no attitude for"):
        flown(files, tle=LINES, epoch_utc=EPOCH + timedelta(days=1), attitude={"file": "sat.aem"})
    for keys, line in (
        ({"ephemeris": "orbit.csv", "altitude_km": 500.0}, "ephemeris says the whole orbit"),
        ({"ephemeris": "orbit.csv", "tle": LINES}, "tle says the whole orbit"),
        ({"tle": LINES, "attitude": {"file": "a.csv", "pointing": "sun"}}, "file says the whole attitude"),
        ({"kernels": ["a.bsp"]}, "kernels and spacecraft go together"),
        ({"tle": LINES, "attitude": {"body_axes": "SAT"}}, "body_axes goes with kernels"),
    ):
        with pytest.raises(ValueError, match=line):
            OrbitSpec.model_validate({"n": 2, **keys})


@pytest.fixture(scope="module")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with kernels of the same flight, written by SPICE itself."""
    spice = pytest.importorskip("spiceypy")
    folder = tmp_path_factory.mktemp("kernels")
    leap = "KPL/LSK\n\\begindata\nDELTET/DELTA_T_A = 32.184\nDELTET/K = 1.657D-3\nDELTET/EB = 1.671D-2\n"
    leap += "DELTET/M = ( 6.239996D0 1.99096871D-7 )\nDELTET/DELTA_AT = ( 37, @2017-JAN-1 )\n\\begintext\n"
    (folder / "leap.tls").write_text(leap)
    clock = "KPL/SCLK\n\\begindata\nSCLK_KERNEL_ID = ( @2026-01-01 )\nSCLK_DATA_TYPE_999 = ( 1 )\n"
    clock += "SCLK01_TIME_SYSTEM_999 = ( 2 )\nSCLK01_N_FIELDS_999 = ( 2 )\nSCLK01_MODULI_999 = ( 4294967296 65536 )\n"
    clock += "SCLK01_OFFSETS_999 = ( 0 0 )\nSCLK01_OUTPUT_DELIM_999 = ( 2 )\nSCLK_PARTITION_START_999 = ( 0.0 )\n"
    clock += "SCLK_PARTITION_END_999 = ( 2.8E14 )\nSCLK01_COEFFICIENTS_999 = ( 0.0 0.0 1.0 )\n\\begintext\n"
    (folder / "clock.tsc").write_text(clock)
    frame = "KPL/FK\n\\begindata\nFRAME_SAT_BODY = -999000\nFRAME_-999000_NAME = 'SAT_BODY'\nFRAME_-999000_CLASS = 3\n"
    frame += (
        "FRAME_-999000_CLASS_ID = -999000\nFRAME_-999000_CENTER = -999\nCK_-999000_SCLK = -999\nCK_-999000_SPK = -999\n"
    )
    (folder / "frame.tf").write_text(frame + "\\begintext\n")
    t = np.arange(0.0, SPAN_S + 1.0, 10.0)
    loaded = [str(folder / name) for name in ("leap.tls", "clock.tsc", "frame.tf")]
    for name in loaded:
        spice.furnsh(name)
    try:
        et = np.array([spice.str2et(text_of(x)) for x in t])
        r, v = states(t)
        handle = spice.spkopn(str(folder / "orbit.bsp"), "orbit", 0)
        spice.spkw13(handle, -999, 399, "J2000", et[0], et[-1], "orbit", 7, len(t), np.hstack([r, v]) / 1e3, et)
        spice.spkcls(handle)
        matrices = Rotation.from_quat(quaternions(t)).as_matrix()
        ticks = np.array([spice.sce2c(-999, x) for x in et])
        handle = spice.ckopn(str(folder / "body.bc"), "attitude", 0)
        q = np.array([spice.m2q(m) for m in matrices])
        still, begin, end = np.zeros((len(t), 3)), ticks[0], ticks[-1]
        spice.ckw03(handle, begin, end, -999000, "J2000", False, "body", len(t), ticks, q, still, 1, [begin])
        spice.ckcls(handle)
    finally:
        for name in loaded:
            spice.unload(name)
    return folder


KERNELS = ["leap.tls", "clock.tsc", "frame.tf", "orbit.bsp", "body.bc"]


def test_kernels_fly_as_the_elements_that_they_were_made_of(kernels: Path) -> None:
    expected = flown(tle=LINES, epoch_utc=EPOCH, attitude={"offset_deg": ANGLES_DEG})
    body = {"body_axes": "SAT_BODY"}
    found = flown(kernels, kernels=KERNELS, spacecraft="-999", epoch_utc=EPOCH, attitude=body)
    same(found[1:], expected[1:])


def test_what_kernels_do_not_hold_is_one_line(kernels: Path) -> None:
    for keys, line in (
        ({"kernels": ["leap.tls", "orbit.bsp"], "spacecraft": "-998"}, "no states of '-998'"),
        ({"kernels": ["leap.tls", "orbit.bsp"], "spacecraft": "NOBODY"}, "SPICE"),
        ({"kernels": ["orbit.bsp"], "spacecraft": "-999"}, "SPICE"),
        ({"kernels": ["leap.tls", "none.bsp"], "spacecraft": "-999"}, "none.bsp"),
        ({"kernels": KERNELS, "spacecraft": "-999", "attitude": {"body_axes": "OTHER"}}, "SPICE"),
    ):
        with pytest.raises(UserError) as found:
            flown(kernels, duration_s=100.0, **keys)
        assert line in str(found.value)
