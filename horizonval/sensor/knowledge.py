"""What the platform knows of a frame: what ``[prior]`` states, and truth with an error where it states a sigma alone.

Every quantity has a random stream of its own, seeded with the scene's ``draw`` or name and its seed, as the clouds
are: another key, camera or head moves nothing, and the error goes with its sigma. All heads of a housing and all draws
of the noise therefore share one error. Samples of an orbit are drawn one by one: what a filter would make of them is
not asked.

With unit normals ``n``:

- position: ``r + sigma n``; altitude: ``h + sigma n``, drawn again where it is not above 0;
- attitude: ``q_body_from_itrs = exp(sigma n) q``, a turn about the body's axes;
- Sun: ``s + sigma n`` across the true direction ``s``, in body axes, brought to length 1;
- height of the limb: the mean all round of the lowest height at half the plateau, of a thermal band.

The planet's shape and the clock are taken for exact: a second of time is 7.5 km along a low orbit, and part of what a
position is off by.
"""

from __future__ import annotations

import hashlib
import json
from datetime import datetime
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, nearest
from horizonval.earth.atmosphere import profiles
from horizonval.earth.weather import real_states
from horizonval.earth.weather.real_states import PREFIX
from horizonval.estimation.prior import BY_LATITUDE_MONTH, FILE_KEYS, MEAN_RADIUS_M, Prior
from horizonval.frame import FrameTruth
from horizonval.geometry.ellipsoid import WGS84, geodetic_height
from horizonval.geometry.frames import compose, inverse, rotate
from horizonval.sensor.streams import stream
from horizonval.spec.prior import PAIRS, PriorSpec, is_climate_file


def stated_prior(spec: PriorSpec, where: str = "prior") -> Prior:
    """Return what a table ``[prior]`` says by itself, for a picture whose truth nobody has.

    Raises
    ------
    UserError
        A sigma without its value, or a climate of the place without a time.
    """
    for value, sigma in PAIRS.items():
        if getattr(spec, sigma) is not None and getattr(spec, value) is None:
            raise UserError(
                f"{sigma} without {value}",
                where=where,
                expected="both: this picture carries no truth that a value could be drawn from",
            )
    if spec.sun_sigma_deg is not None:
        raise UserError("sun_sigma_deg", where=where, expected="no such key: no Sun sensor goes with this picture")
    if spec.climate == BY_LATITUDE_MONTH and spec.epoch_utc is None:
        raise UserError(f"climate = {spec.climate!r} without epoch_utc", where=where, expected="the month's date")
    return Prior(**_stated(spec))


def drawn_prior(spec: PriorSpec, truth: FrameTruth, band: str | None = None) -> Prior:
    """Return what is known of a frame, and nothing more of its truth than that.

    Parameters
    ----------
    spec : PriorSpec
    truth : FrameTruth
    band : str, optional
        Whose limb ``limb_height_sigma_km`` is about.

    Raises
    ------
    UserError
        A height of the limb is to be drawn for a band that has none in the truth; a climate that there is not.
    """
    refuse_unknown_climate(spec)
    known = _stated(spec)
    known.setdefault("shape", "sphere" if truth.ellipsoid.is_sphere else "wgs84")
    if spec.shape is None and truth.ellipsoid.is_sphere:
        known["radius_m"] = truth.ellipsoid.a_m
    r = np.array(truth.r_itrs)
    if spec.altitude_sigma_km is not None and spec.altitude_km is None:
        true = _altitude_m(known, r)
        random, altitude = _stream(truth, "altitude"), 0.0
        while altitude <= 0.0:
            altitude = true + known["altitude_sigma_m"] * random.standard_normal()
        known["altitude_m"] = altitude
    if spec.position_sigma_km is not None and spec.position_itrs_km is None:
        known["r_itrs"] = r + known["position_sigma_m"] * _stream(truth, "position").standard_normal(3)
    if spec.attitude_sigma_deg is not None and spec.q_cam_from_itrs is None:
        turn = Rotation.from_rotvec(known["attitude_sigma_rad"] * _stream(truth, "attitude").standard_normal(3))
        mount = np.array(truth.q_cam_from_body)
        known["q_cam_from_itrs"] = compose(mount, turn.as_quat(), inverse(mount), np.array(truth.q_cam_from_itrs))
    if spec.position_sigma_km is not None or spec.attitude_sigma_deg is not None:
        # Nobody knows where he is on a turning Earth without a clock.
        known.setdefault("epoch_utc", datetime.fromisoformat(truth.epoch_utc))
    if spec.limb_height_sigma_km is not None and spec.limb_height_km is None:
        error = known["limb_height_sigma_m"] * _stream(truth, f"limb height {band}").standard_normal()
        known["limb_height_m"] = _limb_height_m(truth, band) + error
    return Prior(**known)


