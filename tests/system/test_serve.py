"""The image service as a simulation meets it: a process of its own, on a socket, asked by Python and by C."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from conftest import MINI_CAMERA, PROGRAM, assert_one_line
from serve_faults import after_faults

import horizonval as hv
from horizonval.geometry.frames import compose, inverse
from horizonval.wire import HEADER, MAGIC, Address

CLIENT_C = Path(__file__).parents[2] / "examples" / "serve" / "client.c"
SCENE = """
[scene]
name = "one"
[camera]
file = "mini-camera.toml"
mount_roll_deg = 65.0
[platform]
altitude_km = 500.0
latitude_deg = 20.0
[render]
orders = "single"
subsamples = 1
nodes = 32
"""
POSE: dict[str, Any] = {"latitude_deg": 21.0, "yaw_deg": 3.0, "roll_deg": -2.0, "rate_deg_s": [0.0, 2.0, 0.5]}


class Served:
    """A running server and where it listens."""

    def __init__(self, folder: Path, *options: str) -> None:
        self.process = subprocess.Popen(
            [str(PROGRAM), "serve", "--scene", "one.toml", *options],
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        self.line = self.process.stdout.readline()
        self.folder = folder
        self.address = self.line.split(": ")[0].replace("ipc://", f"ipc://{folder}/")

    def client(self) -> hv.Client:
        return hv.Client(self.address)

    def stop(self, kind: int = signal.SIGTERM) -> tuple[int, str, str]:
        self.process.send_signal(kind)
        output, errors = self.process.communicate(timeout=60)
        # Whether a command is slow enough to say so hangs on what else the machine does.
        return self.process.returncode, output, errors.replace("horizonval: serve is getting ready\n", "")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("serve")
    (made / "mini-camera.toml").write_text(MINI_CAMERA)
    (made / "one.toml").write_text(SCENE)
    return made


@pytest.fixture(scope="module")
def served(folder: Path) -> Iterator[Served]:
    running = Served(folder, "--socket", "s.sock", "--time-limit", "2")
    yield running
    status, output, errors = running.stop()
    assert (status, errors) == (0, "")
    assert re.fullmatch(r"\d+ images served\n", output)
    assert not (folder / "s.sock").exists()


def by_commands(folder: Path, call: Callable[..., Any], exposure: str = "") -> np.ndarray:
    """Return the image that `render` and `observe` make of the pose and seed 5."""
    tables = SCENE.replace("latitude_deg = 20.0", f"latitude_deg = {POSE['latitude_deg']}")
    attitude = "".join(f"{key} = {POSE[key]}\n" for key in ("yaw_deg", "roll_deg", "rate_deg_s"))
    (folder / "posed.toml").write_text(f"{tables}[attitude]\n{attitude}")
    assert call("render", folder / "posed.toml", "-o", folder / "f.exr").returncode == 0
    options = ["--exposure", exposure] if exposure else []
    done = call("observe", folder / "f.exr", "-o", folder / "i.exr", "--seed", "5", *options)
    assert done.returncode == 0, done.stderr
    return hv.open_image(folder / "i.exr").dn


def test_what_it_serves_is_said_at_the_start(served):
    assert served.line == "ipc://s.sock: one.toml, mini, 96 x 80, vis\n"
    with served.client() as client:
        status = client.status()
    assert (status["version"], status["scene"], status["camera"]) == (hv.__version__, "one.toml", "mini")
    assert (status["width"], status["height"], status["bands"], status["heads"]) == (96, 80, ["vis"], [])


def test_the_bytes_are_those_of_render_and_observe(served, folder, horizonval):
    expected = by_commands(folder, horizonval)
    with served.client() as client:
        first = client.image(**POSE, seed=5, truth=True, radiance=True)
        client.image(roll_deg=40.0, latitude_deg=-50.0)
        again = client.image(**POSE, seed=5, truth=True, radiance=True)
        other = client.image(**POSE, seed=5, exposure_s=1e-4).dn
    for found in (first, again):
        np.testing.assert_array_equal(found.dn, expected)
        frame, image = hv.open_frame(folder / "f.exr"), hv.open_image(folder / "i.exr")
        np.testing.assert_array_equal(found.radiance, frame.radiance["vis"])
        assert found.truth == frame.truth
        assert found.image.observation["camera"] == image.observation["camera"]
    np.testing.assert_array_equal(other, by_commands(folder, horizonval, "1e-4"))


def test_a_pose_along_earth_fixed_axes_is_the_same_pose(served):
    with served.client() as client:
        truth = client.image(**POSE, truth=True).truth
        q = np.array(truth.q_cam_from_itrs)
        body = hv.Scene.from_dict(truth.scene, hv.Camera(truth.camera_spec))
        q_body_from_itrs = compose(inverse(truth.q_cam_from_body), q)
        other = client.image(
            position_itrs_km=np.array(truth.r_itrs) / 1e3,
            heading_deg=body.spec.platform.heading_deg,
            q_body_from_itrs=q_body_from_itrs,
            truth=True,
        ).truth
    np.testing.assert_allclose(other.r_itrs, truth.r_itrs, rtol=0, atol=1e-7)
    np.testing.assert_allclose(other.q_cam_from_itrs, truth.q_cam_from_itrs, rtol=0, atol=1e-14)
    assert other.altitude_m == pytest.approx(truth.altitude_m, abs=1e-7)


def test_two_clients_at_other_places_get_each_their_own(served):
    alone: dict[float, np.ndarray] = {}
    with served.client() as client:
        for latitude in (10.0, -40.0):
            alone[latitude] = client.image(latitude_deg=latitude, seed=3).dn
    assert (alone[10.0] != alone[-40.0]).any()
    equal: list[bool] = []

    def ask(latitude: float) -> None:
        with served.client() as own:
            for turn in range(4):
                own.image(latitude_deg=latitude, roll_deg=float(turn))
                equal.append(np.array_equal(own.image(latitude_deg=latitude, seed=3).dn, alone[latitude]))

    threads = [threading.Thread(target=ask, args=(latitude,)) for latitude in alone]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(120)
    assert equal == [True] * 8


def test_mistakes_are_lines_and_the_server_lives(served):
    mistakes = [
        ({"latitude_deg": 100.0}, "request: latitude_deg"),
        ({"band": "ir"}, "request: band: no band 'ir'; expected one of vis"),
        ({"head": "a"}, "request: head"),
        ({"exposure_s": 1e9}, "exposure_s"),
        ({"epoch_utc": "1900-01-01"}, "1960"),
        ({"altitude_km": 1e-9}, "altitude_km"),
    ]
    with served.client() as client:
        for keys, part in mistakes:
            with pytest.raises(hv.UserError, match=re.escape(part)) as raised:
                client.image(**keys)
            assert "\n" not in str(raised.value)
        assert client.image(seed=1).dn.shape == (80, 96)


def test_killed_clients_half_messages_and_slow_readers_are_nothing_to_the_next(served, folder):
    address = Address(folder / "s.sock")
    script = f"import horizonval as hv\nc = hv.Client({served.address!r})\nprint(flush=True)\nwhile True: c.image()"
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as victim, served.client() as client:
        assert victim.stdout is not None
        victim.stdout.readline()
        for number in range(4):
            if number == 2:
                victim.kill()
            with address.connect(5.0) as stream:
                stream.sendall((b"GET / HTTP/1.0\r\n\r\n", HEADER.pack(MAGIC, 50) + b"\x81", b"HV", b"")[number])
                assert client.image(seed=number).seed == number
        end = time.monotonic() + 20
        while client.status()["clients"] > 1 and time.monotonic() < end:
            time.sleep(0.1)
        assert client.status()["clients"] == 1


@pytest.mark.parametrize("faults", [12, pytest.param(200, marks=pytest.mark.slow)])
def test_faults_are_nothing_to_another(served, folder, faults):
    after_faults(Address(folder / "s.sock"), faults, 3)


def test_the_c_client_gets_the_same_image(served, folder, horizonval):
    if shutil.which("cc") is None:
        pytest.skip("needs a C compiler")
    strict = ["-std=c11", "-D_POSIX_C_SOURCE=200809L", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1"]
    subprocess.run(["cc", *strict, "-o", "client", str(CLIENT_C)], cwd=folder, check=True)
    expected = by_commands(folder, horizonval)
    words = "latitude_deg 21.0 yaw_deg 3 roll_deg -2 rate_deg_s 0,2,0.5 seed 5 truth true"
    done = subprocess.run(["./client", "s.sock", *words.split()], cwd=folder, capture_output=True, check=True)
    found = cv2.imdecode(np.frombuffer(done.stdout, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(found, expected)
    nadir = [float(word) for word in done.stderr.split()[1:]]
    assert nadir == list(hv.open_frame(folder / "f.exr").truth.nadir_geocentric_cam)
    refused = subprocess.run(["./client", "s.sock", "rol_deg", "1"], cwd=folder, capture_output=True, check=False)
    assert refused.returncode == 1
    assert refused.stderr.startswith(b"client: request: rol_deg: unknown key; expected one of roll_deg")
    nobody = subprocess.run(["./client", "none.sock"], cwd=folder, capture_output=True, check=False)
    assert (nobody.returncode, nobody.stderr) == (1, b"client: nobody listens there\n")


def test_a_killed_servers_socket_is_taken_over(folder, tmp_path):
    for name in ("mini-camera.toml", "one.toml"):
        shutil.copy(folder / name, tmp_path)
    killed = Served(tmp_path, "--socket", "s.sock")
    killed.process.kill()
    killed.process.communicate()
    assert (tmp_path / "s.sock").exists()
    running = Served(tmp_path, "--socket", "s.sock", "--once", "2")
    with running.client() as client:
        assert client.image(seed=1).seed == 1
        assert client.image(seed=2).seed == 2
    output, _ = running.process.communicate(timeout=60)
    assert (running.process.returncode, output) == (0, "2 images served\n")


@pytest.mark.parametrize("kind", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_start_that_is_interrupted_leaves_no_socket(folder, tmp_path, kind):
    words = [str(PROGRAM), "serve", "--scene", "one.toml", "--socket", str(tmp_path / "s.sock")]
    with subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        end = time.monotonic() + 60
        while not (tmp_path / "s.sock").exists() and time.monotonic() < end:
            time.sleep(0.01)
        process.send_signal(kind)
        try:
            output, errors = process.communicate(timeout=60)
        finally:
            # One that does not end would be waited for without an end.
            process.kill()
    # Where the first image was there already, it is the orderly end.
    assert process.returncode == (0 if output else 130)
    assert "Traceback" not in errors
    assert not (tmp_path / "s.sock").exists()


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (["--scene", "none.toml"], ["none.toml"]),
        (["--scene", "limb-noon-vis", "--port", "0", "--host", "0.0.0.0"], ["other machines", "--token-file"]),
        (["--scene", "limb-noon-vis", "--port", "0", "--socket", "x"], ["--socket", "used with --port"]),
        (["--scene", "limb-noon-vis", "--host", "127.0.0.1"], ["--host", "without --port"]),
        (["--scene", "limb-noon-vis", "--token-file", "none"], ["none", "a file that holds a token"]),
        (["--scene", "limb-noon-vis", "--socket", "no/such.sock"], ["no such folder"]),
        (["--scene", "limb-noon-vis", "--socket", "x" * 200], ["at most 100 bytes"]),
    ],
)
def test_wrong_use_is_one_line(horizonval, options, parts):
    assert_one_line(horizonval("serve", *options), *parts)


def test_a_scene_that_cannot_be_observed_is_said_at_the_start(horizonval, tmp_path):
    (tmp_path / "mini-camera.toml").write_text(MINI_CAMERA.partition("[detector]")[0])
    (tmp_path / "one.toml").write_text(SCENE)
    assert_one_line(horizonval("serve", "--scene", "one.toml", "--socket", "s.sock"), "the camera has no detector")
    assert not (tmp_path / "s.sock").exists()


def test_without_the_extra_it_says_what_to_install(horizonval, monkeypatch):
    monkeypatch.setitem(sys.modules, "msgpack", None)
    assert_one_line(horizonval("serve", "--scene", "limb-noon-vis"), "pip install 'horizonval[serve]'")


def test_each_head_is_asked_for_by_name(tmp_path):
    (tmp_path / "one.toml").write_text(
        '[scene]\nname = "heads"\n[camera]\nfile = "ir-linear-160-four-heads"\nhead = "all"\n'
        "[platform]\naltitude_km = 500.0\n"
    )
    running = Served(tmp_path, "--socket", "s.sock")
    with running.client() as client:
        heads = client.status()["heads"]
        images = [client.image(head=head, truth=True) for head in heads]
        with pytest.raises(hv.UserError, match="request: head: missing; expected one of az45"):
            client.image()
    assert running.stop()[0] == 0
    assert heads == ["az45", "az135", "az225", "az315"]
    assert [image.truth.head for image in images] == heads
    expected = hv.render(hv.Scene.each_head(tmp_path / "one.toml", "az225")[0], progress=False).observe(seed=0)
    np.testing.assert_array_equal(images[2].dn, expected.dn)


def test_the_default_socket_lies_in_the_users_runtime_folder(folder, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    running = Served(folder)
    with hv.Client() as client:
        client.image()
    assert (os.stat(tmp_path / "horizonval").st_mode & 0o777, running.stop()[0]) == (0o700, 0)
