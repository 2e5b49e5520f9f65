"""A night from end to end, its units worked on in this process; then accepting it, and the nights after."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from dataclasses import fields, replace
from xml.etree import ElementTree

import pytest
from nights import estimating_with, key_of
from page_commands import cards_of, commands_of

from horizonval import cli
from horizonval.core import atomic
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.core.outcome import Outcome, Refusal
from horizonval.jobs import engine
from horizonval.store.folder import read_json, write_json
from horizonval.store.verify import verify_folder
from horizonval.studies.regression import history, units
from horizonval.studies.regression.accept import accept
from horizonval.studies.regression.baseline import pack_path, read_baseline, read_pack, release_path
from horizonval.studies.regression.night import LANES, NIGHT_SCHEMA, WORK, Wanted, run_night
from horizonval.studies.regression.row import from_columns, to_columns
from horizonval.studies.regression.units import render_unit, replay_scene, shown
from horizonval.suites.plan import units_of


@pytest.fixture(scope="module")
def first(here, night, tmp_path_factory):
    """The first night, without a baseline; accepted afterwards. Its frames are those rendered for the other tests."""
    folder = tmp_path_factory.mktemp("nights")
    known = dict(night.frames)

    def render(scene, camera):
        from horizonval.renderer.frame import render_frame

        name = key_of(scene)
        seeded = scene.scene.seed == 3
        return known[name] if seeded and name in known else render_frame(scene, camera)

    here.setattr(units, "_render", render)
    wanted = Wanted(str(night.path), folder / "out", folder / "base" / "tiny.json", "2026-11-01")
    wanted = replace(wanted, lanes=("replay", "rerender"), workers=1)
    return wanted, run_night(wanted)


@pytest.fixture(scope="module")
def accepted(first):
    wanted, _ = first
    # The fresh lane is not needed here; a baseline needs its rows all the same.
    path = wanted.out / "night.json"
    content = read_json(path)
    write_json(path, content | {"lanes": list(LANES)})
    accept(wanted.out, wanted.baseline, "The first one, nothing before it", release=True)
    return wanted


def test_accepting_writes_rows_images_and_the_table(accepted):
    base = read_baseline(accepted.baseline, "tiny")
    assert base.head["reason"] == "The first one, nothing before it"
    assert len(base.results.rows) == len(base.images.images) == 8
    assert all(len(row.image_address) == 64 for row in base.results.rows)
    table = accepted.baseline.with_suffix(".md").read_text()
    assert "There was no baseline before." in table
    assert "| altitude-free | day | 8 |" in table
    release = read_baseline(release_path(accepted.baseline), "tiny")
    assert release.images.images == ()
    assert release.results == base.results


@pytest.fixture(scope="module")
def second(accepted):
    return run_night(replace(accepted, night="2026-11-02"))


def test_an_unchanged_night_passes_and_says_so_everywhere(accepted, second):
    assert (second["verdict"], second["exit_status"], second["problems"]) == ("PASS", 0, [])
    assert {gate["verdict"] for gate in second["gates"]} == {"PASS"}
    compared = {one["name"]: one for one in second["comparisons"]}
    assert compared["release"]["same_as_accepted"]
    about = compared["accepted"]
    assert (about["replayed"], about["n_changed"], about["rendered"], about["n_images_changed"]) == (8, 0, 8, 0)
    assert verify_folder(accepted.out) == []
    stored = read_json(accepted.out / "verdict.json")
    assert stored == json.loads(json.dumps(second))
    suite = ElementTree.parse(accepted.out / "junit.xml").getroot()[0]
    assert [suite.get(key) for key in ("failures", "errors", "skipped")] == ["0", "0", "0"]
    assert int(suite.get("tests", "0")) == 3, "the method, the images, and completeness"
    assert [line["night"] for line in history.read(accepted.out / history.FILE)] == ["2026-11-01", "2026-11-02"]


def test_a_changed_estimator_is_a_regression_with_names(accepted, second, here, monkeypatch):
    """The baseline's errors are made smaller: the present ones are then worse, in every scene."""
    data = read_json(accepted.baseline, bound=False)
    rows = from_columns(data["rows"])
    claims = [row for row in rows if row.nadir_error_arcsec is not None]
    better = [
        row if row.nadir_error_arcsec is None else replace(row, nadir_error_arcsec=0.5 * row.nadir_error_arcsec)
        for row in rows
    ]
    changed = accepted.baseline.with_name("better.json")
    write_json(changed, bound=False, data=data | {"rows": to_columns(better)})
    os.link(pack_path(accepted.baseline), pack_path(changed))
    os.link(release_path(accepted.baseline), release_path(changed))
    os.link(pack_path(release_path(accepted.baseline)), pack_path(release_path(changed)))
    verdict = run_night(replace(accepted, baseline=changed, night="2026-11-03"))
    failed = {(gate["against"], gate["lane"], gate["metric"]) for gate in verdict["gates"] if gate["verdict"] == "FAIL"}
    assert failed == {("accepted", "replay", "nadir_error"), ("accepted", "replay", "nadir_error_median")}
    assert (verdict["verdict"], verdict["exit_status"]) == ("FAIL", 1)
    # The last release is another than the accepted one now, and has gates of its own.
    assert {gate["against"] for gate in verdict["gates"]} == {"accepted", "release"}
    gate = next(g for g in verdict["gates"] if g["verdict"] == "FAIL")
    assert set(gate["scenes"]) == {row.case for row in claims}
    page = (accepted.out / "index.html").read_text()
    # It prints no command that would have to run.
    assert commands_of(accepted.out / "index.html") == []
    assert cards_of(accepted.out / "index.html") == []
    assert "Regression: altitude-free in day (vis-cmos-512-60deg, vis)." in page
    assert gate["scenes"][0] in page
    case = ElementTree.parse(accepted.out / "junit.xml").find(".//failure")
    assert case is not None
    assert gate["scenes"][0] in case.get("message", "")


