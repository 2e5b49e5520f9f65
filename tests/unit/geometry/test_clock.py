"""One count of time: SI seconds through TAI, against astropy's, also across and within leap seconds."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

import erfa
import numpy as np
import pytest
from astropy.time import Time

from horizonval.core.errors import UserError
from horizonval.geometry import clock

LEAP_DAYS = [(2012, 6, 30), (2015, 6, 30), (2016, 12, 31)]
EPOCHS = [
    *(datetime(*day, 12, tzinfo=UTC) for day in LEAP_DAYS),
    datetime(1961, 7, 31, 12, tzinfo=UTC),
    datetime(1971, 12, 31, 6, tzinfo=UTC),
    datetime(2026, 3, 20, 12, 0, 0, 123456, tzinfo=UTC),
]
SECONDS = np.array([-86400.25, -1.0, 0.0, 43199.75, 43200.0, 43200.5, 43201.0, 43201.25, 90000.0, 3e7])


def astropys(epoch: datetime, seconds: object = 0.0) -> Time:
    at = Time(epoch.replace(tzinfo=None), scale="utc").tai
    return Time(at.jd1, at.jd2 + np.asarray(seconds) / 86400.0, format="jd", scale="tai")


@pytest.mark.parametrize("epoch", EPOCHS, ids=str)
def test_julian_dates_are_astropys(epoch: datetime) -> None:
    """To 1e-8 s in UTC, TAI, TT; one instant has one date whichever epoch it is counted from."""
    theirs = astropys(epoch, SECONDS)
    for name in ("utc", "tai", "tt"):
        one, two = getattr(clock, f"julian_{name}")(epoch, SECONDS)
        want = getattr(theirs, name)
        assert np.abs((one - want.jd1) + (two - want.jd2)).max() * 86400.0 < 1e-8
    later = clock.julian_ut1(epoch, SECONDS)
    for k, t in enumerate(SECONDS):
        if k in (4, 5) and epoch in EPOCHS[:3]:
            with pytest.raises(UserError, match=r"T23:59:60(.500000)? lies within a leap second"):
                clock.utc_after(epoch, t)
            continue
        again = clock.utc_after(epoch, t)
        here = clock.julian_ut1(again)
        assert abs((later[0] - here[0] + later[1] - here[1])[k] * 86400.0) < 2e-6, "an epoch has microseconds"
        assert clock.elapsed_s(epoch, again) == pytest.approx(t, abs=1e-6)
        assert clock.elapsed_s(epoch, again) == pytest.approx(
            (Time(again.replace(tzinfo=None), scale="utc") - Time(epoch.replace(tzinfo=None), scale="utc")).sec,
            abs=1e-8,
        )


def test_far_from_leap_seconds_the_numbers_are_those_of_a_uniform_day() -> None:
    """Bit by bit: results of scenes must not depend on the way around TAI."""
    epoch, seconds = EPOCHS[-1], np.linspace(-1e6, 1e7, 1001)
    day, fraction = erfa.dtf2d("UTC", 2026, 3, 20, 12, 0, 0.123456)
    one, two = clock.julian_utc(epoch, seconds)
    assert one == day
    assert np.array_equal(two, fraction + seconds / 86400.0)
    for t in np.round(seconds, 6):
        assert clock.utc_after(epoch, t) == epoch + timedelta(seconds=float(t))
        assert (
            clock.elapsed_s(epoch, epoch + timedelta(seconds=float(t))) == timedelta(seconds=float(t)).total_seconds()
        )


@pytest.mark.parametrize("system", clock.SYSTEMS)
@pytest.mark.parametrize(
    "text", ["2015-06-30T23:59:59.25", "2017-001T00:00:35.125", "1999-12-31T12:00:00", "1965-05-02T01:00:00"]
)
def test_clocks_of_other_systems_are_astropys(system: str, text: str) -> None:
    """To 1 us, in which the Earth's centre is as good as an observer on its surface."""
    ours = clock.instant_of(text, "a.oem: line 7", system)
    scale = "tai" if system == "GPS" else system.lower()
    date = text if text[7] == "-" else "2017-01-01" + text[8:]
    theirs = Time(date, scale=scale).tai
    shift = 19.0 if system == "GPS" else 0.0
    want = (theirs - Time("1970-01-01", scale="tai")).sec + shift
    assert ours / 1e9 == pytest.approx(want, abs=1e-6)


def test_an_instant_within_a_leap_second_is_read_and_shown() -> None:
    before, within, after = (
        clock.instant_of(text, "f")
        for text in ("2016-12-31T23:59:59.5Z", "2016-366T23:59:60.5", "2017-01-01T00:00:00.5+00:00")
    )
    assert (within - before, after - within) == (10**9, 10**9)
    assert clock.instant_of("2017-01-01T05:29:60.5+05:30", "f") == within
    assert [clock.stamp(t) for t in (before, within, after)] == [
        "2016-12-31T23:59:59.500000", "2016-12-31T23:59:60.500000", "2017-01-01T00:00:00.500000",
    ]  # fmt: skip
    epoch = datetime(2016, 12, 31, tzinfo=UTC)
    assert clock.seconds_after(epoch, [before, within, after]).tolist() == [86399.5, 86400.5, 86401.5]
    assert clock.utc_at(clock.tai_of(datetime(2016, 12, 31, 23, 59, 59, 999999, tzinfo=UTC)) + 600).second == 59
    east = datetime(2017, 1, 1, 2, tzinfo=timezone(timedelta(hours=2)))
    assert clock.tai_of(east) == clock.tai_of(east.astimezone(UTC).replace(tzinfo=None)) == after - 500_000_000


@pytest.mark.parametrize(
    ("text", "system", "message"),
    [
        ("2016-12-31T23:59:61", "UTC", "a time as"),
        ("2016-12-31T12:00:60", "UTC", "no leap second is known"),
        ("2026-12-31T23:59:60", "UTC", "no leap second is known"),
        ("2016-12-31T23:59:60", "GPS", "GPS has no leap seconds"),
        ("2016-12-31T12:00:00+01:00", "TAI", "TAI without a time zone"),
        ("2026-366T12:00:00", "UTC", "a time as"),
        ("2026-000T12:00:00", "UTC", "a time as"),
        ("2026-02-29T12:00:00", "UTC", "a time as"),
        ("0001-01-01T00:00:00", "UTC", "a year between 1960"),
        ("2026-03-20", "UTC", "a time as"),
        ("nan", "UTC", "a time as"),
    ],
)  # fmt: skip
def test_what_is_no_instant_is_refused(text: str, system: str, message: str) -> None:
    with pytest.raises(UserError, match=f"^f: line 3: .*{message}"):
        clock.instant_of(text, "f: line 3", system)


def test_systems_that_need_a_table_are_refused() -> None:
    assert clock.check_system(" gps ", "f") == "GPS"
    for name in ("UT1", "SCLK", "GMST"):
        with pytest.raises(UserError, match=r"f: TIME_SYSTEM: found .*expected UTC or TAI or GPS"):
            clock.check_system(name, "f: TIME_SYSTEM")
    for seconds in (1e12, -1e300):
        with pytest.raises(UserError, match="1960"):
            clock.julian_utc(EPOCHS[0], seconds)
        with pytest.raises(UserError, match="1960"):
            clock.utc_after(EPOCHS[0], seconds)
