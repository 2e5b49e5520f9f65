"""What broke, as one line of a record."""

from __future__ import annotations

from horizonval.core.errors import DamagedFileError, UserError, one_line


def _caught(error: BaseException) -> str:
    try:
        raise error
    except type(error) as e:
        return one_line(e)


def test_a_users_mistake_is_told_in_its_own_words() -> None:
    assert _caught(UserError("found 3", where="a.toml", expected="4")) == "a.toml: found 3; expected 4"


def test_a_defect_is_told_with_its_place_and_without_folders() -> None:
    line = _caught(ValueError("two\n  lines"))
    assert line.startswith("ValueError at test_one_line.py:")
    assert line.endswith(": two lines")
    assert "/" not in line


def test_an_error_that_was_never_raised_has_no_place() -> None:
    assert one_line(ValueError("x")) == "ValueError: x"


def test_a_mistake_is_told_at_another_place() -> None:
    mistake = DamagedFileError("is 3", where="key", expected="4", fix="see there")
    moved = mistake.at("a.toml: table.key")
    assert type(moved) is DamagedFileError
    assert moved.line() == "a.toml: table.key: is 3; expected 4; see there"
    assert mistake.inside("a.toml").where == "a.toml: key"
    assert mistake.inside("a.toml: key").where == "a.toml: key"
    assert UserError("is 3").inside("a.toml").where == "a.toml"
