"""What a frame's identity depends on, larger suites in the same folder, and files that nothing names."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from synthetic import synthetic_cases, write_run

import horizonval.report
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.core.outcome import Outcome, Refusal
from horizonval.core.progress import Silent
from horizonval.jobs import engine
from horizonval.jobs.pool import Execution
from horizonval.scoring.row import read_results
from horizonval.spec.load import Suite
from horizonval.store.folder import RunFolder, write_json
from horizonval.store.named import garbage, named_addresses, remove, run_folder_of
from horizonval.store.store import Store
from horizonval.store.verify import write_manifest
from horizonval.suites import identity
from horizonval.suites.plan import plan_of, units_of
from horizonval.suites.run import run_suite
from horizonval.suites.suite import load_suite
from horizonval.suites.units import case as of_case
from horizonval.suites.units import scored

SUITE = """
[suite]
name = "s"
estimators = ["ideal"]
[defaults]
camera.file = "c.toml"
platform.altitude_km = 500.0
[[frame]]
scene.name = "a"
"""
CAMERA = '[camera]\nwidth = 64\nheight = 48\nfov_deg = 60.0\n[[band]]\nname="v"\nkind="solar"\nlo_um=0.5\nhi_um=0.7\n'


@pytest.fixture
def load(tmp_path):
    def build(suite: str = SUITE, camera: str = CAMERA, atmosphere: str = "{}", folder: str = "one") -> Suite:
        place = tmp_path / folder
        place.mkdir(exist_ok=True)
        (place / "c.toml").write_text(camera)
        (place / "a.json").write_text(atmosphere)
        (place / "a.csv").write_text(atmosphere)
        (place / "s.toml").write_text(suite)
        return load_suite(place / "s.toml")

    return build


def _all(suite: Suite) -> tuple[str, str, str]:
    case = suite.cases[0]
    return (
        identity.frame_identity(case),
        identity.unit_identity(units_of([case], plan_of(suite))[0], plan_of(suite)),
        identity.suite_identity(suite),
    )


@pytest.mark.parametrize(
    "change",
    [
        {"suite": SUITE.replace("500.0", "500.0000001")},
        {"suite": SUITE.replace('"a"', '"b"')},
        {"suite": SUITE.replace('name = "s"', 'name = "s"\nseed = 1')},
        {"camera": CAMERA.replace("60.0", "61.0")},
        {"camera": CAMERA + "[optics]\npsf_sigma_px = 1.0\n"},
    ],
)
def test_every_input_counts(load, change):
    for before, after in zip(_all(load()), _all(load(**change)), strict=True):
        assert before != after


@pytest.mark.parametrize("key", ['file = "a.json"', 'profile_file = "a.csv"'])
def test_an_atmosphere_counts_by_content_not_by_place(load, key):
    text = SUITE + f"[frame.atmosphere]\n{key}\n"
    here = _all(load(text, atmosphere=json.dumps({"x": 1})))
    assert here == _all(load(text, atmosphere=json.dumps({"x": 1}), folder="two"))
    assert here != _all(load(text, atmosphere=json.dumps({"x": 2})))


def test_estimators_do_not_change_a_frame(load):
    one, two = load(), load(SUITE.replace('["ideal"]', '["ideal", "altitude-free"]'))
    frame, case, suite = zip(_all(one), _all(two), strict=True)
    assert frame[0] == frame[1]
    assert case[0] != case[1]
    assert suite[0] != suite[1]


def test_draws_of_the_noise_count_where_there_are_several(load):
    suites = [load(), load(SUITE.replace('"s"', '"s"\ndraws = 1')), load(SUITE.replace('"s"', '"s"\ndraws = 2'))]
    plans = [plan_of(suite) for suite in suites]
    units = [identity.unit_identity(units_of(s.cases, p)[0], p) for s, p in zip(suites, plans, strict=True)]
    whole = [identity.suite_identity(suite) for suite in suites]
    for one, same, other in (units, whole):
        assert one == same
        assert one != other
    assert len({identity.frame_identity(suite.cases[0]) for suite in suites}) == 1


CASES = SUITE + '[[cases]]\nname = "g"\ngrid = { attitude.yaw_deg = [0.0, 1.0] }\n'


def test_estimators_of_a_table_count_for_its_cases_and_the_suite(load):
    two = CASES.replace('["ideal"]', '["ideal", "altitude-free"]')
    one = two.replace('name = "g"', 'name = "g"\nestimators = ["ideal"]')
    before, after = load(two), load(one)
    assert identity.suite_identity(before) != identity.suite_identity(after)
    units = [units_of(suite.cases, plan_of(suite)) for suite in (before, after)]
    same = [
        identity.unit_identity(old, plan_of(before)) == identity.unit_identity(new, plan_of(after))
        for old, new in zip(*units, strict=True)
    ]
    assert same == [True, False, False]


def test_a_method_more_in_another_table_leaves_a_case_as_it_is(load):
    one = CASES.replace('name = "g"', 'name = "g"\nestimators = ["ideal"]')
    more = one.replace('["ideal"]', '["ideal", "altitude-free"]', 1)
    units = [(plan_of(suite), units_of(suite.cases, plan_of(suite))[1]) for suite in (load(one), load(more))]
    assert len({identity.unit_identity(unit, plan) for plan, unit in units}) == 1


STUDY = """
[stability]
altitude_km = 900.0
months = [1]
[[stability.band]]
name = "co2"
lo_um = 14.0
hi_um = 16.3
"""


def test_a_study_counts_for_the_suite_and_not_for_its_frames(load):
    one, two, three = load(), load(SUITE + STUDY), load(SUITE + STUDY.replace("900.0", "901.0"))
    assert len({identity.suite_identity(suite) for suite in (one, two, three)}) == 3
    assert len({identity.frame_identity(suite.cases[0]) for suite in (one, two, three)}) == 1


GROWING = """
[suite]
name = "grows"
estimators = ["altitude-free"]
frames = 2
draws = 3
keep = "none"
[defaults]
camera.file = "c.toml"
platform.altitude_km = 500.0
[[cases]]
name = "sobol"
sobol = { share = 1.0, ranges = { attitude.yaw_deg = [-20.0, 20.0] } }
"""


class Kept(Silent):
    """How many frames were finished already."""

    kept = -1

    def start(self, total: int, kept: int, *, unit: str = "", what: str = "") -> None:
        self.kept = kept


class Refusing:
    spent_s = None

    def run(self, name, observation):
        return Refusal(Outcome.DARK, "dark")


@pytest.fixture
def suite_file(make_frame, monkeypatch, tmp_path) -> Path:
    frame = make_frame()
    camera = frame.truth.camera_spec
    monkeypatch.setattr(of_case, "_frame", lambda *_: (frame, None))
    monkeypatch.setattr(scored, "supervisor_of", lambda _: Refusing())
    monkeypatch.setattr(engine, "run_in_processes", lambda work, items, *_, **__: ((one, work(one)) for one in items))
    monkeypatch.setattr(horizonval.report, "build_report", lambda folder: folder)
    text = '[camera]\nname = "small"\nwidth = 40\nheight = 30\nfov_deg = 60.0\n'
    for table, values in (("[optics]", camera.optics), ("[[band]]", camera.band[0]), ("[detector]", camera.detector)):
        plain = values.model_dump(mode="json", exclude_defaults=True) | ({"kind": "cmos"} if "det" in table else {})
        text += f"{table}\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in plain.items())
    (tmp_path / "c.toml").write_text(text)
    (tmp_path / "grows.toml").write_text(GROWING)
    return tmp_path / "grows.toml"


def test_another_number_of_frames_goes_on_in_the_same_folder(suite_file, tmp_path):
    out, outcomes = tmp_path / "out", {}
    for frames, kept in ((2, 0), (3, 2), (2, 2)):
        progress = Kept()
        summary = run_suite(load_suite(suite_file, frames), out, progress, Execution(1)).summary
        assert (summary["n_cases"], progress.kept) == (frames, kept)
        outcome = [(out / name).read_bytes() for name in ("summary.json", "results.parquet", "run.json")]
        assert outcomes.setdefault(frames, outcome) == outcome
    assert [row.case for row in read_results(out / "results.parquet")] == ["sobol_000", "sobol_001"]
    assert (out / "cases" / "sobol_002.json").is_file(), "what was computed is not lost"


@pytest.fixture(scope="module")
def finished_run(tmp_path_factory):
    return write_run(tmp_path_factory.mktemp("run") / "out", synthetic_cases()[5:7])


@pytest.fixture
def folder(finished_run, tmp_path) -> RunFolder:
    folder = RunFolder(shutil.copytree(finished_run, tmp_path / "out"))
    folder.create()
    return folder


def test_only_what_nothing_names_goes(folder, make_frame, make_image):
    store = Store(folder.archive)
    named = {entry.address for entry in store.entries()}
    assert set(named_addresses(folder)) == named
    assert garbage(folder).files == ()
    loose = {store.add_frame(make_frame(1.0)), store.add_image(make_image())}
    rendered = store.add_frame(make_frame(2.0))
    write_json(folder.frame_pointer("half-done"), {"identity": "0" * 64, "frame": rendered})
    (folder.archive / ".0123.tmp").write_bytes(b"half")
    found = garbage(folder)
    assert {path.stem for path in found.files} == loose | {".0123"}
    assert found.kept == len(named) + 1
    assert found.size_bytes == sum(store.path(a).stat().st_size for a in loose) + 4
    remove(found, folder)
    assert {entry.address for entry in store.index.select()} == named | {rendered}
    assert store.verify(named_addresses(folder)) == []
    assert all(any(path.iterdir()) for path in folder.archive.iterdir() if path.is_dir())


def test_a_result_that_cannot_be_read_protects_everything(folder):
    case = next(folder.cases.iterdir())
    case.write_text("{")
    with pytest.raises(DamagedFileError, match="nobody knows which entries it names"):
        garbage(folder)
    assert len(named_addresses(folder)) == 2
    case.unlink()
    write_manifest(folder.root, [*folder.cases.iterdir()])
    assert garbage(folder).files
    next(folder.cases.iterdir()).unlink()
    with pytest.raises(UserError, match="is missing, but the manifest names it"):
        garbage(folder)


def test_an_archive_that_others_may_use_is_left_alone(folder, tmp_path):
    folder.archive.rename(tmp_path / "shared")
    folder.archive.symlink_to(tmp_path / "shared")
    with pytest.raises(UserError, match="other runs may use it"):
        garbage(folder)


def test_the_run_of_an_archive(folder, tmp_path):
    assert run_folder_of(folder.archive) == folder
    assert run_folder_of(tmp_path) is None
    folder.suite.unlink()
    assert run_folder_of(folder.archive) is None