def test_a_failed_unit_makes_the_night_incomplete(accepted, here, monkeypatch, tmp_path):
    def broken(*arguments, **options):
        raise RuntimeError("no light")

    monkeypatch.setattr(units, "render_unit", broken)
    verdict = run_night(replace(accepted, out=tmp_path / "out", lanes=("rerender",)))
    assert (verdict["complete"], verdict["exit_status"]) == (False, 2)
    assert verdict["verdict"] == "INCOMPLETE"
    assert any("no light" in problem for problem in verdict["problems"])
    with pytest.raises(UserError, match="lane fresh was left out"):
        accept(tmp_path / "out", accepted.baseline, "This should not be possible")


def test_an_interrupted_night_goes_on(accepted, here, monkeypatch, tmp_path):
    """Stopped after three units; the second time only the rest is done."""
    wanted = replace(accepted, out=tmp_path / "out", lanes=("replay",))
    seen = []

    def some(work, items, workers, **_):
        for item in items:
            if len(seen) == 3:
                raise KeyboardInterrupt
            seen.append(item.name)
            yield item, work(item)

    monkeypatch.setattr(engine, "run_in_processes", some)
    with pytest.raises(KeyboardInterrupt):
        run_night(wanted)
    rest = []
    monkeypatch.setattr(
        engine,
        "run_in_processes",
        lambda work, items, *_, **__: ((rest.append(one.name), (one, work(one)))[1] for one in items),
    )
    assert run_night(wanted)["verdict"] == "PASS"
    assert len(rest) == 8 - 3
    assert not set(rest) & set(seen)
    # Files of other nights are swept out, those of this one stay.
    (wanted.out / WORK / f"{'0' * 64}.npz").touch()
    assert run_night(wanted)["verdict"] == "PASS"
    assert len(list((wanted.out / WORK).glob("[0-9a-f]*"))) == 8
    assert len(rest) == 8 - 3


def test_baselines_that_are_not_right_are_refused(accepted, tmp_path):
    with pytest.raises(UserError, match="is the baseline of suite 'tiny'"):
        read_baseline(accepted.baseline, "other")
    with pytest.raises(UserError, match="--reason"):
        accept(accepted.out, accepted.baseline, "ok")
    copy = tmp_path / "tiny.json"
    copy.write_bytes(accepted.baseline.read_bytes())
    with pytest.raises(UserError, match="frozen images"):
        read_baseline(copy, "tiny")
    data = bytearray(pack_path(accepted.baseline).read_bytes())
    data[-5] ^= 1
    pack_path(copy).write_bytes(data)
    with pytest.raises(DamagedFileError, match="not those that were accepted"):
        read_baseline(copy, "tiny")


def first_of(column):
    """Where a column has its first value: in the list, or in the words."""
    return column["words"] if isinstance(column, dict) else column


