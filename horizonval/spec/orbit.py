"""An orbit and how the body turns along it: the table ``[cases.orbit]`` of a suite."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from horizonval.spec.base import Angle, Epoch, Listed, Model, NonNegative, Positive, Vector, unit

Angles = Annotated[tuple[Angle, Angle, Angle], Listed]
Hour = Annotated[float, Field(ge=0, le=24)]

MOST_SAMPLES = 100_000
_SIZES = ("altitude_km", "semi_major_axis_km", "perigee_km")


def _text_of_number(value: Any) -> Any:
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


class SlewSpec(Model):
    """A turn from the offset to other angles."""

    to_deg: Angles
    """Yaw, pitch and roll at the end, against the reference."""
    start_s: NonNegative = 0.0
    """Time of its start, from the first sample."""
    duration_s: Positive
    """How long it takes."""


class ErrorSpec(Model):
    """A pointing error: a stationary Gaussian process about each axis."""

    rms_deg: Annotated[tuple[NonNegative, NonNegative, NonNegative], Listed]
    """Standard deviation about yaw, pitch and roll."""
    correlation_s: Positive = 60.0
    """Time over which the error keeps its value."""


class OrbitAttitude(Model):
    """What the body does along the orbit; see `horizonval.geometry.attitude_profile`."""

    pointing: Literal["nadir", "sun", "inertial"] = "nadir"
    """Reference: `nadir` (the local vertical), `sun` (`sun_axis` towards it) or `inertial` (the local vertical of the
    first instant).
    """
    offset_deg: Angles = (0.0, 0.0, 0.0)
    """Yaw, pitch and roll against the reference."""
    slew: SlewSpec | None = None
    """A turn from the offset to other angles."""
    tumble_deg_s: Vector = (0.0, 0.0, 0.0)
    """A constant rate, in body axes."""
    error: ErrorSpec | None = None
    """A random pointing error."""
    sun_axis: Annotated[Vector, unit("1")] = (0.0, 0.0, -1.0)
    """Axis of the body that `pointing = "sun"` turns towards the Sun; of any length but 0."""
    file: str | None = None
    """File next to the suite with the body's attitude, in place of all other keys: an attitude ephemeris message
    of CCSDS, or a table with `time_utc` and `q_body_from_gcrs_x` to `_w`.
    """
    body_axes: str | None = None
    """With the orbit's `kernels`: the frame of the body, whose attitude they say in place of all other keys."""

    @model_validator(mode="after")
    def _the_axis_has_a_direction(self) -> OrbitAttitude:
        if not any(self.sun_axis):
            raise ValueError("sun_axis must not be zero")
        return self

    @model_validator(mode="after")
    def _a_file_says_all(self) -> OrbitAttitude:
        given = self.model_fields_set
        for key in ("file", "body_axes"):
            if getattr(self, key) is not None and given != {key}:
                raise ValueError(f"{key} says the whole attitude; leave out {', '.join(sorted(given - {key}))}")
        return self


