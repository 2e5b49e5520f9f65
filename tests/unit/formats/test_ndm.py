"""Messages of CCSDS and catalogues of elements: every key has its meaning or is refused, and one thing is one thing."""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from astropy import units
from astropy.time import Time
from scipy.spatial.transform import Rotation
from sgp4.api import Satrec

from horizonval.core.errors import UserError
from horizonval.formats.aem import attitude_of_aem
from horizonval.formats.ndm import HARMLESS, READ, kinds_of
from horizonval.formats.oem import orbit_of_oem
from horizonval.formats.omm import satellite_of_omm
from horizonval.geometry.clock import SYSTEMS, elapsed_s
from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.orbit import lvlh_matrices
from horizonval.spec.orbit import OrbitSpec
from horizonval.suites.flight import fly

EPOCH = datetime(2026, 3, 20, 12, 0, 0, tzinfo=UTC)
LINES = (
    "1 25544U 98067A   26079.50000000  .00012000  00000-0  22000-3 0  9999",
    "2 25544  51.6400 208.9163 0006703 130.5360 325.0288 15.49560000 00010",
)
METADATA = {
    "OBJECT_NAME": "ISS (ZARYA)", "OBJECT_ID": "1998-067A", "CENTER_NAME": "EARTH", "REF_FRAME": "TEME",
    "TIME_SYSTEM": "UTC", "MEAN_ELEMENT_THEORY": "SGP4",
}  # fmt: skip
ELEMENTS = {
    "EPOCH": "2026-03-20T12:00:00.000000", "MEAN_MOTION": "15.49560000", "ECCENTRICITY": ".0006703",
    "INCLINATION": "51.6400", "RA_OF_ASC_NODE": "208.9163", "ARG_OF_PERICENTER": "130.5360",
    "MEAN_ANOMALY": "325.0288", "EPHEMERIS_TYPE": "0", "CLASSIFICATION_TYPE": "UNCLASSIFIED",
    "NORAD_CAT_ID": "799500766", "ELEMENT_SET_NO": "999", "REV_AT_EPOCH": "1", "BSTAR": ".22E-3",
    "MEAN_MOTION_DOT": ".12E-3", "MEAN_MOTION_DDOT": "0",
}  # fmt: skip
OMM = {**METADATA, **ELEMENTS}
RADIUS_KM, RATE = 6928.0, math.sqrt(398600.4418 / 6928.0**3)


def written(folder: Path, text: str | bytes, name: str = "file") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def kvn_of(kind: str, version: str, fields: dict[str, str], rows: list[str] | None = None) -> str:
    """Return a message: mean elements without rows, else a segment with them."""
    keys = "".join(f"{key} = {value}\n" for key, value in fields.items() if value is not None)
    if rows is not None:
        data = "\n".join(rows)
        keys = f"META_START\n{keys}META_STOP\n" + (f"DATA_START\n{data}\nDATA_STOP\n" if kind == "AEM" else f"{data}\n")
    return f"CCSDS_{kind}_VERS = {version}\nCREATION_DATE =\nORIGINATOR = TEST\n{keys}"


def xml_of(kind: str, version: str, metadata: dict[str, str], data: str) -> str:
    tags = "".join(f"<{key}>{value}</{key}>\n" for key, value in metadata.items() if value is not None)
    return (
        f'<{kind} id="CCSDS_{kind.upper()}_VERS" version="{version}"><header><CREATION_DATE/><ORIGINATOR/></header>\n'
        f"<body><segment><metadata>{tags}</metadata>\n<data>{data}</data></segment></body></{kind}>"
    )


def omm_xml(fields: dict[str, str] = OMM) -> str:
    groups = "".join(f"<{key}>{value}</{key}>" for key, value in fields.items() if key not in METADATA)
    return xml_of(
        "omm", "2.0", {key: fields[key] for key in METADATA if key in fields}, f"<meanElements>{groups}</meanElements>"
    )


def csv_of(*sets: dict[str, str], quoting: int = csv.QUOTE_MINIMAL) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(sets[0]), quoting=quoting)
    writer.writeheader()
    writer.writerows(sets)
    return text.getvalue()


CATALOGUE = {"OBJECT_NAME": "ISS (ZARYA)", "OBJECT_ID": "1998-067A", **ELEMENTS}
OTHER = {**OMM, "OBJECT_NAME": "B", "OBJECT_ID": "2020-001A", "NORAD_CAT_ID": "7", "BSTAR": "0.01"}
AS_NUMBERS = {k: float(v) if k not in ("EPOCH",) and v[0] in ".0123456789" and k[:6] != "OBJECT" else v
              for k, v in CATALOGUE.items()}  # fmt: skip


