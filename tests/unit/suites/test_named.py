"""What a run names stays, everything else may go, and nothing goes while a run is at work."""

from __future__ import annotations

import shutil

import pytest
from synthetic import synthetic_cases, write_run

from horizonval.core.errors import DamagedFileError, UserError
from horizonval.store.folder import RunFolder, write_json
from horizonval.store.named import garbage, named_addresses, remove, run_folder_of
from horizonval.store.store import Store


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
