"""The same requests give the same bytes, whoever carries them and in whatever order they come."""

from __future__ import annotations

import hashlib
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import horizonval as hv
from horizonval.bridges.attitudes import request_of_state
from horizonval.serve.local import ImageSource, LocalClient
from horizonval.serve.server import Server
from horizonval.serve.service import listening
from horizonval.wire import Address

EPOCH = datetime(2026, 3, 20, 12, 0, tzinfo=UTC)
SCENE = """
[camera]
file = "ir-bolometer-160-57deg"
mount_roll_deg = 62.0
camera = { width = 40, height = 30 }
[platform]
epoch_utc = 2026-03-20T12:00:00Z
altitude_km = 550.0
[render]
nodes = 64
subsamples = 1
"""
R_N, V_N, SIGMA, OMEGA = [6928e3, 0.0, 0.0], [0.0, 5400.0, 5300.0], [-0.08, 0.4, 0.49], [0.01, -0.02, 0.0]
REQUESTS: list[dict[str, Any]] = [
    {"roll_deg": 1.5, "seed": 3},
    {**request_of_state(EPOCH, R_N, V_N, SIGMA, OMEGA), "seed": 11},
    {"latitude_deg": 40.0, "q_body_from_lvlh": [0.0, 0.0, 0.6, 0.8], "seed": 4},
    {"roll_deg": 1.5, "seed": 5},
]


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    path: Path = tmp_path_factory.mktemp("scene") / "loop.toml"
    path.write_text(SCENE)
    return path


@contextmanager
def served(scene: Path, address: Address) -> Iterator[hv.Client]:
    server = Server(ImageSource(scene).answer, {}, time_limit_s=30.0)
    with listening(address) as (listener, there):
        thread = threading.Thread(target=server.run, args=(listener,))
        thread.start()
        try:
            with hv.Client(str(there)) as client:
                yield client
        finally:
            server.stop()
            thread.join(30.0)


def digest(image: hv.Image) -> str:
    return hashlib.sha256(repr(image.dn.shape).encode() + image.dn.astype("<u2").tobytes()).hexdigest()


def answers(client: hv.Client, order: list[int]) -> dict[int, tuple[str, str, Any]]:
    found = {}
    for k in order:
        image = client.image(**REQUESTS[k], truth=True)
        found[k] = (digest(image.image), image.scene_id, image.truth)
    return found


@pytest.fixture(scope="module")
def in_process(scene) -> dict[int, tuple[str, str, Any]]:
    return answers(LocalClient(scene), [0, 1, 2, 3])


def test_requests_are_different_images(in_process):
    assert len({found[0] for found in in_process.values()}) == len(REQUESTS)


@pytest.mark.parametrize("transport", ["unix", "tcp"])
def test_a_server_gives_the_bytes_of_the_process(scene, in_process, tmp_path, transport):
    if transport == "unix" and sys.platform == "win32":
        pytest.skip("no Unix sockets in Python there")
    address = Address.parse(f"ipc://{tmp_path}/s" if transport == "unix" else "tcp://127.0.0.1:0")
    with served(scene, address) as client:
        assert answers(client, [3, 2, 1, 0]) == in_process


def test_a_frame_rendered_alone_gives_them_too(scene, in_process):
    rendered = hv.render(hv.Scene.from_file(scene).changed(roll_deg=1.5))
    for k in (0, 3):
        assert digest(rendered.observe(seed=REQUESTS[k]["seed"])) == in_process[k][0]


def test_the_module_of_basilisk_gives_them_too(scene, in_process, tmp_path):
    pytest.importorskip("Basilisk", reason="needs the extra `basilisk`: pip install 'horizonval[basilisk]'")
    import ctypes

    from Basilisk.architecture import messaging

    from horizonval.bridges.basilisk import CameraModule

    state = messaging.SCStatesMsgPayload(r_BN_N=R_N, v_BN_N=V_N, sigma_BN=SIGMA, omega_BN_B=OMEGA)
    message = messaging.SCStatesMsg().write(state)
    with served(scene, Address.parse("tcp://127.0.0.1:0")) as client:
        for images in (LocalClient(scene), client):
            camera = CameraModule(images, EPOCH, seed=REQUESTS[1]["seed"], bits=16)
            camera.scStateInMsg.subscribeTo(message)
            camera.Reset(0)
            camera.UpdateState(0)
            published = camera.cameraImageOutMsg.read()
            data = ctypes.string_at(int(published.imagePointer), published.imageBufferLength)
            dn = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
            assert digest(camera.served[0].image) == in_process[1][0]
            np.testing.assert_array_equal(dn, camera.served[0].dn)
