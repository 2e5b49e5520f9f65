"""Frames of ``horizonval dataset learning --format hdf5`` as observations with their truth."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import horizonval as hv
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.frames import compose, inverse

POSITION_SIGMA_M = 1e3
BAND_UM = (8.0, 14.0)
ATTITUDE_SIGMA_RAD = np.radians(2.0)
"""Of what is known beside a frame, each component: as the benchmark has it."""


@dataclass(frozen=True)
class Frame:
    """An observation that knows the place, and the truth."""

    observation: hv.Observation
    nadir_cam: np.ndarray
    r_itrs: np.ndarray
    q_cam_from_itrs: np.ndarray
    scene: int
    frame: int


def index_of(folder: Path) -> dict[str, Any]:
    """Return the index of a data set."""
    index: dict[str, Any] = json.loads((folder / "dataset.json").read_text(encoding="utf-8"))
    return index


def image_alone(observation: hv.Observation) -> hv.Observation:
    """Return an observation of which nothing is known but image and camera."""
    return replace(observation, prior=hv.Prior())


def frames(folder: Path, split: str) -> Iterator[Frame]:
    """Yield the frames of a split.

    What is known of the place is the truth with an error that the frame's number draws.

    Parameters
    ----------
    folder : Path
    split : {"train", "validation", "test"}
    """
    import h5py

    for shard in index_of(folder)["splits"][split]["shards"]:
        with h5py.File(folder / shard["file"]) as file:
            columns = {name: file[name][:] for name in file}
        for k, image in enumerate(columns["image"]):
            yield _frame(image, {name: column[k] for name, column in columns.items()})


def _frame(image: np.ndarray, truth: dict[str, Any]) -> Frame:
    fx, fy, cx, cy, *distortion = truth["camera"].tolist()
    _, height, width = image.shape
    random = np.random.default_rng([20, int(truth["frame"])])
    turn = Rotation.from_rotvec(random.normal(0.0, ATTITUDE_SIGMA_RAD, 3)).as_quat()
    body_from_itrs = compose(inverse(truth["q_cam_from_body"]), truth["q_cam_from_itrs"])
    prior = hv.Prior(
        shape="wgs84",
        r_itrs=truth["r_itrs"] + random.normal(0.0, POSITION_SIGMA_M, 3),
        position_sigma_m=POSITION_SIGMA_M,
        altitude_m=float(truth["altitude_m"]) + random.normal(0.0, POSITION_SIGMA_M),
        altitude_sigma_m=POSITION_SIGMA_M,
        q_cam_from_itrs=compose(truth["q_cam_from_body"], turn, body_from_itrs),
        attitude_sigma_rad=np.full(3, ATTITUDE_SIGMA_RAD),
        epoch_utc=datetime.fromtimestamp(float(truth["epoch_unix_s"]), UTC),
    )
    observation = hv.Observation(
        image=image[0].astype(np.float64),
        camera=CameraModel(width, height, fx, fy, cx, cy, tuple(distortion)),
        q_cam_from_body=truth["q_cam_from_body"],
        full_scale=float(truth["full_scale"]),
        prior=prior,
        band_kind="thermal",
        band_um=BAND_UM,
    )
    return Frame(
        observation, truth["nadir_cam"], truth["r_itrs"], truth["q_cam_from_itrs"],
        int(truth["scene"]), int(truth["frame"]),
    )  # fmt: skip
