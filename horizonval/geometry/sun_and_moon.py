"""Where Sun and Moon are, and how large they look.

Direction: the Earth's heliocentric position from ERFA's VSOP2000 series (``epv00``, 5e-8 au), aberrated with the
Earth's barycentric velocity, taken to Earth-fixed axes with the IAU 2006/2000A matrix (``c2t06a``). This is the
apparent direction from the geocentre. Neglected, with sizes:

* UT1 - UTC (below 0.9 s: 13.5 arcsec about the pole, 0.014 deg of longitude of the terminator), polar motion (0.6
  arcsec): both need a measured table, and a scene's epoch is not known better than that matters;
* the Sun's own motion during the light time (0.01 arcsec), TDB - TT (2 ms: 1e-4 arcsec), light bending (Sun's own
  direction: none at its centre);
* parallax of the observer (9 arcsec from low orbit, 58 arcsec from geostationary orbit) and aberration by orbital
  motion (5 arcsec): the Sun is a direction at infinity, one for the whole scene.

The Moon: ERFA's series ``moon98`` (Meeus 1998 after ELP 2000-82; 10 arcsec in longitude, 4 in latitude, 18 km), brought
to Earth-fixed axes with the same matrix. It is near: its direction is taken from where the camera is. Its annual
aberration and the light time leave the observer's motion about the Earth's centre (5 arcsec from low orbit).

How much of a disc in the sky, the Sun's or the Moon's, the Earth hides.

The directions that meet the ellipsoid fill a convex cone, those of the disc another. In coordinates divided by the
ellipsoid's axes the Earth is the unit sphere, and a direction ``d`` from the observer ``p`` meets it where
``p.d < 0`` and::

    f(d) = |d|^2 - |p x d|^2 > 0

On the disc's edge ``f`` is a trigonometric polynomial of degree two, so at most four arcs of the edge are hidden or
seen, and they end where a quartic vanishes. That decides without any sum:

* **umbra**: the whole edge is hidden. What is hidden is convex, so all within the edge is hidden, too. The share is 0.
* **full light**: no point of the edge is hidden and the Earth does not lie within the disc. The share is 1.
* otherwise (penumbra, annular eclipse) the hidden solid angle is the integral of ``(1 - cos theta) d phi`` about the
  disc's centre round what bounds it (Green's theorem): the hidden arcs of the edge, on which it is a product, and the
  arcs of the Earth's limb within the disc, on which the integrand is smooth and Gauss's quadrature has converged.

The Earth's shape is exact. Refraction and the atmosphere's shadow are not in it.
"""

from __future__ import annotations

from datetime import datetime

import erfa
import numpy as np
from numpy.typing import ArrayLike, NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.geometry import clock
from horizonval.geometry.ellipsoid import WGS84, Ellipsoid
from horizonval.geometry.rotation import off_axis_angle, tangent_basis

SUN_RADIUS_M = 6.957e8
"""IAU 2015 resolution B3 nominal solar radius."""

AU_M = float(erfa.DAU)

MOON_RADIUS_M = 1.7374e6
"""IAU mean radius (Archinal et al. 2018)."""


def _tt_ut(epoch_utc: datetime) -> tuple[float, float, float, float]:
    try:
        (tt1, tt2), (ut1, ut2) = clock.julian_tt(epoch_utc), clock.julian_ut1(epoch_utc)
    except UserError as error:
        raise error.at("platform.epoch_utc") from error
    return float(tt1), float(tt2), float(ut1), float(ut2)


def sun_gcrs(epoch_utc: datetime) -> tuple[FloatArray, float]:
    """Return the apparent direction of the Sun from the geocentre, unit vector shape (3,), and its distance [m].

    Raises
    ------
    UserError
        If the epoch lies outside 1960 to 2099. An epoch without a time zone is UTC.
    """
    tt1, tt2, _, _ = _tt_ut(epoch_utc)
    heliocentric, barycentric = erfa.epv00(tt1, tt2)
    towards = -np.asarray(heliocentric["p"], float)
    distance_au = float(np.linalg.norm(towards))
    velocity_c = np.asarray(barycentric["v"], float) * (erfa.DAU / erfa.DAYSEC / erfa.CMPS)
    direction = erfa.ab(towards / distance_au, velocity_c, distance_au, np.sqrt(1.0 - velocity_c @ velocity_c))
    return np.asarray(direction, float) / np.linalg.norm(direction), distance_au * AU_M


