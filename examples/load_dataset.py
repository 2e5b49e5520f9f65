"""Batches for PyTorch from a data set of `horizonval dataset`.

    horizonval dataset learning --frames 10000 --out frames
    python examples/load_dataset.py frames

Without such a folder a dozen frames are made first. Needs torch and webdataset.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import torch
import webdataset

FOLDER = Path(sys.argv[1] if len(sys.argv) > 1 else "frames")


def sample(entry: dict) -> tuple[torch.Tensor, torch.Tensor]:
    """Return an image from 0 to 1, shape (bands, height, width), and the unit vector to the nadir in camera axes."""
    truth = entry["truth.json"]
    image = torch.from_numpy(entry["image.npy"].astype(np.float32) / truth["full_scale"])
    return image, torch.tensor(truth["nadir_cam"], dtype=torch.float32)


def batches(folder: Path, split: str, size: int) -> torch.utils.data.DataLoader:
    """Return batches of a split. Frames of one scene lie together in a shard, so that they are shuffled."""
    index = json.loads((folder / "dataset.json").read_text())
    shards = [str(folder / shard["file"]) for shard in index["splits"][split]["shards"]]
    frames = webdataset.WebDataset(shards, shardshuffle=len(shards), seed=1, empty_check=False)
    frames = frames.shuffle(1000, seed=1).decode().map(sample)
    return torch.utils.data.DataLoader(frames, batch_size=size)


if not (FOLDER / "dataset.json").is_file():
    words = ["dataset", "learning", "--frames", "12", "--out", str(FOLDER), "--workers", "1"]
    subprocess.run([sys.executable, "-c", "from horizonval.cli import main; main()", *words], check=True)

for images, nadirs in batches(FOLDER, "train", size=64):
    mean = torch.nn.functional.normalize(nadirs.mean(dim=0), dim=0)
    angles = torch.rad2deg(torch.acos((nadirs @ mean).clamp(-1.0, 1.0)))
    print(f"a batch: images {tuple(images.shape)}, nadirs {tuple(nadirs.shape)}, {images.dtype}")
    print(f"who always answers their mean is {angles.square().mean().sqrt():.2f} deg off (rms): learn to do better")
    break