@pytest.mark.parametrize(
    "text",
    [
        kvn_of("OMM", "2.0", OMM),
        kvn_of("OMM", "3.0", {"MESSAGE_ID": "7", **OMM, "MASS": "300 [kg]", "USER_DEFINED_X": "1", "CX_X": "1"}),
        kvn_of("OMM", "2.0", {**OMM, "MEAN_MOTION": "15.4956 [rev/day]"}).replace("\n", "\r\n"),
        omm_xml(),
        f'<?xml version="1.0"?><ndm xmlns="urn:ccsds:schema:ndmxml">{omm_xml()}</ndm>',
        omm_xml().replace("<", "<n:").replace("<n:/", "</n:").replace("<n:omm", '<n:omm xmlns:n="urn:x"'),
        ('<?xml version="1.0" encoding="UTF-16"?>' + omm_xml()).encode("utf-16"),
        json.dumps([CATALOGUE]),
        json.dumps(AS_NUMBERS),
        json.dumps([{k.lower(): v for k, v in OMM.items()} | {"tle_line1": LINES[0], "decay_date": None}]),
        "\ufeff" + csv_of(CATALOGUE),
        csv_of({**CATALOGUE, "PERIOD": "92.9", "FILE": "1"}, quoting=csv.QUOTE_ALL),
        kvn_of("OMM", "2.0", {**OMM, "TIME_SYSTEM": "TAI", "EPOCH": "2026-079T12:00:37"}),
    ],
)  # fmt: skip
def test_one_set_of_elements_is_the_same_orbit_however_it_is_written(tmp_path: Path, text: str | bytes) -> None:
    path = written(tmp_path, text)
    assert kinds_of(path) == ["omm"]
    found, expected = satellite_of_omm(path)[0], Satrec.twoline2rv(*LINES)
    for day in (0.0, 1.0):
        jd = (expected.jdsatepoch + day, expected.jdsatepochF)
        assert np.abs(np.subtract(found.sgp4(*jd)[1], expected.sgp4(*jd)[1])).max() < 1e-6
    for satellite in ("iss (zarya)", "1998-067A", "799500766"):
        assert satellite_of_omm(path, satellite)[0].bstar == found.bstar


SEVERAL = [
    kvn_of("OMM", "2.0", OMM) + kvn_of("OMM", "2.0", OTHER),
    f"<ndm>{omm_xml()}{omm_xml(OTHER)}</ndm>",
    json.dumps([OMM, OTHER]),
    csv_of(OMM, OTHER),
]


