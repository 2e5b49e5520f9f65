"""How the weights were made, from frames with truth.

Every profile of a frame is a lesson of its own: the horizon of the Earth's ellipsoid is known in it exactly. Where it
is looked at is thrown off by a drawn tilt and radius, as a start would be. The network learns the place and its sigma
(Gaussian likelihood), and is kept as it was best on the scenes for validation. What the errors of all profiles of an
image have in common is measured then, on the scenes for validation, which were not learned from, as the four numbers of
:class:`horizonval_learned.fit.Model`. The scenes for test are not read.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

import horizonval as hv
from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.frames import north_east, rotate
from horizonval.geometry.horizon import horizon_by_azimuth
from horizonval.geometry.rotation import tangent_basis
from horizonval_learned.estimator import EARTH_KM, Seen, settle
from horizonval_learned.first_cone import first_cone
from horizonval_learned.fit import Model, solve
from horizonval_learned.frames import Frame, frames, image_alone, index_of
from horizonval_learned.network import Network, features, save
from horizonval_learned.patch import AZIMUTHS, OFFSETS_RAD, Sampler, azimuths_rad

HIDDEN = (48, 48)
EPOCHS, BATCH, RATE = 24, 1024, 4e-3
EVERY = 2
"""Of the profiles of a frame every second is a lesson, neighbours being nearly alike."""
STEPS = {"train": 4, "validation": 4}
"""Of the frames of a split every fourth is looked at: scenes count, and all are in."""
THROWN_RAD = np.radians(0.3)
"""By which a profile is looked at off the horizon: sigma of each component of the tilt and of the radius."""
DIRECTIONS = 8
UNLIKE_SHARE = 1e-3
"""Of the profiles of the validation, that half of the bound of what is known would leave out."""
LEAST_KM = 0.05
"""Of what is not known of a limb: no frames show it finer."""
STOP = {"maxfev": 400, "xatol": 1e-2}
START = Model(spread=10.0, tilt_km=1.0, shape_km=1.0, height_km=2.0)


def train(folder: Path, seed: int = 1, report: Callable[[str], None] = lambda text: None) -> Network:
    """Learn from a data set, and write the weights.

    Parameters
    ----------
    folder : Path
        Of ``horizonval dataset learning --format hdf5``.
    seed : int
        Of all that is drawn; the same frames, seed and libraries give the same weights.
    report : callable
        Is told what is being done.
    """
    started = time.perf_counter()
    lessons = {}
    for split in ("train", "validation"):
        lessons[split] = lessons_of(folder, split, seed)
        report(f"{split}: {len(lessons[split][0])} profiles, {time.perf_counter() - started:.0f} s")
    layers, record = learned(lessons["train"], lessons["validation"], seed, report)
    profiles = lessons["train"][0][:, : len(OFFSETS_RAD)]
    mean = profiles.mean(axis=0)
    basis = np.linalg.eigh(np.cov(profiles, rowvar=False))[1][:, ::-1][:, :DIRECTIONS].T
    network = Network(layers, mean, basis, np.inf, 1.0, START, START, {})
    strange = network.strangeness(lessons["validation"][0][:, : len(OFFSETS_RAD)])
    network = replace(network, unlike=2.0 * float(np.quantile(strange, 1.0 - UNLIKE_SHARE)))
    placed, free = (looks(folder, network, known) for known in (True, False))
    network = replace(network, placed=placed.model(), free=free.model())
    network = replace(network, scatter=float(np.quantile(placed.scatter(network.placed), 0.95)))
    index = index_of(folder)
    made = {
        "frames": {split: -(-index["splits"][split]["frames"] // step) for split, step in STEPS.items()},
        "digest": index["sha256"],
        "seed": seed,
        "seconds": round(time.perf_counter() - started),
        **record,
    }
    network = replace(network, made=made)
    save(network)
    report(f"{network.placed}, {network.free}, unlike {network.unlike:.4f}")
    return network


def lessons_of(folder: Path, split: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return what the network is told of all profiles of a split, float32, and where their horizon lies [deg]."""
    told, places = [], []
    for frame in islice(frames(folder, split), 0, None, STEPS[split]):
        random = np.random.default_rng([seed, frame.frame])
        basis = tangent_basis(frame.nadir_cam)
        nadir = frame.nadir_cam + basis @ random.normal(0.0, THROWN_RAD, 2)
        nadir /= np.linalg.norm(nadir)
        thrown = random.normal(0.0, THROWN_RAD)
        horizon = true_horizon_rad(frame, nadir)
        patch = Sampler(frame.observation).patch(nadir, horizon - thrown)
        limb_km = EARTH_KM / np.tan(horizon.mean())
        told.append(features(patch, limb_km).astype(np.float32)[::EVERY])
        number = np.rint(patch.azimuth_rad * AZIMUTHS / (2.0 * np.pi)).astype(int)
        places.append(np.degrees(offset_rad(frame, nadir, horizon - thrown)[number])[::EVERY])
    return np.concatenate(told), np.concatenate(places).astype(np.float32)


def true_horizon_rad(frame: Frame, nadir: np.ndarray) -> np.ndarray:
    """Return the radius of the true horizon about the true nadir, at the azimuths of a patch about another nadir."""
    x, y = rotate(frame.q_cam_from_itrs, north_east(frame.r_itrs)[0]) @ tangent_basis(nadir)
    return horizon_by_azimuth(frame.r_itrs, WGS84, azimuths_rad() - np.arctan2(y, x))


