"""Submissions that cheat on a small benchmark: what is hidden from them is worth full marks to who can read it."""

from __future__ import annotations

import socket
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from horizonval.core.errors import UserError
from horizonval.core.outcome import Refusal
from horizonval.core.progress import Silent
from horizonval.estimation.observation import Observation
from horizonval.geometry.camera import CameraModel
from horizonval.plugins.supervisor import Limits, Supervisor, can_hide
from horizonval.spec.load import Suite
from horizonval.spec.suite import ProgramSpec
from horizonval.studies.bench import submissions
from horizonval.suites.suite import load_suite

NEEDS_NAMESPACES = pytest.mark.skipif(not can_hide(), reason="this system hides no folder from a process")
SUITE = """
[suite]
name = "small"
estimators = ["altitude-free"]
[defaults]
camera.file = "ir-bolometer-160-57deg"
camera.mount_roll_deg = 60.0
camera.camera = { width = 112, height = 112, fov_deg = 110.0 }
platform.altitude_km = 550.0
render = { subsamples = 1, nodes = 32 }
[[cases]]
name = "cell"
grid.attitude.roll_deg = [0.0, 5.0]
"""

READER = """
import json, os, subprocess, sys
from pathlib import Path
import cv2
from horizonval.store import exr
bench, port, image = Path(sys.argv[1]), int(sys.argv[2]), cv2.imread(sys.argv[3], cv2.IMREAD_UNCHANGED)
subprocess.run(["umount", str(bench)], capture_output=True)
places = [bench, *(Path(f"/proc/{p}/root{bench}") for p in os.listdir("/proc") if p.isdigit())]
for place in places:
    try:
        found = sorted(place.rglob("*.exr"))
    except OSError:
        continue
    for path in found:
        try:
            seen = exr.read_image(path)
        except Exception:
            continue
        if seen.dn.shape == image.shape and (seen.dn == image).all():
            print(json.dumps({"status": "valid", "nadir_cam": list(seen.truth.nadir_geocentric_cam)}))
            sys.exit()
try:
    __import__("socket").create_connection(("127.0.0.1", port), 2.0)
    print(json.dumps({"status": "no_limb", "reason": "called home"}))
except OSError:
    print(json.dumps({"status": "no_limb", "reason": "nothing found"}))
"""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bench")
    (folder / "small.toml").write_text(SUITE)

    def small(_seed: int | None, _count: int, _group: str) -> Suite:
        return replace(load_suite(folder / "small.toml"), keep="all")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(submissions, "bench_suite", small)
        submissions.make_frames(folder / "made", None, 2, 1, Silent())
    (folder / "reader.py").write_text(READER)
    return folder


def entered(bench: Path, name: str, *, contained: bool) -> dict:
    """Return the sheet of the program that looks for the truth, which is told where it lies."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        command = f"{sys.executable} {bench / 'reader.py'} {bench / 'made'} {port} {{image}}"
        limits = Limits(60.0, 4096, (ProgramSpec(name=name, command=command),), bench)
        failed = submissions.run_submissions(bench / "made", [name], limits, 1, Silent(), contained=contained)
    assert not failed[name]
    return submissions.score_submissions(bench / "made")["sheets"][name]["all"]


LISTER = """
import json, os, socket, subprocess, sys
subprocess.run(["umount", sys.argv[1]], capture_output=True)
files = os.listdir(sys.argv[1])
try:
    socket.create_connection(("127.0.0.1", int(sys.argv[2])), 2.0)
    files.append("network")
except OSError:
    pass
print(json.dumps({"status": "no_limb", "reason": " ".join(files) or "nothing"}))
"""


@NEEDS_NAMESPACES
def test_a_hidden_folder_is_empty_and_there_is_no_network(tmp_path: Path) -> None:
    """A program sees both where nothing is hidden."""
    (tmp_path / "lister.py").write_text(LISTER)
    secret = tmp_path / "secret"
    secret.mkdir()
    (secret / "truth").touch()
    observation = Observation(np.zeros((8, 8)), CameraModel(8, 8, 8.0, 8.0, 3.5, 3.5), full_scale=255.0)
    said = {}
    with socket.create_server(("127.0.0.1", 0)) as server:
        command = f"{sys.executable} -S {tmp_path / 'lister.py'} {secret} {server.getsockname()[1]}"
        program = ProgramSpec(name="lists", command=command + " {image} {camera}")
        for hidden in ((), (secret,)):
            processes = Supervisor(Limits(20.0, 4096, (program,), tmp_path, hidden))
            said[hidden] = processes.run("lists", observation)
            processes.close()
    assert isinstance(said[()], Refusal)
    assert "truth network" in said[()].reason
    assert said[(secret,)].reason == "nothing"
    assert [path.name for path in secret.iterdir()] == ["truth"]


@pytest.mark.slow
@NEEDS_NAMESPACES
def test_a_program_that_looks_for_the_truth_finds_nothing(bench: Path) -> None:
    """The same program has every point where nothing is hidden, so that the search itself is a good one."""
    open_ = entered(bench, "reads", contained=False)
    assert open_["claims"] == 2
    assert open_["score"] == pytest.approx(100.0)
    hidden = entered(bench, "reads-hidden", contained=True)
    assert hidden["claims"] == 0
    text = "".join(path.read_text() for path in (bench / "made" / "entries" / "reads-hidden" / "cases").glob("*.json"))
    assert "nothing found" in text
    assert "called home" not in text
    # What lies there is still there for everybody else.
    assert list((bench / "made" / "frames" / "archive").rglob("*.exr"))


@pytest.mark.slow
def test_methods_that_cannot_be_ranked_are_refused(bench: Path) -> None:
    with pytest.raises(UserError, match="told the pose"):
        submissions.run_submissions(bench / "made", ["ideal"], Limits(), 1, Silent())