@pytest.mark.parametrize("text", SEVERAL)
def test_of_several_satellites_one_is_chosen_and_none_is_filled_from_another(tmp_path: Path, text: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(UserError, match=r"of 2 satellites: ISS \(ZARYA\) \(799500766\), B \(7\)"):
        satellite_of_omm(path)
    assert [satellite_of_omm(path, name)[0].bstar for name in ("B", "007", "799500766")] == [0.01, 0.01, 0.00022]
    with pytest.raises(UserError, match=r"no elements of 'C'; expected one of ISS"):
        satellite_of_omm(path, "C")
    twice = written(tmp_path, text.replace("2020-001A", "1998-067A"))
    with pytest.raises(UserError, match="of 2 satellites"):
        satellite_of_omm(twice, "1998-067A")


def test_what_the_first_message_lacks_is_not_taken_from_the_second(tmp_path: Path) -> None:
    first = {key: value for key, value in OMM.items() if key != "BSTAR"}
    for text in (
        kvn_of("OMM", "2.0", first) + kvn_of("OMM", "2.0", OTHER),
        f"<ndm>{omm_xml(first)}{omm_xml(OTHER)}</ndm>",
    ):
        satellite, doubt = satellite_of_omm(written(tmp_path, text), "799500766")
        assert satellite.bstar == 0.0
        assert "BSTAR is missing: no drag" in doubt
    later = {**OMM, "EPOCH": "2026-03-21T00:00:00"}
    with pytest.raises(UserError, match=r"2 element sets of ISS.*2026-03-20T12:00:00.000000, 2026-03-21T00:00:00"):
        satellite_of_omm(written(tmp_path, json.dumps([OMM, later])), "799500766")


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"EPHEMERIS_TYPE": "4"}, "EPHEMERIS_TYPE: found 4; expected 0, 2 or 3, of SGP4; 4 is SGP4-XP"),
        ({"MEAN_ELEMENT_THEORY": "SGP4-XP"}, 'MEAN_ELEMENT_THEORY: found "SGP4-XP"'),
        ({"MEAN_ELEMENT_THEORY": "DSST"}, 'MEAN_ELEMENT_THEORY: found "DSST"'),
        ({"BTERM": "0.01"}, "BTERM: is a term of SGP4-XP"),
        ({"CENTER_NAME": "MARS"}, 'CENTER_NAME: found "MARS"; expected EARTH'),
        ({"CENTER_NAME": ""}, "CENTER_NAME: is empty"),
        ({"REF_FRAME": "EME2000"}, 'REF_FRAME: found "EME2000"; expected TEME'),
        ({"REF_FRAME_EPOCH": "2000-001T12:00:00"}, "REF_FRAME_EPOCH: is not a key of SGP4's elements"),
        ({"SEMI_MAJOR_AXIS": "6800"}, "SEMI_MAJOR_AXIS: is not a key of SGP4's elements"),
        ({"GM": "42828.3"}, "GM: found 42828.3"),
        ({"TIME_SYSTEM": "MRT"}, 'TIME_SYSTEM: found "MRT"'),
        ({"ECCENTRICITY": "nan"}, 'ECCENTRICITY: found "nan"; expected a number from 0 to 1'),
        ({"ECCENTRICITY": "6703"}, "ECCENTRICITY: found 6703"),
        ({"MEAN_MOTION": "15_4"}, 'MEAN_MOTION: found "15_4"'),
        ({"MEAN_MOTION": "0.0676"}, ""),
        ({"INCLINATION": "5.164D1"}, 'INCLINATION: found "5.164D1"'),
        ({"EPOCH": "2026-000T12:00:00"}, 'EPOCH: found "2026-000T12:00:00"'),
        ({"INCLINATON": "51.64"}, "INCLINATON: is not a key of"),
        ({"DRAG_TERM": "1"}, "DRAG_TERM: is not a key of"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("form", ["kvn", "xml", "json", "csv"])
def test_a_key_that_means_another_orbit_is_refused_by_name(
    tmp_path: Path, form: str, changes: dict[str, str], line: str
) -> None:
    fields = {**OMM, **changes}
    text = {
        "kvn": kvn_of("OMM", "2.0", fields), "xml": omm_xml(fields), "json": json.dumps(fields), "csv": csv_of(fields),
    }[form]  # fmt: skip
    path = written(tmp_path, text)
    if not line or (form in ("json", "csv") and "" in changes.values()):
        satellite_of_omm(path)  # Right, or left out by these forms.
        return
    with pytest.raises(UserError) as found:
        satellite_of_omm(path)
    assert line in str(found.value).replace("mean elements", "an orbit mean-elements message")
    assert f"{path}: " in str(found.value)


def circle(t: np.ndarray) -> np.ndarray:
    """Return the states of a circular orbit over the poles, shape (n, 6) [km, km/s]."""
    cos, sin, zero = np.cos(RATE * t), np.sin(RATE * t), 0.0 * t
    return RADIUS_KM * np.stack([cos, zero, sin, -RATE * sin, zero, RATE * cos], axis=1)


T = 60.0 * np.arange(5)
OEM = {
    "OBJECT_NAME": "SAT", "OBJECT_ID": "2026-001A", "CENTER_NAME": "Earth", "REF_FRAME": "GCRF", "TIME_SYSTEM": "UTC",
    "START_TIME": "2026-03-20T12:00:00", "STOP_TIME": "2026-03-20T12:04:00",
}  # fmt: skip


def stamps(t: np.ndarray, scale: str = "utc", offset_s: float = 0.0, start: str = "2026-03-20T12:00:00") -> list[str]:
    """Return times, seconds of UTC after the start, as the clock of another system shows them (astropy)."""
    times = getattr(Time(start, scale="utc", precision=9) + t * units.s, scale) + offset_s * units.s
    return list(times.isot)


def oem_rows(times: list[str], states: np.ndarray, more: str = "") -> list[str]:
    return [f"{time} {' '.join(f'{x:.9f}' for x in state)}{more}" for time, state in zip(times, states, strict=True)]


def oem_xml(times: list[str], states: np.ndarray, more: str = "", metadata: dict[str, str] = OEM) -> str:
    names = ("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")
    rows = "".join(
        f"<stateVector><EPOCH>{time}</EPOCH>"
        + "".join(
            f'<{n} units="{"km" if len(n) == 1 else "km/s"}">{x:.9f}</{n}>' for n, x in zip(names, s, strict=True)
        )
        + f"{more}</stateVector>\n"
        for time, s in zip(times, states, strict=True)
    )
    covariance = "<covarianceMatrix><EPOCH>2026-03-20T12:00:00</EPOCH><CX_X>1</CX_X></covarianceMatrix>"
    return xml_of("oem", "3.0", metadata, f"<COMMENT>none</COMMENT>{rows}{covariance}")


ACCELERATION = "<X_DDOT>0</X_DDOT><Y_DDOT>0</Y_DDOT><Z_DDOT>-0.008</Z_DDOT>"
COVARIANCE = "COVARIANCE_START\nEPOCH = 2026-03-20T12:00:00\nCOV_REF_FRAME = RTN\n1.0\n0 1e-3\nCOVARIANCE_STOP"


@pytest.mark.parametrize(
    "text",
    [
        kvn_of("OEM", "1.0", OEM, oem_rows(stamps(T), circle(T))),
        kvn_of("OEM", "3.0", {"MESSAGE_ID": "1", **OEM}, [*oem_rows(stamps(T), circle(T), " 0 0 -0.008"), COVARIANCE]),
        "<ndm><COMMENT>published</COMMENT>" + oem_xml(stamps(T), circle(T)) + "</ndm>",
        oem_xml(stamps(T), circle(T), ACCELERATION).replace("<oem ", '<oem xmlns="urn:x" '),
    ],
)  # fmt: skip
def test_an_ephemeris_is_the_same_orbit_in_every_form(tmp_path: Path, text: str) -> None:
    found = orbit_of_oem(written(tmp_path, text))
    t = np.linspace(1.0, 239.0, 20)
    assert np.abs(found.states(t)[0] - 1e3 * circle(t)[:, :3]).max() < 1e-3


@pytest.mark.parametrize("system", SYSTEMS)
def test_states_across_a_leap_second_are_a_second_apart(tmp_path: Path, system: str) -> None:
    """To 1 cm: the times of the rows, by astropy, are kept to the microsecond."""
    start, scale = "2016-12-31T23:58:00.5", "tai" if system == "GPS" else system.lower()
    rows = oem_rows(stamps(T, scale, -19.0 if system == "GPS" else 0.0, start), circle(T))
    fields = {**OEM, "TIME_SYSTEM": system, "START_TIME": None, "STOP_TIME": None}
    found = orbit_of_oem(written(tmp_path, kvn_of("OEM", "2.0", fields, rows)))
    offset = elapsed_s(found.epoch_utc, datetime.fromisoformat(f"{start}+00:00"))
    assert abs(offset) < 2e-6
    t = np.linspace(0.0, 239.9, 33)
    assert np.abs(found.states(t + offset)[0] - 1e3 * circle(t)[:, :3]).max() < 0.01


def test_one_of_several_ephemerides_is_chosen(tmp_path: Path) -> None:
    other = {**OEM, "OBJECT_NAME": "B", "OBJECT_ID": "2020-001A"}
    rows = oem_rows(stamps(T), circle(T)), oem_rows(stamps(T), circle(T + 600.0))
    orbits = written(tmp_path, kvn_of("OEM", "2.0", OEM, rows[0]) + kvn_of("OEM", "2.0", other, rows[1]), "orbits")
    both = f"<ndm>{oem_xml(stamps(T), circle(T))}{oem_xml(stamps(T), circle(T + 600.0), metadata=other)}</ndm>"
    for path in (orbits, written(tmp_path, both)):
        for name, shift in (("sat", 0.0), ("2020-001A", 600.0)):
            r = orbit_of_oem(path, name).states(T)[0]
            assert np.abs(r - 1e3 * circle(T + shift)[:, :3]).max() < 1e-3
    text = kvn_of("AEM", "1.0", AEM, PLAIN)
    attitudes = written(tmp_path, text + text.replace("= SAT", "= B").replace("A2B", "B2A"), "attitudes")
    with pytest.raises(UserError, match="ephemerides of 2 satellites"):
        attitude_of_aem(attitudes)
    found = [attitude_of_aem(attitudes, name).body_from_gcrs(EPOCH, np.zeros(1))[0] for name in ("SAT", "B")]
    assert np.abs(found[0] - found[1].T).max() < 1e-12


KVN = kvn_of("OEM", "2.0", OEM, oem_rows(stamps(T), circle(T)))
FIRST_ROW = oem_rows(stamps(T), circle(T))[0]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (KVN.replace("Earth", "MARS BARYCENTER"), 'line 7: CENTER_NAME: found "MARS BARYCENTER"'),
        (KVN.replace("GCRF", "MOD"), "line 8: REF_FRAME: axes 'MOD'"),
        (KVN.replace("= UTC", "= UT1"), 'line 9: TIME_SYSTEM: found "UT1"'),
        (KVN.replace("TIME_SYSTEM", "TIMESYSTEM"), "line 9: TIMESYSTEM: is not a key"),
        (KVN.replace("META_STOP", "MAN_DV_1 = 3\nMETA_STOP"), "line 12: MAN_DV_1: is not a key"),
        (KVN.replace("GCRF", "TOD\nREF_FRAME_EPOCH = 2020-001T00:00:00"), "REF_FRAME_EPOCH: axes of a fixed"),
        (KVN.replace("META_STOP", "OBJECT_ID = 7\nMETA_STOP"), "line 12: OBJECT_ID: is given twice"),
        (KVN.replace("12:04:00\n", "11:04:00\n", 1), "line 11: STOP_TIME: is before START_TIME"),
        (KVN.replace(FIRST_ROW, FIRST_ROW[:-12]), "line 13: 5 values after the time"),
        (KVN.replace(FIRST_ROW, FIRST_ROW + " 0 0 0"), "line 14: 6 numbers; expected 9, as in the first row"),
        (KVN.replace(FIRST_ROW, "GM = 398600\n" + FIRST_ROW), "line 13: GM: is a key between rows"),
        (KVN.replace(FIRST_ROW, COVARIANCE.replace("EPOCH =", "DATE =")), "line 14: DATE: is not a key"),
        (KVN + KVN, "2 messages about SAT (2026-001A): "),
        (KVN + KVN.replace("= SAT", "= B"), "ephemerides of 2 satellites: SAT (2026-001A), B (2026-001A)"),
        (KVN + KVN[KVN.index("META_START") :], "line 18: begins before the usable span of the segment before"),
        (KVN.replace("VERS = 2.0", "VERS = 4.0"), 'line 1: CCSDS_OEM_VERS: found "4.0"; expected 1.0 or 2.0 or 3.0'),
        ("<!DOCTYPE oem [<!ENTITY x 'y'>]>" + oem_xml(stamps(T), circle(T)), "line 1: an XML file with a doc"),
        (oem_xml(stamps(T), circle(T)).replace("<Z ", "<W ").replace("</Z>", "</W>"), "line 10: W: is not a key of"),
        (oem_xml(stamps(T), circle(T), "<X_DDOT>0</X_DDOT>"), "line 10: Y_DDOT: is missing"),
        (oem_xml(stamps(T), circle(T)).replace('"km"', '"m"'), "line 10: X: in 'm'; expected km"),
        (oem_xml(stamps(T), circle(T))[:900], "not XML: "),
        ("<ndm><opm/></ndm>", "holds an orbit parameter message"),
    ],
)  # fmt: skip
def test_an_ephemeris_that_means_something_else_is_refused_with_its_line(tmp_path: Path, text: str, line: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(UserError) as found:
        orbit_of_oem(path)
    assert line in str(found.value)
    assert str(path) in str(found.value)


# ---- Attitudes ----------------------------------------------------------------------------------------------------

AEM = {
    "OBJECT_NAME": "SAT", "OBJECT_ID": "2026-001A", "CENTER_NAME": "EARTH", "REF_FRAME_A": "GCRF",
    "REF_FRAME_B": "SC_BODY_1", "ATTITUDE_DIR": "A2B", "TIME_SYSTEM": "UTC", "ATTITUDE_TYPE": "QUATERNION",
    "QUATERNION_TYPE": "LAST",
}  # fmt: skip
SECOND = {**AEM, "ATTITUDE_DIR": None, "QUATERNION_TYPE": None}
ANGLES = np.array([[20.0, -35.0, 140.0], [21.0, -34.0, 138.5]])


def elementary(axis: str, degrees: float) -> np.ndarray:
    """Return the matrix that takes components to those in a frame turned about one axis (any textbook's R1, R2, R3)."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    rows = {"1": [[1, 0, 0], [0, c, s], [0, -s, c]], "2": [[c, 0, -s], [0, 1, 0], [s, 0, c]],
            "3": [[c, s, 0], [-s, c, 0], [0, 0, 1]]}  # fmt: skip
    return np.array(rows[axis])


SEQUENCES = ["".join(s) for s in itertools.product("123", repeat=3) if s[0] != s[1] != s[2]]


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_euler_angles_are_the_product_of_three_turns(tmp_path: Path, sequence: str) -> None:
    letters = sequence.translate(str.maketrans("123", "XYZ"))
    expected = [
        elementary(sequence[2], a[2]) @ elementary(sequence[1], a[1]) @ elementary(sequence[0], a[0]) for a in ANGLES
    ]
    times = ("2026-03-20T12:00:00", "2026-03-20T12:00:10")
    rows = [f"{time} {a[0]} {a[1]} {a[2]}" for time, a in zip(times, ANGLES, strict=True)]
    euler = {"ATTITUDE_TYPE": "EULER_ANGLE", "QUATERNION_TYPE": None, "EULER_ROT_SEQ": sequence}
    turned = {"REF_FRAME_A": "SC_BODY", "REF_FRAME_B": "GCRF", "ATTITUDE_DIR": "B2A"}
    numbered = "".join(
        f"<attitudeState><eulerAngle><EPOCH>{time}</EPOCH><rotationAngles>"
        + "".join(f'<rotation{k + 1} angle="{letters[k]}_ANGLE" units="deg">{a[k]}</rotation{k + 1}>' for k in range(3))
        + "</rotationAngles></eulerAngle></attitudeState>"
        for time, a in zip(times, ANGLES, strict=True)
    )
    velocity = np.degrees(Rotation.from_matrix(expected[0] @ expected[1].T).as_rotvec()) / 10.0
    in_body = " ".join(f"{x:.9f}" for x in velocity)
    rates = {"ATTITUDE_TYPE": "EULER_ANGLE/ANGVEL", "ANGVEL_FRAME": "REF_FRAME_B"}
    for text in (
        kvn_of("AEM", "1.0", {**AEM, **euler}, rows),
        kvn_of("AEM", "1.0", {**AEM, **euler, **turned}, rows),
        kvn_of("AEM", "2.0", {**SECOND, **euler, "EULER_ROT_SEQ": letters}, rows),
        kvn_of("AEM", "2.0", {**SECOND, **euler, **rates}, [f"{row} {in_body}" for row in rows]),
        xml_of("aem", "1.0", {**AEM, **euler}, numbered),
    ):
        found = attitude_of_aem(written(tmp_path, text))
        assert np.abs(found.body_from_gcrs(EPOCH, np.array([0.0, 10.0])) - expected).max() < 1e-9
    inverse = attitude_of_aem(written(tmp_path, kvn_of("AEM", "1.0", {**AEM, **euler, "ATTITUDE_DIR": "B2A"}, rows)))
    assert np.abs(inverse.body_from_gcrs(EPOCH, np.zeros(1))[0] - expected[0].T).max() < 1e-9
    with pytest.raises(UserError, match=r"ANGLE_1: is about [XYZ]; expected [XYZ], by EULER_ROT_SEQ"):
        attitude_of_aem(
            written(
                tmp_path,
                xml_of(
                    "aem",
                    "1.0",
                    {**AEM, **euler, "EULER_ROT_SEQ": sequence[1:] + {"1": "2", "2": "3", "3": "1"}[sequence[2]]},
                    numbered,
                ),
            )
        )


SPIN = 0.6
"""Turn of the frame about its x and z axes [deg/s]."""


def spinning() -> tuple[np.ndarray, np.ndarray]:
    """Return quaternions of CCSDS and their derivatives, shape (n, 4) each, of a frame that turns evenly."""
    t = 10.0 * np.arange(6)
    axis = np.array([0.6, 0.0, 0.8])
    q = (
        Rotation.from_quat([0.1, 0.2, 0.3, 0.9]) * Rotation.from_rotvec(np.radians(SPIN) * t[:, None] * axis)
    ).as_quat()
    q *= np.sign(np.sum(q * q[:1], axis=1))[:, None]
    w = np.radians(SPIN) * axis
    cross = np.cross(q[:, :3], w)
    dots = 0.5 * np.hstack([q[:, 3:] * w + cross, -(q[:, :3] @ w)[:, None]])
    return q, dots


def aem_rows(*columns: np.ndarray) -> list[str]:
    both = np.hstack(columns)
    times = stamps(10.0 * np.arange(len(both)))
    return [f"{time} " + " ".join(f"{x:.12f}" for x in row) for time, row in zip(times, both, strict=True)]


Q, Q_DOT = spinning()
W_B = np.tile(SPIN * np.array([0.6, 0.0, 0.8]), (6, 1))
W_A = Rotation.from_quat(Q).apply(W_B)
DERIVATIVE, ANGVEL = ({"ATTITUDE_TYPE": f"QUATERNION/{name}"} for name in ("DERIVATIVE", "ANGVEL"))
IN_B = {"ANGVEL_FRAME": "REF_FRAME_B"}


@pytest.mark.parametrize(
    ("version", "changes", "rows", "doubt"),
    [
        ("1.0", {**DERIVATIVE, "QUATERNION_TYPE": "FIRST"}, aem_rows(np.roll(Q, 1, 1), np.roll(Q_DOT, 1, 1)), False),
        ("1.0", DERIVATIVE, aem_rows(Q, Q_DOT), False),
        ("1.0", DERIVATIVE, aem_rows(Q, np.roll(Q_DOT, 1, 1)), True),
        ("2.0", {**ANGVEL, **IN_B}, aem_rows(Q, W_B), False),
        ("2.0", {**ANGVEL, "ANGVEL_FRAME": "GCRF"}, aem_rows(Q, W_A), False),
        ("2.0", {**ANGVEL, **IN_B}, aem_rows(Q, np.radians(W_B)), True),
        ("2.0", {**ANGVEL, **IN_B}, aem_rows(np.roll(Q, 1, 1), W_B), True),
        ("2.0", {**ANGVEL, **IN_B}, aem_rows(Q * [-1, -1, -1, 1], W_B), True),
        ("1.0", {"ATTITUDE_TYPE": "QUATERNION/RATE"}, aem_rows(Q, 5.0 * W_B[:, [1, 0, 2]]), False),
    ],
)  # fmt: skip
def test_rates_that_contradict_the_attitudes_are_a_warning(
    tmp_path: Path, version: str, changes: dict[str, str], rows: list[str], doubt: bool
) -> None:
    path = written(tmp_path, kvn_of("AEM", version, {**(AEM if version == "1.0" else SECOND), **changes}, rows))
    found = attitude_of_aem(path)
    assert ("the rates contradict the attitudes" in found.doubt) == doubt
    if not doubt:
        turned = found.body_from_gcrs(EPOCH, 10.0 * np.arange(6))
        assert np.abs(turned - Rotation.from_quat(Q).inv().as_matrix()).max() < 1e-9


def test_an_attitude_with_rates_is_read_from_xml(tmp_path: Path) -> None:
    """Of the first version, whose rates name their axes."""
    letters = ("Q1", "Q2", "Q3", "QC")
    states = "".join(
        f"<attitudeState><quaternionEulerRate><EPOCH>{time}</EPOCH><quaternion>"
        + "".join(f"<{key}>{x:.12f}</{key}>" for key, x in zip(letters, q, strict=True))
        + "</quaternion><rotationRates>"
        + "".join(
            f'<rotation{k} rate="{"XYZ"[k - 1]}_RATE" units="deg/s">{W_B[0, k - 1]}</rotation{k}>' for k in (1, 2, 3)
        )
        + "</rotationRates></quaternionEulerRate></attitudeState>"
        for time, q in zip(stamps(10.0 * np.arange(6)), Q, strict=True)
    )
    fields = {**AEM, "ATTITUDE_TYPE": "QUATERNION/RATE", "QUATERNION_TYPE": None, "EULER_ROT_SEQ": "123"}
    found = attitude_of_aem(written(tmp_path, xml_of("aem", "1.0", fields, states)))
    expected = Rotation.from_quat(Q).inv().as_matrix()
    assert np.abs(found.body_from_gcrs(EPOCH, 10.0 * np.arange(6)) - expected).max() < 1e-9


PLAIN = aem_rows(Q)


@pytest.mark.parametrize(
    ("version", "changes", "rows", "line"),
    [
        ("1.0", {"QUATERNION_TYPE": "SCALAR_FIRST"}, PLAIN, 'line 13: QUATERNION_TYPE: found "SCALAR_FIRST"'),
        ("1.0", {"QUATERNION_TYPE": None}, PLAIN, "QUATERNION_TYPE: is missing; expected FIRST or LAST"),
        ("1.0", {"ATTITUDE_DIR": None}, PLAIN, "ATTITUDE_DIR: is missing; expected A2B or B2A"),
        ("1.0", {"ATTITUDE_DIR": "A_TO_B"}, PLAIN, 'ATTITUDE_DIR: found "A_TO_B"'),
        ("2.0", {"QUATERNION_TYPE": None, "ATTITUDE_DIR": "B2A"}, PLAIN, 'ATTITUDE_DIR: found "B2A", a key of'),
        ("2.0", {"QUATERNION_TYPE": "FIRST"}, PLAIN, 'QUATERNION_TYPE: found "FIRST", a key of another version'),
        ("2.0", {"RATE_FRAME": "REF_FRAME_A"}, PLAIN, "RATE_FRAME: found"),
        ("1.0", {"ANGVEL_FRAME": "REF_FRAME_A"}, PLAIN, "ANGVEL_FRAME: found"),
        ("2.0", {}, PLAIN, ""),
        ("1.0", {"Q_DIR": "A2B"}, PLAIN, "Q_DIR: is not a key of an attitude ephemeris message"),
        ("1.0", {"CENTER_NAME": "MARS"}, PLAIN, 'CENTER_NAME: found "MARS"; expected EARTH'),
        ("1.0", {"REF_FRAME_B": "ACTUATOR_1"}, PLAIN, "GCRF and ACTUATOR_1; expected SC_BODY_1"),
        ("1.0", {"REF_FRAME_B": "INSTRUMENT_A"}, PLAIN, "GCRF and INSTRUMENT_A"),
        ("1.0", {"REF_FRAME_B": "SC_BODY_2"}, PLAIN, ""),
        ("1.0", {"REF_FRAME_A": "LVLH"}, PLAIN, "REF_FRAME_A: axes 'LVLH'"),
        ("1.0", {"ATTITUDE_TYPE": "SPIN/NUTATION"}, PLAIN, 'ATTITUDE_TYPE: found "SPIN/NUTATION"'),
        ("1.0", {"ATTITUDE_TYPE": "EULER_ANGLE"}, PLAIN, "EULER_ROT_SEQ: is missing"),
        ("1.0", {"ATTITUDE_TYPE": "EULER_ANGLE", "EULER_ROT_SEQ": "122"}, PLAIN, 'EULER_ROT_SEQ: found "122"'),
        ("1.0", {"ATTITUDE_TYPE": "EULER_ANGLE", "EULER_ROT_SEQ": "321"}, PLAIN, "4 values after the time"),
        ("1.0", {"ATTITUDE_TYPE": "QUATERNION/RATE"}, PLAIN, "4 values after the time"),
        ("2.0", {"ATTITUDE_TYPE": "QUATERNION/RATE", "ANGVEL_FRAME": "REF_FRAME_A"}, PLAIN, "QUATERNION/ANGVEL"),
        ("1.0", {}, aem_rows(Q * np.where(np.arange(6) == 3, -1.0, 1.0)[:, None]), ""),
        ("1.0", DERIVATIVE, aem_rows(0.0 * Q, Q_DOT), "line 16: a quaternion of the length 0"),
        ("1.0", {}, aem_rows(2.0 * Q), "line 16: a quaternion of the length 2"),
    ],
)  # fmt: skip
def test_an_attitude_that_means_something_else_is_refused_by_key_and_line(
    tmp_path: Path, version: str, changes: dict[str, str], rows: list[str], line: str
) -> None:
    path = written(tmp_path, kvn_of("AEM", version, {**AEM, **changes}, rows))
    if line:
        with pytest.raises(UserError) as found:
            attitude_of_aem(path)
        assert line in str(found.value)
        assert str(path) in str(found.value)
    else:
        attitude = attitude_of_aem(path).body_from_gcrs(EPOCH, np.zeros(1))[0]
        assert np.abs(attitude - Rotation.from_quat(Q[0]).inv().as_matrix()).max() < 1e-9


def test_attitudes_in_other_time_systems_are_at_the_same_instants(tmp_path: Path) -> None:
    for name, scale, offset in (("TAI", "tai", 0.0), ("GPS", "tai", -19.0), ("TT", "tt", 0.0)):
        rows = [
            f"{time} {row.split(' ', 1)[1]}"
            for time, row in zip(stamps(10.0 * np.arange(6), scale, offset), PLAIN, strict=True)
        ]
        found = attitude_of_aem(written(tmp_path, kvn_of("AEM", "1.0", {**AEM, "TIME_SYSTEM": name}, rows)))
        assert found.epoch_utc == EPOCH


@pytest.mark.parametrize(
    ("text", "kinds"),
    [
        (f"<ndm>{omm_xml()}<aem/><opm/></ndm>", ["omm", "aem", "opm"]),
        ("CCSDS_TDM_VERS = 1.0\n", ["tdm"]),
        ("\n".join(LINES), ["tle"]),
        ("time_utc,x_gcrs_km\n", []),
        (KVN.split("\n", 1)[1], ["oem"]),
        ("\ufeff\n" + KVN + kvn_of("OMM", "2.0", OMM), ["oem", "omm"]),
    ],
)
def test_kinds_are_told_apart_by_their_content(tmp_path: Path, text: str, kinds: list[str]) -> None:
    assert kinds_of(written(tmp_path, text)) == kinds


@pytest.mark.parametrize(
    "text",
    ["[", "[1]", '{"name": "ISS", "line1": "1", "line2": "2"}',
      "[[]]", "[]", '{"EPOCH": [1]}', '[{"MEAN_MOTION": NaN}]', "[" * 100_000, '{"a": 1, "A": 2}',
     "MEAN_MOTION\n1\n", "EPOCH,MEAN_MOTION\n1\n", 'EPOCH,MEAN_MOTION\n"1', "<omm version='2.0'/>",
     '<?xml version="1.0" encoding="x"?><omm/>', "CCSDS_OMM_VERS = 2.0\nMETA_START\n",
     "CCSDS_OEM_VERS = 2.0\nMETA_STOP\n"],
)  # fmt: skip
def test_damaged_text_is_one_line(tmp_path: Path, text: str) -> None:
    path = written(tmp_path, text)
    for reader in (satellite_of_omm, orbit_of_oem, attitude_of_aem):
        with pytest.raises(UserError, match=str(path)) as found:
            reader(path)
        assert not any(word in str(found.value) for word in ("Error", "object at", "NoneType", "float", "\n"))


NAMES = {"OBJECT_NAME", "OBJECT_ID", "NORAD_CAT_ID"}


@pytest.mark.parametrize(("kind", "key"), [(kind, key) for kind, keys in READ.items() for key in sorted(keys - NAMES)])
def test_every_key_that_is_not_harmless_is_read(tmp_path: Path, kind: str, key: str) -> None:
    """Nonsense in its place is refused by its name; in a harmless key it is not."""
    reader, version, fields, rows = {
        "oem": (orbit_of_oem, "2.0", OEM, oem_rows(stamps(T), circle(T))),
        "aem": (attitude_of_aem, "2.0" if key == "ANGVEL_FRAME" else "1.0", AEM, PLAIN),
        "omm": (satellite_of_omm, "2.0", OMM, None),
    }[kind]
    harmless = dict.fromkeys(HARMLESS - {"CREATION_DATE", "ORIGINATOR"}, "nonsense")
    with pytest.raises(UserError, match=f"{key}: "):
        reader(written(tmp_path, kvn_of(kind.upper(), version, {**fields, key: "nonsense", **harmless}, rows)))
    reader(written(tmp_path, kvn_of(kind.upper(), "1.0" if kind == "aem" else version, {**fields, **harmless}, rows)))


LONG = 60.0 * np.arange(11)
INCLINED = circle(LONG).reshape(-1, 2, 3) @ Rotation.from_euler("xyz", [35.0, 15.0, 70.0], degrees=True).as_matrix()
NADIR = Rotation.from_matrix(lvlh_matrices(INCLINED[:, 0], INCLINED[:, 1]))
"""From celestial axes to those of a body that looks at the Earth; as a turn of frames it is the inverse."""
TILTED = Rotation.from_euler("zyx", [30.0, -20.0, 50.0], degrees=True) * NADIR


@pytest.mark.parametrize(
    ("q", "changes", "doubt"),
    [
        (TILTED.inv().as_quat(), {}, ""),
        (TILTED.as_quat(), {"ATTITUDE_DIR": "B2A"}, ""),
        (TILTED.as_quat(), {}, "its turn is the inverse"),
        (np.roll(TILTED.inv().as_quat(), 1, 1), {"QUATERNION_TYPE": "FIRST"}, ""),
        (np.roll(TILTED.inv().as_quat(), 1, 1), {}, "its scalar is at the other end"),
        (TILTED.inv().as_quat(), {"QUATERNION_TYPE": "FIRST"}, "its scalar is at the other end"),
        (np.tile([0.5, 0.5, 0.5, 0.5], (11, 1)), {}, ""),
        (Rotation.from_rotvec(0.001 * LONG[:, None] * [0.0, 0.0, 1.0]).as_quat(), {}, ""),
    ],
)  # fmt: skip
def test_a_body_that_would_look_at_the_earth_in_another_reading_is_doubtful(
    tmp_path: Path, q: np.ndarray, changes: dict[str, str], doubt: str
) -> None:
    written(
        tmp_path,
        kvn_of("OEM", "2.0", {**OEM, "STOP_TIME": None}, oem_rows(stamps(LONG), INCLINED.reshape(-1, 6))),
        "orbit",
    )
    rows = [f"{time} {' '.join(f'{x:.12f}' for x in one)}" for time, one in zip(stamps(LONG), q, strict=True)]
    written(tmp_path, kvn_of("AEM", "1.0", {**AEM, **changes}, rows), "attitude")
    spec = OrbitSpec.model_validate({"ephemeris": "orbit", "n": 2, "attitude": {"file": "attitude"}})
    found = fly(spec, WGS84, 1, "o", tmp_path)[1]
    assert bool(found) == bool(doubt), found
    assert doubt in found


INSERTED = ["nan", "1e999", "1e308", "=", '"', "[", "<", "\0", "{", ",", "9" * 30, "2016-12-31T23:59:60.5", "\u00e9"]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("reader", "text"),
    [
        (orbit_of_oem, KVN),
        (orbit_of_oem, oem_xml(stamps(T), circle(T), ACCELERATION)),
        (satellite_of_omm, omm_xml()),
        (satellite_of_omm, json.dumps([CATALOGUE])),
        (satellite_of_omm, csv_of(CATALOGUE)),
        (attitude_of_aem, kvn_of("AEM", "2.0", {**SECOND, **ANGVEL, **IN_B}, aem_rows(Q, W_B))),
        (attitude_of_aem, kvn_of("AEM", "1.0", {**AEM, **DERIVATIVE}, aem_rows(Q, Q_DOT))),
    ],
)
def test_damage_anywhere_is_read_or_one_line(tmp_path: Path, reader, text: str) -> None:
    random = np.random.default_rng(7)
    path, lines = tmp_path / "file", []
    for _ in range(120):
        i = int(random.integers(len(text)))
        j = i + int(random.integers(1, 60))
        words = str(random.choice(INSERTED))
        changed = (
            text[:i],
            text[:i] + text[j:],
            text[:i] + words + text[i:],
            text[:i] + words + text[j:],
            text[:j] + text[i:],
        )
        path.write_text(changed[int(random.integers(5))], encoding="utf-8")
        try:
            reader(path)
        except UserError as error:
            lines.append(str(error))
    assert len(lines) > 60
    assert not any(word in " ".join(lines) for word in ("Error", "NoneType", "could not", "invalid literal", "\n"))
