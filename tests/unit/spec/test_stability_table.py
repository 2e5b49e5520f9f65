"""The ``[stability]`` table: what it fills in, and what it refuses in one line."""

from __future__ import annotations

import pytest

from horizonval.core.errors import UserError
from horizonval.spec.load import Suite, load_suite
from horizonval.spec.stability import FieldSensor

HEAD = """
[suite]
name = "s"
estimators = ["ideal"]
[[frame]]
scene.name = "a"
camera.file = "ir-bolometer-160-57deg"
platform.altitude_km = 500.0
"""
BAND = '[[stability.band]]\nname = "co2"\nlo_um = 14.0\nhi_um = 16.3\n'
EDGE = '[[stability.sensor]]\nname = "edge"\nkind = "edge"\nlocator = "half"\n'
FIELD = '[[stability.sensor]]\nname = "field"\nkind = "field"\nfield_deg = 2.0\n'
TABLE = "[stability]\naltitude_km = 900.0\n"


@pytest.fixture
def load(tmp_path):
    def build(*parts: str) -> Suite:
        path = tmp_path / "s.toml"
        path.write_text(HEAD + "".join(parts))
        return load_suite(path)

    return build


def test_a_suite_need_not_have_one(load):
    assert load().stability is None


def test_defaults(load):
    spec = load(TABLE, BAND, EDGE, FIELD).stability
    assert spec is not None
    assert (spec.inclination_deg, spec.positions, spec.months) == (90.0, 72, list(range(1, 13)))
    assert spec.atmosphere.profile == "by_latitude_month"
    assert spec.band[0].band.kind == "thermal"
    assert isinstance(spec.sensor[1], FieldSensor)


def test_the_shipped_suite():
    suite = load_suite("infrared-horizon-stability")
    assert suite.stability is not None
    assert [(b.lo_um, b.hi_um) for b in suite.stability.band] == [
        (14.0, 16.3),
        (14.16, 16.25),
        (8.0, 14.0),
        (10.5, 12.5),
    ]
    assert suite.stability.altitude_km == 900.0
    assert len(suite.stability.months) == 12


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ((TABLE, EDGE), ("stability.band", "missing")),
        ((TABLE, BAND), ("stability.sensor", "missing")),
        (("[stability]\n", BAND, EDGE), ("stability.altitude_km", "missing")),
        (("[stability]\naltitude_km = 100.0\n", BAND, EDGE), ("altitude_km", "100", "200")),
        ((TABLE, "positions = 3\n", BAND, EDGE), ("positions", "3", "from 4 to 720")),
        ((TABLE, "positions = 72.0\n", BAND, EDGE), ("positions", "whole number")),
        ((TABLE, "months = []\n", BAND, EDGE), ("months", "at least 1 long")),
        ((TABLE, "months = [0]\n", BAND, EDGE), ("months[1]", "from 1 to 12")),
        ((TABLE, "months = [1, 1]\n", BAND, EDGE), ("months holds a month twice",)),
        ((TABLE, "requirement_deg = [0.1, 0.03]\n", BAND, EDGE), ("requirement_deg must rise",)),
        ((TABLE, "inclinaton_deg = 90.0\n", BAND, EDGE), ("inclinaton_deg", "unknown key", "inclination_deg")),
        ((TABLE, BAND, BAND, EDGE), ("two bands are named 'co2'",)),
        ((TABLE, BAND, EDGE, EDGE), ("two sensors are named 'edge'",)),
        ((TABLE, BAND.replace("16.3", "13.0"), EDGE), ("lo_um must be below hi_um",)),
        ((TABLE, BAND.replace("co2", "co2/15"), EDGE), ("stability.band[1].name", "co2/15")),
        ((TABLE, BAND, EDGE.replace('"half"', '"middle"')), ("stability.sensor[1].locator", "middle", "gradient")),
        ((TABLE, BAND, EDGE.replace('kind = "edge"', 'kind = "scan"')), ("stability.sensor[1]", "scan", "field")),
        ((TABLE, BAND, FIELD.replace("2.0", "20.0")), ("field_deg", "20", "10")),
        ((TABLE.replace("900.0", "40000.0"), BAND, FIELD.replace("2.0", "9.0")), ("angular radius", "7.9 deg")),
        ((TABLE, 'atmosphere.profile = "none"\n', BAND, EDGE), ("no infrared horizon",)),
        ((TABLE, 'atmosphere.file = "us76"\n', BAND, EDGE), ("atmosphere.file", "every month")),
        ((TABLE, "atmosphere.refraction = true\n", BAND, EDGE), ("atmosphere.refraction", "straight")),
        (
            (TABLE, 'atmosphere = { profile = "by_latitude_month", month = 3 }\n', BAND, EDGE),
            ("atmosphere.month", "itself"),
        ),
        ((TABLE, 'surface.kind = "earth"\n', BAND, EDGE), ("surface.kind", "longitudes")),
    ],
)
def test_mistakes(load, parts, words):
    with pytest.raises(UserError) as error:
        load(*parts)
    line = error.value.line()
    assert "\n" not in line
    for word in ("s.toml", *words):
        assert word in line, line