def offset_rad(frame: Frame, nadir: np.ndarray, rho_rad: np.ndarray) -> np.ndarray:
    """Return how far outside of a horizon about a nadir the true one lies, by azimuth: rows of the fit, exact truth."""
    tilt = tangent_basis(nadir).T @ frame.nadir_cam
    azimuth = azimuths_rad()
    return tilt[0] * np.cos(azimuth) + tilt[1] * np.sin(azimuth) + true_horizon_rad(frame, nadir) - rho_rad


def learned(
    lessons: tuple[np.ndarray, np.ndarray],
    validation: tuple[np.ndarray, np.ndarray],
    seed: int,
    report: Callable[[str], None],
) -> tuple[list[tuple[np.ndarray, np.ndarray]], dict[str, object]]:
    """Return the layers that say the most of the validation, and how well they did.

    The scale of what comes in is put into the first layer.
    """
    import torch
    from torch import nn

    torch.manual_seed(seed)
    torch.use_deterministic_algorithms(True)
    told, places = (torch.from_numpy(x) for x in lessons)
    middle, scale = told.mean(dim=0), told.std(dim=0) + 1e-3
    sizes = (told.shape[1], *HIDDEN, 2)
    parts: list[nn.Module] = []
    for before, after in pairwise(sizes):
        parts += [nn.Linear(before, after), nn.ReLU()]
    net = nn.Sequential(*parts[:-1])

    def loss(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        out = net((x - middle) / scale)
        return (out[:, 1] + 0.5 * ((out[:, 0] - y) * torch.exp(-out[:, 1])) ** 2).mean()

    steps = EPOCHS * (len(told) // BATCH)
    optimiser = torch.optim.Adam(net.parameters())
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=steps)
    checked = tuple(torch.from_numpy(x) for x in validation)
    best, kept, epoch_kept = np.inf, {}, 0
    for epoch in range(EPOCHS):
        order = torch.randperm(len(told))
        for k in range(len(told) // BATCH):
            batch = order[k * BATCH : (k + 1) * BATCH]
            optimiser.zero_grad()
            loss(told[batch], places[batch]).backward()
            nn.utils.clip_grad_norm_(net.parameters(), 1.0)
            optimiser.step()
            schedule.step()
        with torch.no_grad():
            now = float(loss(*checked))
            rms = float(((net((checked[0] - middle) / scale)[:, 0] - checked[1]) ** 2).mean().sqrt())
        report(f"epoch {epoch}: likelihood {now:.4f}, rms of a profile {rms:.4f} deg on the validation")
        if now < best:
            best, epoch_kept = now, epoch
            kept = {name: value.clone() for name, value in net.state_dict().items()}
    net.load_state_dict(kept)
    layers = [
        (part.weight.detach().numpy().T.astype(float), part.bias.detach().numpy().astype(float))
        for part in net
        if isinstance(part, nn.Linear)
    ]
    matrix, vector = layers[0]
    middle_np, scale_np = middle.numpy().astype(float), scale.numpy().astype(float)
    layers[0] = (matrix / scale_np[:, None], vector - (middle_np / scale_np) @ matrix)
    record = {"epoch": epoch_kept, "profiles": len(told), "validation": round(best, 4), "torch": torch.__version__}
    return layers, record


@dataclass(frozen=True)
class Looks:
    """What last rounds of the estimator see of many frames, and where the true nadir is from there."""

    seen: list[Seen]
    tilt: np.ndarray

    def solved(self, model: Model) -> tuple[np.ndarray, np.ndarray]:
        """Return the five unknowns of all frames and their covariances."""
        normal, right = np.array([one.normal for one in self.seen]), np.array([one.right for one in self.seen])
        limb, radius = (np.array([getattr(one, key) for one in self.seen]) for key in ("limb_km", "radius_sigma_rad"))
        return solve(normal, right, model, limb, radius)

    def scatter(self, model: Model) -> np.ndarray:
        """Return the mean squared residuals of the frames' profiles."""
        unknowns, _ = self.solved(model)
        return np.array([one.scatter(x) for one, x in zip(self.seen, unknowns, strict=True)])

    def model(self) -> Model:
        """Return what the errors of profiles have in common: the numbers that make those of the nadirs likeliest."""

        def unlikely(logarithms: np.ndarray) -> float:
            unknowns, covariance = self.solved(Model(*_kept(logarithms)))
            error, wide = 1e3 * (self.tilt - unknowns[:, :2]), 1e6 * covariance[:, :2, :2]
            squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(wide), error)
            return float(np.mean(np.log(np.linalg.det(wide)) + squared))

        start = np.log(START.numbers())
        corners = start + np.vstack([np.zeros(4), np.eye(4)])
        found = minimize(unlikely, start, method="Nelder-Mead", options={**STOP, "initial_simplex": corners})
        return Model(*_kept(found.x).tolist())


def _kept(logarithms: np.ndarray) -> np.ndarray:
    """Return a model's numbers within their bounds; a height that nothing depends on walks anywhere."""
    return np.clip(np.exp(np.clip(logarithms, -20.0, 20.0)), LEAST_KM, 1e3)


def looks(folder: Path, network: Network, placed: bool) -> Looks:
    """Look at every second frame of the validation, with or without the place."""
    seen, tilts = [], []
    for frame in islice(frames(folder, "validation"), 0, None, STEPS["validation"] // 2):
        observation = frame.observation if placed else image_alone(frame.observation)
        start = first_cone(observation)
        settled = start if isinstance(start, hv.Refusal) else settle(observation, network, *start)
        if not isinstance(settled, hv.Refusal):
            seen.append(settled[1])
            tilts.append(tangent_basis(settled[0]).T @ frame.nadir_cam)
    return Looks(seen, np.array(tilts))