DAMAGE = {
    "unknown key": lambda d: d.update(other=1),
    "missing key": lambda d: d.pop("replicates"),
    "text for a number": lambda d: d["scenes"]["day_000"]["bands"]["vis"].update(noise_dn="much"),
    "rows of text": lambda d: d.update(rows="many"),
    "a huge error": lambda d: first_of(d["rows"]["nadir_error_arcsec"]).__setitem__(0, 1e308),
    "an error of text": lambda d: first_of(d["rows"]["nadir_error_arcsec"]).__setitem__(0, "far"),
    "a bound of zero": lambda d: d["scenes"]["day_000"]["bands"]["vis"].update(bound_arcsec=0.0),
    "no bound beside claims that have one": lambda d: d["scenes"]["day_000"]["bands"]["vis"].update(bound_arcsec=None),
    "a bound below 0": lambda d: first_of(d["rows"]["bound_arcsec"]).__setitem__(0, -1.0),
    "no such outcome": lambda d: d["scenes"]["day_000"]["bands"]["vis"].update(expected="text"),
    "another outcome": lambda d: d["scenes"]["day_000"]["bands"]["vis"].update(expected="dark"),
    "a huge full scale": lambda d: d["scenes"]["day_000"]["bands"]["vis"].update(full_scale=10**30),
    "a huge calibration": lambda d: d["scenes"]["day_000"]["bands"]["vis"].update(radiance_per_dn=[1e308]),
    "true for a number": lambda d: d["scenes"]["day_000"]["bands"]["vis"].update(radiance_per_dn=[True]),
    "a calibration of other images": lambda d: d["scenes"]["day_000"]["bands"]["vis"].update(radiance_per_dn=[]),
    "a sigma below 0": lambda d: first_of(d["rows"]["sigma_total_arcsec"]).__setitem__(0, -1.0),
    "no such status": lambda d: first_of(d["rows"]["status"]).__setitem__(0, "splendid"),
    "a word that is not there": lambda d: d["rows"]["band"].update(at=[7] * 8),
    "a word counted from the end": lambda d: d["rows"]["band"].update(at=[-1] * 8),
    "columns that differ in length": lambda d: d["rows"]["image"].append("0"),
    "no such replicate": lambda d: d["rows"].update(replicate=[3] * 8),
    "a row twice": lambda d: d["rows"].update(scene=["day_000"] * 8),
    "another image": lambda d: first_of(d["rows"]["image"]).__setitem__(0, "0"),
    "heads of no scene": lambda d: d["together"].update(x={"table": "", "heads": [["a", "b"]], "bands": {}}),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_sealed_baseline_of_nonsense_is_one_line_and_exit_status_2(accepted, tmp_path, capsys, damage):
    copy = tmp_path / "tiny.json"
    os.link(pack_path(accepted.baseline), pack_path(copy))
    data = read_json(accepted.baseline, bound=False)
    DAMAGE[damage](data)
    write_json(copy, data, bound=False)
    assert cli.run_command_line(["regress", accepted.suite, "--baseline", str(copy), "--out", str(tmp_path / "o")]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1, lines
    assert "tiny.json" in lines[0]


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir, lambda path: os.symlink("nowhere", path)])
def test_what_is_no_file_is_not_taken_for_no_baseline(accepted, tmp_path, capsys, make):
    make(tmp_path / "tiny.json")
    arguments = ["regress", accepted.suite, "--baseline", str(tmp_path / "tiny.json"), "--out", str(tmp_path / "o")]
    assert cli.run_command_line(arguments) == 2
    assert "tiny.json: is a" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["{}", "[1]", "no JSON", "unsealed"])
def test_a_baseline_without_a_seal_is_refused(accepted, tmp_path, text):
    copy = tmp_path / "tiny.json"
    plain = json.dumps(read_json(accepted.baseline, bound=False))
    copy.write_text(plain if text == "unsealed" else text)
    with pytest.raises(DamagedFileError, match="no seal"):
        read_baseline(copy, "tiny")


@pytest.fixture
def run(accepted, tmp_path):
    """The folder of a night of all lanes."""
    folder = tmp_path / "run"
    shutil.copytree(accepted.out, folder)
    write_json(folder / "night.json", read_json(folder / "night.json") | {"lanes": list(LANES)})
    return folder


class Killed(BaseException):
    """Stands for a signal that nobody can catch."""


@pytest.mark.parametrize("after", range(6))
def test_an_acceptance_that_is_killed_goes_on(run, tmp_path, monkeypatch, after):
    """Whatever file was the last: the baseline is the old one or the new one, never a mixture."""
    path = tmp_path / "base" / "tiny.json"
    accept(run, path, "The first acceptance of it", release=True)
    moved = []

    def move(source, target):
        shown = not any(path.name.startswith(".") for path in (target, target.parent))
        if shown and len(moved) == after:
            raise Killed
        moved.extend([target] if shown else [])
        os.replace(source, target)

    with monkeypatch.context() as patch, contextlib.suppress(Killed):
        patch.setattr(atomic, "move", move)
        accept(run, path, "The second acceptance of it", release=True)
    assert read_baseline(path, "tiny").head["reason"] == "The second acceptance of it"
    assert read_baseline(release_path(path), "tiny").head["reason"] == "The second acceptance of it"
    assert sorted(p.name for p in path.parent.iterdir()) == [
        "tiny.json", "tiny.md", "tiny.npz", "tiny.release.json", "tiny.release.npz",
    ]  # fmt: skip


