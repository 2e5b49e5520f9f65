"""Submissions that cheat on a small benchmark: what is hidden from them is worth full marks to who can read it."""

from __future__ import annotations

import json
import os
import socket
import sys
import sysconfig
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome, Refusal
from horizonval.core.progress import Silent
from horizonval.estimation.observation import Observation, OraclePose
from horizonval.geometry.camera import CameraModel
from horizonval.plugins import namespaces, registry
from horizonval.plugins.supervisor import Limits, Supervisor, can_hide
from horizonval.spec.load import Suite
from horizonval.spec.suite import ProgramSpec
from horizonval.store.folder import write_json
from horizonval.studies.bench import submissions
from horizonval.studies.bench.frames import commitment, sealed_seed
from horizonval.suites.plan import CasePlan
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
    said = {}
    with socket.create_server(("127.0.0.1", 0)) as server:
        command = f"{sys.executable} -S {tmp_path / 'lister.py'} {secret} {server.getsockname()[1]}"
        program = ProgramSpec(name="lists", command=command + " {image} {camera}")
        for hidden in ((), (secret,)):
            processes = Supervisor(Limits(20.0, 4096, (program,), tmp_path, hidden))
            said[hidden] = processes.run("lists", OBSERVATION)
            processes.close()
    assert isinstance(said[()], Refusal)
    assert "truth network" in said[()].reason
    assert said[(secret,)].reason == "nothing"
    assert [path.name for path in secret.iterdir()] == ["truth"]


WRITER = """
import ctypes, json, os, socket, sys, tempfile
private = (tempfile.gettempdir(), "/dev/shm")
before, wrote = sum(len(os.listdir(folder)) for folder in private), []
for folder in (*sys.argv[1].split(":"), *private):
    try:
        open(os.path.join(folder, "left-by-a-submission"), "w").close()
        wrote.append(folder)
    except OSError:
        pass
for name, reach in (
    ("signal", lambda: os.kill(int(sys.argv[2]), 0)),
    ("device", lambda: os.open("/dev/kmsg", os.O_RDONLY)),
    ("hypervisor", lambda: socket.socket(socket.AF_VSOCK)),
):
    try:
        wrote.append(reach() or name)
    except OSError:
        pass
libc = ctypes.CDLL(None)
libc.shmat.restype = ctypes.c_void_p
address = ctypes.c_void_p(libc.shmat(libc.shmget(0x6876, 16, 0o1600), None, 0))
left = ctypes.string_at(address).decode()
ctypes.memmove(address, b"state", 6)
keys = libc.syscall({"x86_64": 250, "aarch64": 219}[os.uname().machine], 1, None)
print(json.dumps({"status": "no_limb", "reason": json.dumps([before, wrote == list(private), left, keys])}))
"""
PLUGIN = """
import mmap, os
import horizonval as hv
SHARED = mmap.mmap(-1, 1)
OPEN = len(os.listdir("/proc/self/fd")) - 1
def run(observation):
    SHARED[0] += 1
    return hv.Refusal(hv.Outcome.NO_LIMB, f"call {SHARED[0]}, {OPEN} files, {observation.oracle}")
ESTIMATOR = hv.Estimator(name="counts", title="counts", run=run, needs="image")
POSE = hv.Estimator(name="poses", title="poses", run=run, needs="pose")
"""
OBSERVATION = Observation(
    np.zeros((8, 8)),
    CameraModel(8, 8, 8.0, 8.0, 3.5, 3.5),
    full_scale=255.0,
    oracle=OraclePose(np.array([7e6, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0]), 6.4e6),
)


@NEEDS_NAMESPACES
def test_a_contained_program_writes_nowhere_and_leaves_nothing(tmp_path: Path) -> None:
    """Private folders and shared memory are empty at each image; processes, devices and keyrings are out of reach."""
    (tmp_path / "writer.py").write_text(WRITER)
    secret = tmp_path / "secret"
    secret.mkdir()
    places = [tmp_path, Path.home(), Path(sysconfig.get_paths()["purelib"]), Path("/var/tmp"), Path("/tmp")]
    command = f"{sys.executable} -S {tmp_path / 'writer.py'} {':'.join(map(str, places))} {os.getpid()} {{image}}"
    limits = Limits(20.0, 4096, (ProgramSpec(name="writes", command=command),), tmp_path, (secret,))
    processes = Supervisor(limits)
    reasons = [processes.run("writes", OBSERVATION).reason for _ in range(2)]
    processes.close()
    # The program's own folder of image, camera and prior is there before it.
    assert [json.loads(reason) for reason in reasons] == [[1, True, "", -1]] * 2
    assert not [path for place in places for path in place.glob("left-by-a-submission*")]