def sun_itrs(epoch_utc: datetime) -> tuple[FloatArray, float]:
    """Return the apparent direction of the Sun in Earth-fixed axes, unit vector shape (3,), and its distance [m].

    See the module text for what is neglected; raises as :func:`sun_gcrs`.
    """
    direction, distance = sun_gcrs(epoch_utc)
    matrix = np.asarray(erfa.c2t06a(*_tt_ut(epoch_utc), 0.0, 0.0), float)
    turned = matrix @ direction
    return turned / np.linalg.norm(turned), distance


def moon_itrs(epoch_utc: datetime) -> FloatArray:
    """Return the Moon's centre in Earth-fixed axes [m], seen from the geocentre, shape (3,); raises as the Sun's."""
    times = _tt_ut(epoch_utc)
    position = np.asarray(erfa.moon98(times[0], times[1])["p"], float) * AU_M
    return np.asarray(erfa.c2t06a(*times, 0.0, 0.0), float) @ position


def phase_angle(from_moon_to_sun: ArrayLike, from_moon_to_observer: ArrayLike) -> float:
    """Return the angle [rad] at the Moon between Sun and observer: 0 for a full Moon."""
    a, b = np.asarray(from_moon_to_sun, float), np.asarray(from_moon_to_observer, float)
    return float(off_axis_angle(a, b))


def sun_angular_radius(distance_m: ArrayLike) -> FloatArray:
    """Return the angular radius of the Sun's disc [rad] at a distance [m] from its centre."""
    return np.arcsin(SUN_RADIUS_M / np.asarray(distance_m, float))


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(48)
# The polynomial's greatest value on eight evenly spaced angles is at least half its greatest anywhere.
_TRIAL_ANGLES = np.arange(8) * (np.pi / 4.0)


def sun_visible_fraction(
    r_itrs: ArrayLike,
    sun_itrs: ArrayLike,
    sun_angular_radius_rad: float,
    ellipsoid: Ellipsoid = WGS84,
    limb_darkening: ArrayLike = (1.0,),
) -> FloatArray:
    """Return the share of the Sun's disc that is seen past the Earth: of its solid angle, or of its light.

    Parameters
    ----------
    r_itrs : array_like, shape (..., 3)
        Observers [m], on or outside the ellipsoid.
    sun_itrs : array_like, shape (3,)
        Unit vector towards the Sun's centre.
    sun_angular_radius_rad : float
        Below a quarter of a turn.
    ellipsoid : Ellipsoid
    limb_darkening : array_like
        Coefficients of ``I(mu) / I(1) = sum a_k mu^k``; the share is then that of the light.

    Returns
    -------
    ndarray, shape (...)
        Exactly 1 in full light, exactly 0 in the umbra, else strictly between with an error below 1e-9.
    """
    r = np.asarray(r_itrs, float)
    fraction = _fractions(
        r.reshape(-1, 3),
        np.asarray(sun_itrs, float),
        float(sun_angular_radius_rad),
        ellipsoid,
        np.asarray(limb_darkening, float),
    )
    return fraction.reshape(r.shape[:-1])


