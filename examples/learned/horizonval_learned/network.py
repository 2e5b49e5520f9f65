"""What was learned, by numpy alone: of a profile where the horizon lies in it, how surely, and whether it is known.

Everything is in one file beside this one, ``weights.npz``, with the digest of the frames that it was learned from.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from horizonval_learned.fit import Model
from horizonval_learned.patch import Patch

WEIGHTS = Path(__file__).with_name("weights.npz")


@dataclass(frozen=True)
class Network:
    """A perceptron on profiles, and the profiles that it knows.

    Attributes
    ----------
    layers : list of (matrix, vector)
        Of a rectifier after each but the last.
    mean, basis : ndarray, shape (25,) and (k, 25)
        Of the profiles of the training: their mean, and the directions in which they differ most.
    unlike : float
        Largest distance (rms over a profile) from what these can make that still counts as known.
    scatter : float
        Mean squared residual of an image's profiles, in their own sigmas, that 95 % of the validation's frames keep.
    placed, free : Model
        What is not known of a limb where the place is known, and where it is not.
    made : dict
        How: digest of the frames, seed, times.
    """

    layers: list[tuple[np.ndarray, np.ndarray]]
    mean: np.ndarray
    basis: np.ndarray
    unlike: float
    scatter: float
    placed: Model
    free: Model
    made: dict[str, Any]

    def strangeness(self, profiles: np.ndarray) -> np.ndarray:
        """Return how far profiles are from those of the training, rms, shape (n,)."""
        off = profiles - self.mean
        off = off - (off @ self.basis.T) @ self.basis
        return np.sqrt((off**2).mean(axis=1))

    def horizon(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where the horizon lies off the middle of profiles, and the sigma of that, shape (n,) each [rad].

        ``features`` are those of :func:`features`, shape (n, 27).
        """
        x = features
        for number, (matrix, vector) in enumerate(self.layers):
            x = x @ matrix + vector
            if number + 1 < len(self.layers):
                x = np.maximum(x, 0.0)
        return np.radians(x[:, 0]), np.radians(np.exp(x[:, 1]))


def features(patch: Patch, limb_km: float) -> np.ndarray:
    """Return what the network is told of every profile, shape (n, 27).

    The profile, and the logarithms of what a pixel covers across the horizon [deg] and of the distance to it [1000 km].
    """
    pixel = np.log(np.degrees(patch.pixel_rad))
    distance = np.full_like(pixel, np.log(limb_km / 1e3))
    return np.column_stack([patch.profiles, pixel, distance])


def load(path: Path = WEIGHTS) -> Network:
    """Read what was learned."""
    with np.load(path) as file:
        data = {name: file[name] for name in file.files}
    count = sum(name.startswith("matrix") for name in data)
    return Network(
        [(data[f"matrix{n}"].astype(float), data[f"vector{n}"].astype(float)) for n in range(count)],
        data["mean"].astype(float),
        data["basis"].astype(float),
        float(data["unlike"]),
        float(data["scatter"]),
        Model(*data["placed"].tolist()),
        Model(*data["free"].tolist()),
        json.loads(str(data["made"])),
    )


def save(network: Network, path: Path = WEIGHTS) -> None:
    """Write what was learned: weights as float32."""
    arrays: dict[str, Any] = {
        "mean": network.mean.astype(np.float32),
        "basis": network.basis.astype(np.float32),
        "unlike": network.unlike,
        "scatter": network.scatter,
        "placed": network.placed.numbers(),
        "free": network.free.numbers(),
        "made": json.dumps(network.made),
    }
    for number, (matrix, vector) in enumerate(network.layers):
        arrays[f"matrix{number}"], arrays[f"vector{number}"] = matrix.astype(np.float32), vector.astype(np.float32)
    np.savez_compressed(path, **arrays)