class OrbitSpec(Model):
    """Samples of an orbit, evenly spread over some revolutions or seconds; the end itself is left out.

    Size: `altitude_km`, `perigee_km` with `apogee_km`, or `semi_major_axis_km` with `eccentricity`. Plane:
    `inclination_deg`, or `sun_synchronous = true`. Node: one of `raan_deg`, `node_longitude_deg`, `ltan_h`, `ltdn_h`.
    Or, in place of them all, `tle`, `ephemeris`, or `kernels` with `spacecraft`.
    """

    epoch_utc: Epoch | None = None
    """Time of the first sample, UTC. With `tle`, `ephemeris` or `kernels` it can be left out: the orbit then starts at
    the elements' own epoch, or with the first state.
    """
    altitude_km: Positive | None = None
    """Altitude of a circle, above the equator's radius."""
    perigee_km: Positive | None = None
    """Altitude of the perigee, above the equator's radius."""
    apogee_km: Positive | None = None
    """Altitude of the apogee, above the equator's radius."""
    semi_major_axis_km: Positive | None = None
    """Half the long axis of the ellipse."""
    eccentricity: Annotated[float, Field(ge=0, le=0.95), unit("1")] | None = None
    """Eccentricity; goes with `semi_major_axis_km`."""
    inclination_deg: Annotated[float, Field(ge=0, le=180)] | None = None
    """Inclination against the equator."""
    sun_synchronous: bool = False
    """Whether the node keeps pace with the mean Sun; the inclination follows."""
    raan_deg: Angle | None = None
    """Right ascension of the ascending node, equinox of date."""
    node_longitude_deg: Angle | None = None
    """Longitude where the ascending node is passed over at the epoch."""
    ltan_h: Hour | None = None
    """Mean local time of the ascending node."""
    ltdn_h: Hour | None = None
    """Mean local time of the descending node."""
    argument_of_perigee_deg: Angle = 0.0
    """Angle from the node to the perigee."""
    true_anomaly_deg: Angle = 0.0
    """Angle from the perigee to the first sample."""
    tle: Annotated[list[str], Field(min_length=2, max_length=3)] | str | None = None
    """Two-line elements: the two lines (a title before them is allowed), or the file next to the suite that holds them
    or mean elements in another form: an OMM of CCSDS, JSON or CSV. SGP4 gives the positions; far from the epoch of the
    elements there is a warning.
    """
    satellite: Annotated[str, BeforeValidator(_text_of_number, json_schema_input_type=str | int)] | None = None
    """With `tle`, `ephemeris` or `attitude.file`: which satellite of a file of several, by its name, catalogue number
    or international designator.
    """
    ephemeris: str | None = None
    """File next to the suite with the satellite's positions: an orbit ephemeris message of CCSDS, KVN or XML, mean
    elements (see `tle`), or a table with `time_utc` and `x_gcrs_km` to `z_gcrs_km`, or the same with `itrs`.
    """
    kernels: Annotated[list[str], Field(min_length=1)] | None = None
    """SPICE kernels next to the suite: leap seconds, SPK, and what the attitude needs (CK, clock, frames)."""
    spacecraft: str | None = None
    """With `kernels`: name or number of the spacecraft."""
    revolutions: Annotated[Positive, unit("1")] | None = None
    """Span of the samples in revolutions."""
    duration_s: Positive | None = None
    """Span of the samples in seconds."""
    n: Annotated[int, Field(ge=1, le=MOST_SAMPLES), unit("1")]
    """Number of samples."""
    attitude: OrbitAttitude = OrbitAttitude()
    """What the body does along the orbit."""

    @model_validator(mode="after")
    def _one_duration(self) -> OrbitSpec:
        if self.revolutions is not None and self.duration_s is not None:
            raise ValueError("give at most one of revolutions and duration_s")
        return self

    @model_validator(mode="after")
    def _lines_or_elements(self) -> OrbitSpec:
        sources = [key for key in ("tle", "ephemeris", "kernels") if getattr(self, key) is not None]
        if (self.kernels is None) != (self.spacecraft is None):
            raise ValueError("kernels and spacecraft go together")
        if self.attitude.body_axes is not None and self.kernels is None:
            raise ValueError("attitude.body_axes goes with kernels")
        if self.satellite is not None and self.attitude.file is None and not {"tle", "ephemeris"} & set(sources):
            raise ValueError("satellite goes with tle or ephemeris, or with attitude.file")
        if sources:
            own = {"epoch_utc", sources[0], "spacecraft", "satellite", "revolutions", "duration_s", "n", "attitude"}
            if more := self.model_fields_set - own:
                raise ValueError(f"{sources[0]} says the whole orbit; leave out {', '.join(sorted(more))}")
            return self
        if self.epoch_utc is None:
            raise ValueError("epoch_utc is missing")
        self._check_size()
        self._check_plane()
        return self

    def _check_size(self) -> None:
        given = [key for key in _SIZES if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError("give one of altitude_km, perigee_km with apogee_km, semi_major_axis_km with eccentricity")
        if (self.perigee_km is None) != (self.apogee_km is None):
            raise ValueError("perigee_km and apogee_km go together")
        if self.perigee_km is not None and self.apogee_km is not None and self.apogee_km < self.perigee_km:
            raise ValueError("apogee_km must not be below perigee_km")
        if self.eccentricity is not None and self.semi_major_axis_km is None:
            raise ValueError("eccentricity goes with semi_major_axis_km")

    def _check_plane(self) -> None:
        if self.sun_synchronous == (self.inclination_deg is not None):
            raise ValueError("give one of inclination_deg and sun_synchronous = true")
        nodes = [
            key for key in ("raan_deg", "node_longitude_deg", "ltan_h", "ltdn_h") if getattr(self, key) is not None
        ]
        if len(nodes) > 1:
            raise ValueError(f"give one of {' and '.join(nodes)}")