@NEEDS_NAMESPACES
def test_a_plug_in_keeps_no_state_and_never_receives_the_pose(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory shared at the import outlives an image where plug-ins are trusted, and not where they are contained."""
    (tmp_path / "plug.py").write_text(PLUGIN)
    about = tmp_path / "plug-0.1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Name: plug\nVersion: 0.1\n")
    (about / "entry_points.txt").write_text("[horizonval.estimators]\ncounts = plug:ESTIMATOR\nposes = plug:POSE\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    monkeypatch.syspath_prepend(tmp_path)
    secret = tmp_path / "secret"
    secret.mkdir()
    registry._points.cache_clear()
    said = []
    for hidden in ((), (secret,)):
        processes = Supervisor(Limits(20.0, 4096, hidden=hidden))
        said += [processes.run("counts", OBSERVATION).reason for _ in range(2)]
        posed = processes.run("poses", OBSERVATION)
        processes.close()
        assert posed.status is Outcome.CRASHED
        assert "needs that is none of image, heads" in posed.reason
    registry._points.cache_clear()
    assert [text[:6] for text in said] == ["call 1", "call 2", "call 1", "call 1"]
    assert {text[6:] for text in said[2:]} == {", 4 files, None"}


def test_answers_belong_to_the_files_that_a_command_names(tmp_path: Path) -> None:
    """A change of any of them is another submission: scripts in quotes, modules, neighbours, programs."""
    for name in ("main.py", "beside.py", "folder/__main__.py", "tool"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("#!/bin/sh\n")
    for command, changed in (
        ("sh -c 'python main.py'", "main.py"),
        ("python main.py", "beside.py"),
        ("python -m folder", "folder/__main__.py"),
        ("python x --script=main.py", "main.py"),
        ("./tool", "tool"),
    ):
        program = ProgramSpec(name="mine", command=command)
        plan = CasePlan(("mine",), Limits(programs=(program,), folder=tmp_path))
        before = plan.content()
        (tmp_path / changed).write_text(f"#!/bin/sh\n# {command}\n")
        assert plan.content() != before, command


def test_what_links_of_a_benchmark_lead_to_is_hidden(tmp_path: Path) -> None:
    out, far, farther = (tmp_path / name for name in ("out", "far", "farther"))
    for folder in (out / "frames", far, farther):
        folder.mkdir(parents=True)
    (farther / "image.exr").touch()
    (tmp_path / "single.exr").touch()
    (out / "frames" / "archive").symlink_to(far)
    (far / "more").symlink_to(farther)
    (out / "one.exr").symlink_to(tmp_path / "single.exr")
    assert set(submissions.hidden_of(out)) == {out, far, farther, tmp_path / "single.exr"}
    (out / "all").symlink_to("/")
    with pytest.raises(UserError, match="cannot be hidden"):
        submissions.hidden_of(out)


def test_every_mount_point_of_a_hidden_folder_is_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bind mounts show a folder, a folder above it or a part of it; disks inside it may be shown elsewhere."""
    mounts = [
        *(("8:1", "/", "/"), ("8:1", "/data", "/alias"), ("8:1", "/data/bench/frames", "/part"), ("8:1", "/x", "/y")),
        *(("8:2", "/", "/data/bench/disk"), ("8:2", "/", "/disk"), ("8:1", "/data", "/over"), ("8:3", "/", "/over")),
    ]
    monkeypatch.setattr(namespaces, "_mounts", lambda: iter([(d, Path(r), Path(p)) for d, r, p in mounts]))
    found = {str(path) for path in namespaces._everywhere(["/data/bench"])}
    assert found == {"/data/bench", "/alias/bench", "/part", "/data/bench/disk", "/disk"}


@pytest.mark.parametrize("place", ["beside", "called", "called/inside", "elsewhere", "gone"])
def test_a_passphrase_that_submissions_could_read_is_refused(tmp_path: Path, place: str) -> None:
    words = "seven quiet otters"
    folders = {name: tmp_path / name for name in ("beside", "called", "called/inside", "elsewhere", "gone")}
    for folder in folders.values():
        folder.mkdir()
    out = folders["beside"] / "sealed"
    out.mkdir()
    head = {"sealed": True, "commitment": commitment(sealed_seed(words))}
    (folders["elsewhere"] / "a-note.txt").write_text("some other words here")
    if place != "gone":
        (folders[place] / "words.txt").write_text(f'first line\n{{"passphrase": "{words}"}}\n')
    write_json(out / submissions.PASSPHRASE, {"file": str(folders["elsewhere"] / "words.txt")})
    if place == "gone":
        submissions.refuse_readable_passphrase(out, head, folders["called"])
    else:
        with pytest.raises(UserError, match="holds the passphrase"):
            submissions.refuse_readable_passphrase(out, head, folders["called"])


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
    with pytest.raises(UserError, match="receives the pose"):
        submissions.run_submissions(bench / "made", ["ideal"], Limits(), 1, Silent())
