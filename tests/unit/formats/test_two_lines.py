"""Two-line elements: what may be written, what is chosen from several, and what is refused with its columns."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from sgp4.api import Satrec

import horizonval as hv
from horizonval.core.errors import UserError
from horizonval.formats.two_lines import elements_of
from horizonval.geometry.orbit import far_from_epoch
from horizonval.spec.orbit import OrbitSpec
from horizonval.suites.flight import _track

ISS = (
    "1 25544U 98067A   26079.50000000  .00010000  00000-0  10000-3 0  999",
    "2 25544  51.6400 123.4567 0005000  40.0000 320.0000 15.5000000012345",
)


def summed(line: str) -> str:
    return line[:68] + str(sum(int(c) if c.isdigit() else c == "-" for c in line[:68]) % 10)


def lines(number: str = "25544", day: str = "26079.50000000") -> list[str]:
    return [summed(line.replace("25544", number, 1).replace("26079.50000000", day)) for line in ISS]


def changed(line: int, column: int, text: str, length: int | None = None) -> list[str]:
    """Return the lines with a text from a column on, and a fitting checksum."""
    found = lines()
    one = found[line - 1]
    one = one[: column - 1] + text + one[column - 1 + len(text) :]
    found[line - 1] = summed(one)
    return found


@pytest.mark.parametrize(
    "text",
    [
        "\ufeff" + "\r\n".join(lines()) + "\r\n",
        "ISS (ZARYA)   \n" + "  \n".join(lines()) + " \n\n",
        "0 ISS (ZARYA)\r" + "\r".join(lines()),
        "\ufeffISS (ZARYA) \u00e9\n" + "\n".join(lines()),
        "\n".join(["1 KUNS-PF", *changed(1, 63, " ")]),
        "\n".join(changed(1, 63, "2")),
        "\n".join(changed(1, 3, "  544")[:1] + changed(2, 3, "00544")[1:]),
    ],
)
def test_what_programs_write_is_read(tmp_path: Path, text: str) -> None:
    (tmp_path / "sat.tle").write_bytes(text.encode())
    found = _track(OrbitSpec(tle="sat.tle", n=1), tmp_path)
    assert found.epoch_utc == datetime(2026, 3, 20, 12, tzinfo=UTC)
    want = Satrec.twoline2rv(*lines()).sgp4_tsince(10.0)[1]
    assert np.abs(found.states(np.array([600.0]))[0][0] / 1e3 - want).max() < 1e-6


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (changed(1, 63, "4"), "column 63, ephemeris type '4': elements of SGP4-XP"),
        (changed(1, 63, "1"), "column 63, ephemeris type '1': elements of another theory"),
        (changed(1, 21, "000.5"), "columns 21 to 32, day of the epoch: 000.50000000; expected 1 to 367"),
        (changed(1, 21, "366.0"), "day of the epoch: 366; expected below 366, the end of 2026"),
        (changed(1, 21, "367.5"), "day of the epoch: 367.5"),
        (changed(1, 54, "     nan"), "columns 54 to 61, drag term"),
        (changed(2, 27, "nan0000"), "columns 27 to 33, eccentricity"),
        (changed(2, 27, ".000500"), "columns 27 to 33, eccentricity"),
        (changed(2, 9, "     nan"), "columns 9 to 16, inclination"),
        (changed(2, 9, "181.6400"), "inclination: 181.6400; expected 0 to 180"),
        (changed(2, 53, "00.00000000"), "mean motion"),
        (changed(2, 17, "7"), "column 17 is not blank"),
        (changed(1, 3, "I5544")[:1] + changed(2, 3, "I5544")[1:], "Alpha-5"),
        (changed(1, 3, "25545")[:1] + lines()[1:], "satellites 25545 and 25544"),
        ([lines()[0][:-1] + "9", lines()[1]], "checksum"),
        ([lines()[0][:-1], lines()[1]], "68 columns"),
        (lines()[:1], "found 1 lines"),
        ([*lines(), "a name"], "found 3 lines"),
        (["<html>", "<body>", "no such catalogue"], "found 3 lines"),
        ([], "found 0 lines"),
    ],
)  # fmt: skip
def test_what_is_no_element_set_of_sgp4_is_refused(given: list[str], message: str) -> None:
    with pytest.raises(UserError, match=message):
        elements_of(given)


CATALOGUE = [
    "ISS (ZARYA)",
    *lines(),
    "0 STAR",
    *lines("T0002"),
    *lines("00005"),
    *lines("00006"),
    *lines("00006", "26080.50000000"),
]


def test_one_of_several_is_chosen() -> None:
    names = {
        "25544": "25544",
        "iss (zarya)": "25544",
        "STAR": "T0002",
        "T0002": "T0002",
        "270002": "T0002",
        "5": "00005",
    }
    assert {name: elements_of(CATALOGUE, name).line1[2:7] for name in names} == names


def test_several_without_a_choice_are_listed() -> None:
    with pytest.raises(
        UserError, match=r"elements of 4 satellites: 25544 \(ISS .ZARYA.\), T0002 .STAR., 00005.*`satellite`"
    ):
        elements_of(CATALOGUE)
    with pytest.raises(UserError, match="no elements of '7'; expected one of 25544"):
        elements_of(CATALOGUE, "7")
    with pytest.raises(UserError, match=r"2 element sets of 00006, of 26079.50000000 .year and day., 26080.5"):
        elements_of(CATALOGUE, "6")
    assert OrbitSpec.model_validate({"tle": "a.tle", "satellite": 25544, "n": 1}).satellite == "25544"
    with pytest.raises(ValueError, match="satellite goes with tle or ephemeris"):
        OrbitSpec.model_validate(
            {"epoch_utc": datetime(2026, 1, 1), "altitude_km": 500.0, "inclination_deg": 9.0, "satellite": "5", "n": 1}
        )


DYING = [summed(line) for line in (
    "1 25544U 98067A   26079.50000000  .00700000  00000-0  40000-2 0  999",
    "2 25544  98.6000 123.4567 0014500  40.0000 320.0000 15.7000000012345",
)]  # fmt: skip


@pytest.mark.parametrize(
    ("given", "days", "message"),
    [
        (lines(), 1.0, ""),
        (lines(), 5.0, "up to 5 days after the epoch of the elements, 2026-03-20T12:00:00: .* km off"),
        (changed(1, 34, " .00000010  00000-0  00000-0"), 6.9, ""),
        (changed(1, 34, " .00000010  00000-0  00000-0"), -7.5, "up to 7.5 days before .* likely 16 km off"),
        (DYING, 0.2, ""),
        (DYING, 143.0, "up to 143 days after .* anywhere on its orbit, or decayed"),
    ],
)  # fmt: skip
def test_far_from_the_epoch_of_elements_there_is_a_warning(given: list[str], days: float, message: str) -> None:
    satellite = elements_of(given).satellite()
    found = far_from_epoch(satellite, datetime(2026, 3, 20, 12, tzinfo=UTC), np.array([0.0, 86400.0 * days]))
    assert bool(found) == bool(message)
    if message:
        assert re.match(message, found), found


def test_a_check_shows_the_warning_once(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(
        '[suite]\nname = "s"\nestimators = ["altitude-free"]\n[defaults]\n'
        'camera = { file = "ir-bolometer-160-57deg", mount_roll_deg = 65.0 }\n[[cases]]\nname = "o"\n'
        f"orbit = {{ tle = {lines()!r}, epoch_utc = 2026-04-01T00:00:00Z, n = 3, duration_s = 60.0 }}\n"
    )
    report = hv.check(tmp_path / "s.toml")
    assert [finding.frames for finding in report.findings if finding.code == "doubtful-orbit"] == [3]
    assert str(report).count("days after the epoch of the elements") == 1
