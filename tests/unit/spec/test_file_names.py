"""Names that cannot be files are refused at loading; names that grids make are bounded."""

from __future__ import annotations

import pytest

from horizonval.core.errors import UserError
from horizonval.core.files import (
    LONGEST_FRAME_NAME,
    LONGEST_GENERATED_NAME,
    LONGEST_NAME,
)
from horizonval.core.sealed import json_bytes
from horizonval.store.folder import RunFolder, write_json
from horizonval.studies.trade.design import expand, read_study
from horizonval.suites.suite import load_suite

HEAD = """
[suite]
name = "names"
estimators = ["ideal"]
[defaults]
camera = { file = "vis-cmos-512-60deg" }
platform = { altitude_km = 500.0 }
"""


@pytest.fixture
def load(tmp_path):
    def load(text: str):
        (tmp_path / "s.toml").write_text(HEAD + text)
        return load_suite(tmp_path / "s.toml")

    return load


OUTSIDE = ("a/b", "a\\u0000b", "a\\nb", "a\\u007f", "\\u00e9", "", "a ", " ")
REFUSED = [
    *((name, "50 characters long") for name in ("x" * 300, "x" * 151)),
    *((name, "[A-Za-z0-9._-]") for name in OUTSIDE),
    *((name, "cannot be a file's") for name in (".", "..", "a.")),
    *((name, "a device") for name in ("CON", "nul.frame", "Lpt1")),
]


@pytest.mark.parametrize(("name", "part"), REFUSED)
def test_a_name_that_cannot_be_a_file_is_refused(load, name, part):
    for text, key in [
        (f'[[frame]]\nscene.name = "{name}"\n', ""),
        (f'[[cases]]\nname = "{name}"\ngrid = {{ "platform.latitude_deg" = [1.0] }}\n', "cases[1].name"),
    ]:
        with pytest.raises(UserError) as e:
            load(text)
        assert part in e.value.line()
        assert key in e.value.line()
        assert len(e.value.lines()) == 1
        assert len(e.value.line()) < 500


def test_names_alike_but_for_capitals_are_refused(load):
    with pytest.raises(UserError, match="two frames are named 'limb' and 'Limb', alike but for capitals"):
        load('[[frame]]\nscene.name = "Limb"\n[[frame]]\nscene.name = "limb"\n')


def test_a_grid_of_long_values_has_bounded_names_of_their_own(load, tmp_path):
    keys = [f"platform.{key}" for key in ("latitude_deg", "longitude_deg", "altitude_km", "heading_deg")]
    keys += [f"attitude.{key}" for key in ("roll_deg", "pitch_deg", "yaw_deg")]
    axes = "\n".join(f'"{key}" = [100.123456701, 100.123456702]' for key in keys).replace("100.", "10.")
    suite = load(f'[[cases]]\nname = "{"n" * LONGEST_NAME}"\n[cases.grid]\n{axes}\n')
    names = [case.name for case in suite.cases]
    assert len(set(names)) == len(names) == 2**7
    assert {len(name) for name in names} <= set(range(LONGEST_GENERATED_NAME + 1))
    assert max(map(len, names)) > LONGEST_GENERATED_NAME - 10
    assert names == [case.name for case in load_suite(tmp_path / "s.toml").cases]


def test_the_longest_name_can_be_written(tmp_path):
    folder = RunFolder(tmp_path)
    folder.create()
    path = folder.case("f" * LONGEST_FRAME_NAME + "." + "h" * LONGEST_NAME)
    write_json(path, {"a": 1})
    assert path.is_file()
    assert json_bytes({"a": 1})


def test_names_of_a_study_are_bounded(tmp_path):
    design = "d" * 140
    (tmp_path / "s.toml").write_text(
        HEAD.replace("[suite]", "[study]")
        + f'[design]\nlist = [{{ name = "{design}a" }}, {{ name = "{design}b" }}]\n'
        + f'[frames]\nlist = [{{ scene = {{ name = "{"c" * 110}" }} }}]\n'
    )
    cases = expand(*read_study(tmp_path / "s.toml")).suite.cases
    assert len({case.name for case in cases}) == 2
    assert all(len(case.name) <= LONGEST_FRAME_NAME for case in cases)