def sun_reading_cam(sigma_rad: float, truth: FrameTruth) -> FloatArray | None:
    """Return what a Sun sensor of this error reads, in camera axes; None where it does not see the Sun."""
    if truth.sun_visible_fraction <= 0.0:
        return None
    mount = np.array(truth.q_cam_from_body)
    # One sensor on the body: all heads have the same reading.
    sun = rotate(inverse(mount), np.array(truth.sun_cam))
    error = sigma_rad * _stream(truth, "sun").standard_normal(3)
    read = sun + error - sun * (sun @ error)
    return rotate(mount, read / np.linalg.norm(read))


def method_radius_m(spec: PriorSpec, truth: FrameTruth) -> float:
    """Return the radius that a spherical method is given."""
    if spec.shape is not None:
        return MEAN_RADIUS_M if spec.radius_km is None else 1e3 * spec.radius_km
    return truth.ellipsoid_a_m if truth.ellipsoid.is_sphere else MEAN_RADIUS_M


def refuse_unknown_climate(spec: PriorSpec) -> None:
    """Raise a ``UserError`` where a climate is neither a name nor a file."""
    if spec.climate is None:
        return
    names = (BY_LATITUDE_MONTH, *profiles.names(), "none", *(f"{PREFIX}{name}" for name in real_states.names()))
    if spec.climate in names or is_climate_file(spec.climate):
        return
    near = ", ".join(nearest(spec.climate, names)[:12])
    raise UserError(
        f"found {spec.climate!r}",
        where="prior.climate",
        expected=f"a profile file (.csv, .json), a table (.npz) or one of {near}",
    )


def _stated(spec: PriorSpec) -> dict[str, Any]:
    """Return all that is in a table in SI units; without what it leaves out."""
    known: dict[str, Any] = {}
    for key, name, factor in FILE_KEYS:
        value = getattr(spec, key)
        if value is not None:
            known[name] = value if factor is None else factor * np.asarray(value, dtype=np.float64)
    return {name: float(v) if isinstance(v, np.ndarray) and v.ndim == 0 else v for name, v in known.items()}


def _altitude_m(known: dict[str, Any], r_itrs: FloatArray) -> float:
    if known["shape"] == "sphere":
        return float(np.linalg.norm(r_itrs)) - float(known.get("radius_m", MEAN_RADIUS_M))
    return float(geodetic_height(r_itrs, WGS84))


def _limb_height_m(truth: FrameTruth, band: str | None) -> float:
    heights = truth.infrared_horizon.get(band, {}).get("half_plateau_height_m") if band is not None else None
    if not heights or not np.isfinite(heights).any():
        raise UserError(
            f"limb_height_sigma_km alone, but the truth has no limb height of the band {band!r}",
            where="prior",
            expected="limb_height_km beside it",
        )
    return float(np.nanmean(heights))


def _stream(truth: FrameTruth, what: str) -> np.random.Generator:
    scene = truth.scene.get("scene", {})
    identity = json.dumps(["prior", scene.get("draw") or scene.get("name"), scene.get("seed")])
    return stream(hashlib.sha256(identity.encode()).hexdigest(), "", "", f"prior {what}", 0)
