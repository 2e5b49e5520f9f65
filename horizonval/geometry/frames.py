"""Frames and the rotations between them.

``itrs`` is Earth-fixed. ``lvlh`` has z to the Earth's centre, x towards the velocity and y completing them. ``body``
is the satellite and ``cam`` the camera (x right, y down, z along the boresight). ``q_b_from_a`` is a scalar-last
quaternion that maps components in ``a`` to components in ``b``. Attitude is yaw about z, then pitch about y, then roll
about x, as rotations of the frame::

    R_b_from_a = Rx(roll) Ry(pitch) Rz(yaw)
    nadir_body = (-sin pitch, cos pitch sin roll, cos pitch cos roll)

so that roll and pitch follow from the nadir vector alone, and yaw does not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.geometry.ellipsoid import geocentric_nadir


def rotate(q_b_from_a: ArrayLike, v_a: ArrayLike) -> FloatArray:
    """Return vectors of shape (..., 3) given in ``a`` as components in ``b``; one quaternion, shape (4,)."""
    v = np.asarray(v_a, float)
    return v @ Rotation.from_quat(np.asarray(q_b_from_a, float)).as_matrix().T


def inverse(q_b_from_a: ArrayLike) -> FloatArray:
    """Return ``q_a_from_b``, shape (4,)."""
    return Rotation.from_quat(np.asarray(q_b_from_a, float)).inv().as_quat(canonical=True)


def compose(*quaternions: ArrayLike) -> FloatArray:
    """Return ``q_c_from_a`` of ``compose(q_c_from_b, q_b_from_a)``: in the order in which matrices are multiplied."""
    product = Rotation.identity()
    for q in quaternions:
        product = product * Rotation.from_quat(np.asarray(q, float))
    return product.as_quat(canonical=True)


def from_yaw_pitch_roll(yaw_rad: float, pitch_rad: float, roll_rad: float) -> FloatArray:
    """Return ``q_b_from_a``, shape (4,), of ``R_b_from_a = Rx(roll) Ry(pitch) Rz(yaw)``."""
    # scipy rotates vectors; a rotation of the frame is the inverse of it.
    return Rotation.from_euler("ZYX", [yaw_rad, pitch_rad, roll_rad]).inv().as_quat(canonical=True)


def to_yaw_pitch_roll(q_b_from_a: ArrayLike) -> tuple[float, float, float]:
    """Return yaw, pitch and roll [rad] of :func:`from_yaw_pitch_roll`, with ``|pitch| <= pi / 2``.

    At ``|pitch| = pi / 2`` only yaw and roll together are defined; roll is then 0.
    """
    m = Rotation.from_quat(np.asarray(q_b_from_a, float)).as_matrix()
    cos_pitch = float(np.hypot(m[0, 0], m[0, 1]))
    pitch = float(np.arctan2(-m[0, 2], cos_pitch))
    if cos_pitch < 1e-12:
        return float(np.arctan2(-m[1, 0], m[1, 1])), pitch, 0.0
    return float(np.arctan2(m[0, 1], m[0, 0])), pitch, float(np.arctan2(m[1, 2], m[2, 2]))


def body_from_lvlh(yaw_rad: float, pitch_rad: float, roll_rad: float) -> FloatArray:
    """Return ``q_body_from_lvlh``, shape (4,)."""
    return from_yaw_pitch_roll(yaw_rad, pitch_rad, roll_rad)


def cam_from_body(mount_yaw_rad: float, mount_pitch_rad: float, mount_roll_rad: float) -> FloatArray:
    """Return ``q_cam_from_body``, shape (4,)."""
    return from_yaw_pitch_roll(mount_yaw_rad, mount_pitch_rad, mount_roll_rad)


def north_east(r_itrs: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return unit vectors to the north and east in the *geocentric* level plane at one position, shape (3,) each.

    At a pole, "north" goes on along the meridian of ``atan2(y, x)``: towards the pole at 90 degrees north it points
    away from that meridian. A position made from latitude, longitude and height keeps its longitude in the rounding
    of x and y, so the heading there is what the user meant.
    """
    r = np.asarray(r_itrs, float)
    lon = np.arctan2(r[1], r[0])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    return np.cross(-geocentric_nadir(r), east), east


def lvlh_from_itrs(r_itrs: ArrayLike, heading_rad: float) -> FloatArray:
    """Return ``q_lvlh_from_itrs``, shape (4,).

    Parameters
    ----------
    r_itrs : array_like, shape (3,)
        Position.
    heading_rad : float
        Azimuth of the velocity, from north towards east in the geocentric level plane. The velocity's radial part is
        left out: lvlh is defined by nadir and orbital plane, and a radial part changes neither.
    """
    down = geocentric_nadir(r_itrs)
    north, east = north_east(r_itrs)
    forward = np.cos(heading_rad) * north + np.sin(heading_rad) * east
    return Rotation.from_matrix(np.stack([forward, np.cross(down, forward), down])).as_quat(canonical=True)


def roll_pitch_of_nadir(nadir_body: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return roll (in ``(-pi, pi]``) and pitch (in ``[-pi/2, pi/2]``) [rad] of nadir vectors, shape (..., 3).

    Inverse of ``nadir_body = (-sin pitch, cos pitch sin roll, cos pitch cos roll)``. At ``|pitch| = pi / 2`` roll is
    not defined and 0 is returned.
    """
    n = np.asarray(nadir_body, float)
    return np.arctan2(n[..., 1], n[..., 2]), np.arctan2(-n[..., 0], np.hypot(n[..., 1], n[..., 2]))


def nadir_of_roll_pitch(roll_rad: ArrayLike, pitch_rad: ArrayLike) -> FloatArray:
    """Return the nadir in body axes, shape (..., 3); see :func:`roll_pitch_of_nadir`."""
    roll, pitch = np.broadcast_arrays(np.asarray(roll_rad, float), np.asarray(pitch_rad, float))
    return np.stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=-1)