def _fractions(
    r: FloatArray, centre: FloatArray, radius: float, ellipsoid: Ellipsoid, darkening: FloatArray
) -> FloatArray:
    p = r / ellipsoid.axes_m
    # An observer on the surface has the level plane for a limb, whichever way the rounding of his place goes.
    p = p / np.minimum(np.linalg.norm(p, axis=-1, keepdims=True), 1.0)
    scale = ellipsoid.a_m / ellipsoid.axes_m
    frame = np.column_stack([tangent_basis(centre), centre]).T
    edge = np.array([np.sin(radius), np.sin(radius), np.cos(radius)])[:, None] * frame * scale
    cuts = _cuts(p, edge)
    lengths = np.diff(cuts, axis=-1, append=cuts[:, :1] + 2.0 * np.pi)
    hidden = _is_hidden(p, _on_edge(cuts + 0.5 * lengths, edge)) & (lengths > 0.0)
    seen = ~hidden & (lengths > 0.0)
    # Were the Earth within the disc, its centre would be: the cone is convex.
    around = (-(r @ centre) > np.cos(radius) * np.linalg.norm(r, axis=-1)) & ~hidden.any(axis=-1)
    fraction = np.where(seen.any(axis=-1), 1.0, 0.0)
    partly = (hidden.any(axis=-1) & seen.any(axis=-1)) | around
    if partly.any():
        limb = _limb_integral(p[partly], cuts[partly], edge, frame * scale, radius, darkening)
        covered = np.where(hidden, lengths, 0.0)[partly].sum(axis=-1) / (2.0 * np.pi) + limb
        fraction[partly] = np.clip(1.0 - covered, np.finfo(float).tiny, 1.0 - np.finfo(float).epsneg)
    return fraction


def _on_edge(angle: FloatArray, edge: FloatArray) -> FloatArray:
    """Return scaled directions, shape (..., 3), at position angles on the cone that ``edge`` spans."""
    return np.cos(angle)[..., None] * edge[0] + np.sin(angle)[..., None] * edge[1] + edge[2]


def _is_hidden(p: FloatArray, d: FloatArray) -> NDArray[np.bool_]:
    along = np.einsum("ni,nki->nk", p, d)
    across = np.cross(p[:, None], d)
    hidden: NDArray[np.bool_] = (along < 0.0) & ((d**2).sum(axis=-1) > (across**2).sum(axis=-1))
    return hidden


