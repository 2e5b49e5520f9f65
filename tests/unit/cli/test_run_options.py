"""Options of ``run`` that stand in place of a suite's own keys."""

from __future__ import annotations

from horizonval import cli
from horizonval.core.errors import UserError
from horizonval.suites.suite import load_suite


def test_another_seed_draws_other_scenes(monkeypatch, tmp_path):
    taken = []

    def take(suite, out, **_):
        taken.append(suite)
        raise UserError("enough")

    monkeypatch.setattr("horizonval.commands.run.run", take)
    for seed in ("1", "9"):
        assert cli.run_command_line(["run", "strict", "--frames", "40", "--seed", seed, "--out", str(tmp_path)]) == 2
    own = load_suite("strict", 40)
    assert own.seed == 1
    same, other = taken
    assert (same.seed, other.seed) == (1, 9)
    assert [case.scene for case in same.cases] == [case.scene for case in own.cases]
    names = {case.name for case in other.cases}
    assert names == {case.name for case in own.cases}
    assert not {c.scene.model_dump_json() for c in other.cases} & {c.scene.model_dump_json() for c in own.cases}


def test_a_seed_is_a_whole_number(tmp_path, capsys):
    assert cli.run_command_line(["run", "strict", "--seed", "-1", "--out", str(tmp_path)]) == 2
    assert "--seed" in capsys.readouterr().err