def test_a_baseline_that_claims_falsely_throughout_needs_a_yes(run, tmp_path, capsys):
    night = read_json(run / "night.json")
    night["rows"] = [row | {"false_valid": True} for row in night["rows"]]
    write_json(run / "night.json", night)
    arguments = ["baseline", "accept", str(run), "--baseline", str(tmp_path / "b.json"), "--reason", "it is what it is"]
    assert cli.run_command_line(arguments) == 2
    error = capsys.readouterr().err
    assert "altitude-free in day (vis-cmos-512-60deg, vis) claims falsely in 8 of 8 images" in error
    assert "--yes" in error
    assert cli.run_command_line([*arguments, "--yes"]) == 0
    assert "claims falsely in 8 of 8" in (tmp_path / "b.md").read_text()


def test_a_reference_must_be_of_the_same_night(accepted, here, tmp_path):
    reference = tmp_path / "reference"
    wanted = replace(accepted, out=tmp_path / "out", lanes=("replay",), reference=reference)
    with pytest.raises(UserError, match=r"no night\.json"):
        run_night(wanted)
    reference.mkdir()
    rows = [row.to_dict() for row in read_baseline(accepted.baseline, "tiny").results.rows]
    night = {"schema": NIGHT_SCHEMA, "suite": "tiny", "night": "another", "rows": [], "fresh": rows}
    write_json(reference / "night.json", night)
    with pytest.raises(UserError, match="is night 'another'"):
        run_night(wanted)
    for broken in ([{"scene": 1}], [None], None, 5, ["x"]):
        write_json(reference / "night.json", night | {"fresh": broken})
        with pytest.raises(DamagedFileError, match=r"rows cannot be used: (?!.*Type)"):
            run_night(wanted)
    write_json(reference / "night.json", night | {"night": wanted.night})
    assert run_night(wanted)["verdict"] == "PASS"


def test_frozen_images_are_those_of_the_night(accepted, night):
    pack = read_pack(pack_path(accepted.baseline))
    for image in pack.images:
        assert (image.dn == night.arrays[f"{image.scene}:dn.vis.0"]).all()


def test_an_estimator_is_shown_of_a_frozen_image_what_it_is_shown_of_a_new_one(accepted, night, monkeypatch):
    """Calibration and all: without it a fit of the whole profile takes the gain for free."""
    shown_to = {}

    def asking(kind):
        def run(name, observation):
            shown_to.setdefault(kind, []).append(observation)
            return Refusal(Outcome.NO_LIMB, "not asked")

        estimating_with(monkeypatch, run)

    pack = read_pack(pack_path(accepted.baseline))
    frozen = next(image for image in pack.images)
    unit = next(unit for unit in units_of(night.suite.cases, night.plan) if unit.name == frozen.scene)
    monkeypatch.setattr(units, "_render", lambda scene, camera: night.frames[key_of(scene)])
    asking("new")
    render_unit(unit, night.plan, 1)
    asking("frozen")
    replay_scene(pack, frozen.scene, {}, night.plan)
    new, again = shown_to["new"][0], shown_to["frozen"][0]
    assert new.radiance_per_dn == again.radiance_per_dn > 0.0
    for field in fields(new):
        assert repr(getattr(new, field.name)) == repr(getattr(again, field.name)), field.name
    assert repr(vars(new.prior)) == repr(vars(again.prior))
    # One that was frozen without is another image to an estimator, and is estimated again.
    for calibration, rows in ((frozen.radiance_per_dn, 0), (None, 1)):
        record, _ = render_unit(unit, night.plan, 1, frozenset([shown([replace(frozen, radiance_per_dn=calibration)])]))
        assert len(record["rows"]) == rows


def test_the_command_says_it_in_its_status(accepted, here, capsys, tmp_path):
    arguments = ["regress", accepted.suite, "--out", str(tmp_path / "out"), "--lane", "replay", "--workers", "1"]
    assert cli.run_command_line([*arguments, "--baseline", str(accepted.baseline)]) == 0
    assert "PASS" in capsys.readouterr().out
    assert cli.run_command_line([*arguments, "--baseline", str(tmp_path / "none.json")]) == 2
    assert "no accepted baseline" in capsys.readouterr().out
    assert cli.run_command_line([*arguments[:-4], "--lane", "replya"]) == 2
    assert "expected replay or rerender or fresh" in capsys.readouterr().err
    assert cli.run_command_line(["regress", "quick", "--out", str(tmp_path / "other")]) == 2
    assert "[regression]" in capsys.readouterr().err


def test_a_defect_of_the_program_is_no_regression(accepted, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("horizonval.api.run.regress", lambda *_, **__: 1 / 0)
    assert cli.run_command_line(["regress", accepted.suite, "--out", str(tmp_path / "out")]) == 2
    assert "ZeroDivisionError" in capsys.readouterr().err