def _cuts(p: FloatArray, edge: FloatArray) -> FloatArray:
    """Return six sorted angles [0, 2 pi) of every observer, all changes between hidden and seen among them.

    Four are the roots of the quartic that the polynomial is in the tangent of half the angle, taken from where the
    polynomial is large, so that no root lies far out; of complex ones the real part, which does no harm. Two are where
    the edge crosses the observer's level plane, which parts the cone from its mirror image behind the observer.
    """
    across = np.cross(p[:, None], edge[None])
    gram = edge @ edge.T - np.einsum("nia,nja->nij", across, across)
    mean = gram[:, 2, 2] + 0.5 * (gram[:, 0, 0] + gram[:, 1, 1])
    first = 2.0 * (gram[:, 0, 2] - 1j * gram[:, 1, 2])
    second = 0.5 * (gram[:, 0, 0] - gram[:, 1, 1]) - 1j * gram[:, 0, 1]
    turn = np.exp(1j * _TRIAL_ANGLES)
    trial = mean[:, None] + (first[:, None] * turn).real + (second[:, None] * turn**2).real
    start = _TRIAL_ANGLES[np.argmax(np.abs(trial), axis=-1)] - np.pi
    first, second = first * np.exp(1j * start), second * np.exp(2j * start)
    a1, b1, a2, b2 = first.real, -first.imag, second.real, -second.imag
    lead = mean - a1 + a2
    lower = np.stack([2.0 * b1 - 4.0 * b2, 2.0 * mean - 6.0 * a2, 2.0 * b1 + 4.0 * b2, mean + a1 + a2], axis=-1)
    companion = np.zeros((len(p), 4, 4))
    companion[:, [1, 2, 3], [0, 1, 2]] = 1.0
    companion[:, 0] = -lower / np.where(lead == 0.0, 1.0, lead)[:, None]
    roots = start[:, None] + 2.0 * np.arctan(np.linalg.eigvals(companion).real)
    level = p @ edge.T
    swing = np.hypot(level[:, 0], level[:, 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        half = np.arccos(-level[:, 2] / swing)
    half = np.where(np.isfinite(half), half, 0.0)
    towards = np.arctan2(level[:, 1], level[:, 0])
    plane = np.stack([towards - half, towards + half], axis=-1)
    return np.sort(np.mod(np.concatenate([roots, plane], axis=-1), 2.0 * np.pi), axis=-1)


def _limb_integral(
    p: FloatArray, cuts: FloatArray, edge: FloatArray, frame: FloatArray, radius: float, darkening: FloatArray
) -> FloatArray:
    """Return what the limb within the disc adds to the hidden share; its arcs end at the edge's cuts or nowhere."""
    distance = np.linalg.norm(p, axis=-1)
    axis = -p / distance[:, None]
    basis = np.array([tangent_basis(direction) for direction in axis])
    sine = 1.0 / distance
    cosine = np.sqrt((distance - 1.0) * (distance + 1.0)) / distance
    ends = np.einsum("nia,nki->nka", basis, _on_edge(cuts, edge))
    ends = np.sort(np.arctan2(ends[..., 1], ends[..., 0]), axis=-1)
    lengths = np.diff(ends, axis=-1, append=ends[:, :1] + 2.0 * np.pi)
    # With the cosine of a half turn the nodes crowd at the ends, where the light of a darkened edge has a root.
    turn = 0.5 * np.pi * (_NODES + 1.0)
    weight = 0.25 * np.pi * np.sin(turn) * _WEIGHTS
    middle = np.array([0.5])
    inside = _limb_terms(ends[..., None] + lengths[..., None] * middle, axis, basis, sine, cosine, frame)[1][..., 0]
    angle = ends[..., None] + lengths[..., None] * (0.5 - 0.5 * np.cos(turn))
    rate, from_centre = _limb_terms(angle, axis, basis, sine, cosine, frame)
    inside = (inside < np.sin(radius)) & (lengths > 0.0)
    power = np.arange(len(darkening)) + 2
    if len(darkening) == 1:
        # (1 - cos theta) / sin(theta)^2 over the disc's 1 - cos(radius)
        cos_from_centre = np.sqrt(np.maximum(1.0 - from_centre**2, 0.0))
        share = 1.0 / ((1.0 + cos_from_centre) * 2.0 * np.sin(0.5 * radius) ** 2)
    else:
        # integral of I(mu) r dr from 0 to r = sin(theta) / sin(radius), with mu dmu = -r dr, over sin(theta)^2
        mu = np.sqrt(np.maximum(1.0 - (from_centre / np.sin(radius)) ** 2, 0.0))
        terms = darkening / power
        series = sum(term * sum(mu**j for j in range(n)) for term, n in zip(terms, power, strict=True))
        share = series / ((1.0 + mu) * np.sin(radius) ** 2 * terms.sum())
    integral = lengths * ((rate * share) @ weight)
    return np.asarray(np.where(inside, integral, 0.0).sum(axis=-1) / (2.0 * np.pi))


def _limb_terms(
    angle: FloatArray,
    axis: FloatArray,
    basis: FloatArray,
    sine: FloatArray,
    cosine: FloatArray,
    frame: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return ``sin(theta)^2 d phi / d angle`` and ``sin(theta)`` of points of the limb; 2 for those behind."""
    cos, sin = np.cos(angle)[..., None], np.sin(angle)[..., None]
    first, second = np.moveaxis(basis[:, None, None], -1, 0)
    expand = (slice(None), None, None, None)
    d = cosine[expand] * axis[:, None, None] + sine[expand] * (cos * first + sin * second)
    change = sine[expand] * (cos * second - sin * first)
    # ``frame`` is scaled; its inverse takes scaled directions to components across and along the disc's axis.
    back = np.linalg.inv(frame)
    u, v, w = np.moveaxis(d @ back, -1, 0)
    du, dv, _ = np.moveaxis(change @ back, -1, 0)
    squared = u**2 + v**2 + w**2
    from_centre = np.sqrt((u**2 + v**2) / squared)
    return (u * dv - v * du) / squared, np.where(w > 0.0, from_centre, 2.0)
