"""A row of results: what one estimator reported of one image, its errors, and the conditions.

:class:`Row` is the one place where a column is spelled: name, type, unit and meaning are at its field. The schema of
``results.parquet``, the rows of ``cases/*.json`` and the reference of the columns follow from :data:`COLUMNS`.

The table of results has one row per case and estimator, stored as Parquet. The same rows in any order give the same
bytes: rows are sorted, and no clock or machine is stored. The file is sealed (:mod:`horizonval.core.sealed`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, get_args, get_type_hints

import duckdb

from horizonval.core import atomic, files, sealed
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.core.outcome import Outcome
from horizonval.frame import FrameTruth
from horizonval.scoring.bound import NO_BOUND, Bound
from horizonval.scoring.expected import Expected
from horizonval.sensor.knowledge import errors_of
from horizonval.truth.infrared_horizon import visible_height_m


@dataclass(frozen=True)
class Meaning:
    """What a field of a row says, in one sentence, and its unit where it has one."""

    text: str
    unit: str = ""


@dataclass(frozen=True)
class Column:
    """A column of the table of results; ``optional``: empty where it does not apply."""

    name: str
    unit: str
    meaning: str
    sql_type: str
    optional: bool

    def accepts(self, value: object) -> bool:
        """Whether a value is of the column's type, and finite."""
        if value is None:
            return self.optional
        if self.sql_type != "BOOLEAN" and isinstance(value, bool):
            return False
        if self.sql_type == "DOUBLE":
            return isinstance(value, float | int) and math.isfinite(value)
        return isinstance(value, _PYTHON_TYPES[self.sql_type])


_SQL_TYPES: dict[type, str] = {str: "VARCHAR", float: "DOUBLE", int: "INTEGER", bool: "BOOLEAN"}
_PYTHON_TYPES = {sql: kind for kind, sql in _SQL_TYPES.items()}


@dataclass(frozen=True, kw_only=True)
class _Question:
    """Which estimator saw which image, and what it should report."""

    case: Annotated[str, Meaning("Name of the case, in a scene of several heads the head's or the scene's.")]
    camera: Annotated[str, Meaning("Name of the camera.")]
    band: Annotated[str, Meaning("Name of the camera's band.")]
    estimator: Annotated[str, Meaning("Name of the estimator.")]
    expected: Annotated[str, Meaning("Outcome that follows from the frame's truth alone.")]
    borderline: Annotated[
        bool | None,
        Meaning("Close to a threshold: neither a claim nor a refusal counts against an estimator."),
    ] = None


@dataclass(frozen=True, kw_only=True)
class Score:
    """What an estimator reported for a frame and how far it is from the truth. ``None`` where nothing applies.

    Examples
    --------
    >>> import horizonval as hv
    >>> frame = hv.open_frame("frame.exr")
    >>> hv.score(hv.estimate(frame, "ideal"), frame)
    <Score valid: nadir off by 0.0000 deg>
    """

    status: Annotated[str, Meaning("Outcome that the estimator reported.")]
    reason: Annotated[str | None, Meaning("Why it refused; empty for a claim.")] = None
    nadir_error_arcsec: Annotated[float | None, Meaning("Angle between the claimed and the true nadir.", "arcsec")] = (
        None
    )
    roll_error_arcsec: Annotated[
        float | None, Meaning("Claimed minus true roll, within +-180 deg; empty near a pitch of +-90 deg.", "arcsec")
    ] = None
    pitch_error_arcsec: Annotated[float | None, Meaning("Claimed minus true pitch, within +-180 deg.", "arcsec")] = None
    altitude_error_km: Annotated[
        float | None,
        Meaning(
            "Claimed altitude minus (distance to the Earth's centre - radius that the method assumes): the method's "
            "own quantity, R / sin(rho) - R on a sphere.",
            "km",
        ),
    ] = None
    altitude_error_geodetic_km: Annotated[
        float | None,
        Meaning("Claimed altitude minus the geodetic height: up to 14 km from the former on the ellipsoid.", "km"),
    ] = None
    angular_radius_error_arcsec: Annotated[
        float | None,
        Meaning("Claimed minus true angular radius of the Earth, of an ellipsoid the mean over the horizon.", "arcsec"),
    ] = None
    sigma_nadir_arcsec: Annotated[
        float | None,
        Meaning("Claimed root mean square of the nadir error by noise: root of the covariance's trace.", "arcsec"),
    ] = None
    nees_nadir: Annotated[
        float | None,
        Meaning(
            "Normalised error squared of the nadir by the claimed covariance of noise alone, 2 degrees of freedom; "
            "empty where that covariance is singular.",
        ),
    ] = None
    sigma_systematic_arcsec: Annotated[
        float | None, Meaning("Root mean square of the claimed model error of the nadir.", "arcsec")
    ] = None
    nees_nadir_total: Annotated[
        float | None,
        Meaning("Normalised error squared by noise and claimed model error together, 2 degrees of freedom."),
    ] = None
    nees_noise: Annotated[
        float | None,
        Meaning(
            "Normalised error squared of fits of the frame under several draws of the noise, about their own mean; "
            "empty where the suite asks for one draw, and with fewer than two fits.",
        ),
    ] = None
    noise_draws: Annotated[
        int | None, Meaning("Draws of the noise with a fit; empty where the suite asks for one draw.")
    ] = None
    n_points: Annotated[int, Meaning("Limb points used.")] = 0
    false_valid: Annotated[bool, Meaning("A claim that is wrong: beyond the limit, or beyond its own sigma.")] = False
    without_sigma: Annotated[
        bool,
        Meaning("A claim whose covariance claims no uncertainty in some direction: judged by a sigma of 72 arcsec."),
    ] = False

    @property
    def nadir_error_deg(self) -> float | None:
        """Angle between the claimed and the true nadir [deg]; ``None`` for a refusal."""
        return None if self.nadir_error_arcsec is None else self.nadir_error_arcsec / 3600.0

    @property
    def is_claim(self) -> bool:
        """Whether an attitude was claimed."""
        return self.status == Outcome.VALID

    @property
    def is_right(self) -> bool:
        """Whether an attitude was claimed that is not false."""
        return self.is_claim and not self.false_valid

    @property
    def sigma_total_arcsec(self) -> float | None:
        """Claimed standard deviation [arcsec], noise and model error together; ``None`` without a claim of it."""
        if self.sigma_nadir_arcsec is None:
            return None
        return math.hypot(self.sigma_nadir_arcsec, self.sigma_systematic_arcsec or 0.0)

    def __repr__(self) -> str:
        if self.nadir_error_deg is None:
            return f"<Score {self.status}: {self.reason}>"
        false = ", a false claim" if self.false_valid else ""
        return f"<Score {self.status}: nadir off by {self.nadir_error_deg:.4f} deg{false}>"


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Under which conditions an image was taken, from the truth alone; all empty for a frame that could not be made."""

    epoch_utc: Annotated[str | None, Meaning("Instant of the frame, ISO 8601.")] = None
    altitude_km: Annotated[float | None, Meaning("Geodetic height of the camera.", "km")] = None
    roll_deg: Annotated[float | None, Meaning("True roll of the body against lvlh.", "deg")] = None
    pitch_deg: Annotated[float | None, Meaning("True pitch of the body against lvlh.", "deg")] = None
    yaw_deg: Annotated[float | None, Meaning("True yaw of the body against lvlh.", "deg")] = None
    sun_zenith_deg: Annotated[
        float | None, Meaning("The Sun's zenith angle at the point below the satellite.", "deg")
    ] = None
    sun_visible_fraction: Annotated[
        float | None, Meaning("Share of the Sun's disc seen past the Earth from the camera.", "1")
    ] = None
    sun_in_frame: Annotated[bool | None, Meaning("Whether any visible part of the Sun's disc is in the image.")] = None
    sun_boresight_deg: Annotated[
        float | None,
        Meaning(
            "From the optical axis to the Sun's centre, behind the Earth or not; of several heads the nearest.", "deg"
        ),
    ] = None
    horizon_arc_px: Annotated[float | None, Meaning("Length of the horizon in the image.", "px")] = None
    lit_fraction: Annotated[
        float | None,
        Meaning(
            "Share of that length over which the Sun stands, 1 in thermal bands; empty without horizon in view.", "1"
        ),
    ] = None
    limb_snr: Annotated[
        float | None, Meaning("Median signal-to-noise ratio of the limb in view, the Sun's veil included.", "1")
    ] = None
    veil_fraction: Annotated[
        float | None, Meaning("Largest veil of stray light on the limb in view, as a share of full scale.", "1")
    ] = None
    moon_in_frame: Annotated[bool | None, Meaning("Whether any part of the Moon's disc is in the image.")] = None
    bound_noise_arcsec: Annotated[
        float | None,
        Meaning(
            "Smallest root mean square error of the nadir that the detector's noise allows, all else known; empty "
            "where the limb does not determine it, and of images from before it was stored.",
            "arcsec",
        ),
    ] = None
    bound_arcsec: Annotated[
        float | None,
        Meaning(
            "The same with air, relief, light, blur and the height of the limb as known as the scene says.", "arcsec"
        ),
    ] = None
    bound_altitude_km: Annotated[float | None, Meaning("The same of the distance from the Earth's centre.", "km")] = (
        None
    )
    ir_horizon_km: Annotated[
        float | None,
        Meaning("Mean height of the infrared horizon in view (half plateau, clear sky); empty in solar bands.", "km"),
    ] = None
    focal_length_error_percent: Annotated[
        float | None,
        Meaning(
            "Given less true focal length; empty without `[calibration]`, as the columns that follow.",
            "%",
        ),
    ] = None
    principal_point_error_u_px: Annotated[float | None, Meaning("The same of the principal point's column.", "px")] = (
        None
    )
    principal_point_error_v_px: Annotated[float | None, Meaning("The same of its row.", "px")] = None
    distortion_error_px: Annotated[
        float | None, Meaning("The same of the radial distortion, at the image's farthest corner.", "px")
    ] = None
    mounting_error_x_deg: Annotated[
        float | None,
        Meaning("Given less true mounting about the body's x: what it adds to the roll of a level body.", "deg"),
    ] = None
    mounting_error_y_deg: Annotated[float | None, Meaning("The same about its y.", "deg")] = None
    mounting_error_z_deg: Annotated[float | None, Meaning("The same about its z.", "deg")] = None
    exposure_offset_s: Annotated[
        float | None, Meaning("By how much later than its stamp the image was taken.", "s")
    ] = None
    clock_error_s: Annotated[float | None, Meaning("By how much the clock was ahead.", "s")] = None


@dataclass(frozen=True, kw_only=True)
class Row(Conditions, Score, _Question):
    """What one estimator reported of one image: question, score, conditions, and where the images lie.

    The fields are the columns of the table, in its order: :data:`COLUMNS` has their units and meanings. ``None`` means
    that a column does not apply.

    Raises
    ------
    ValueError
        A value is not of its column's type, or not finite: a defect of whoever made it.
    """

    error_over_bound: Annotated[
        float | None,
        Meaning(
            "Nadir error over the bound that counts what is not known: mean square 1 of a method that uses all.",
            "1",
        ),
    ] = None
    frame_address: Annotated[str | None, Meaning("Address of the frame in the archive; empty where not stored.")] = None
    image_address: Annotated[str | None, Meaning("Address of the image in the archive; empty where not stored.")] = None

    def __post_init__(self) -> None:
        for column in COLUMNS:
            value = getattr(self, column.name)
            if not column.accepts(value):
                raise ValueError(f"{column.name} = {value!r} is not a finite {column.sql_type}")

    @property
    def is_due(self) -> bool:
        """Whether the image should give an attitude, and clearly so."""
        return self.expected == Outcome.VALID and not self.borderline

    @property
    def is_failure(self) -> bool:
        """Whether the outcome is a false claim, a crash, or a claim or refusal that was not expected."""
        return self.false_valid or self.status == Outcome.CRASHED or self.is_claim != (self.expected == Outcome.VALID)

    @property
    def sort_key(self) -> tuple[str, str, str, str]:
        """The order of the table."""
        return self.case, self.estimator, self.camera, self.band

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, every column in the table's order."""
        return {column.name: getattr(self, column.name) for column in COLUMNS}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Row:
        """Rebuild from :meth:`to_dict`; a column that is not there is empty.

        Raises
        ------
        ValueError
            A column that does not exist, one that must not be empty, or a value of the wrong type.
        """
        known = {column.name: column for column in COLUMNS}
        if unknown := sorted(set(data) - set(known)):
            raise ValueError(f"unknown columns {unknown}")
        if empty := [name for name in _REQUIRED if data.get(name) is None]:
            raise ValueError(f"{empty[0]} is empty")
        return cls(**data)


def conditions_of(truth: FrameTruth, expected: Expected, band: str, bound: Bound | None = None) -> Conditions:
    """Return the conditions of one band of a frame, and what its limb allows."""
    infrared_height_m = visible_height_m(truth, band)
    bound = bound or NO_BOUND
    return Conditions(
        epoch_utc=truth.epoch_utc,
        altitude_km=truth.altitude_m / 1e3,
        roll_deg=math.degrees(truth.roll_rad),
        pitch_deg=math.degrees(truth.pitch_rad),
        yaw_deg=math.degrees(truth.yaw_rad),
        sun_zenith_deg=expected.sun_zenith_deg,
        sun_visible_fraction=truth.sun_visible_fraction,
        sun_in_frame=expected.sun_in_frame,
        sun_boresight_deg=math.degrees(truth.sun_boresight_rad),
        horizon_arc_px=expected.horizon_arc_px,
        lit_fraction=expected.lit_fraction,
        limb_snr=expected.limb_snr,
        veil_fraction=expected.veil_fraction,
        moon_in_frame=expected.moon_in_frame,
        bound_noise_arcsec=bound.noise_arcsec,
        bound_arcsec=bound.known_arcsec,
        bound_altitude_km=None if bound.altitude_m is None else bound.altitude_m / 1e3,
        ir_horizon_km=None if infrared_height_m is None else infrared_height_m / 1e3,
        **_of_calibration(truth),
    )


def _of_calibration(truth: FrameTruth) -> dict[str, float]:
    """Return the errors of the camera and the time that an estimator was given; nothing without the table."""
    if truth.scene.get("calibration") is None:
        return {}
    errors = errors_of(truth)
    u, v = errors.principal_point_px
    x, y, z = (math.degrees(angle) for angle in errors.mounting_rad)
    return {
        "focal_length_error_percent": 100.0 * errors.focal_length,
        "principal_point_error_u_px": u,
        "principal_point_error_v_px": v,
        "distortion_error_px": errors.distortion_px,
        "mounting_error_x_deg": x,
        "mounting_error_y_deg": y,
        "mounting_error_z_deg": z,
        "exposure_offset_s": errors.exposure_offset_s,
        "clock_error_s": errors.clock_s,
    }


def make_row(
    *,
    case: str,
    camera: str,
    band: str,
    estimator: str,
    truth: FrameTruth,
    expected: Expected,
    score: Score,
    bound: Bound | None = None,
    frame_address: str | None = None,
    image_address: str | None = None,
) -> Row:
    """Return the row of one estimator on one image, its numbers rounded to the digits that are results.

    Angles in arcsec to :data:`ARCSEC_DECIMALS`, which is what fits are rounded to
    (:mod:`horizonval.plugins.answer`), other numbers to :data:`SIGNIFICANT` digits: what is beyond is a matter of
    the processor, and rows promise bytes.
    """
    values = {**vars(score), **vars(conditions_of(truth, expected, band, bound))}
    if score.nadir_error_arcsec is not None and bound is not None and bound.known_arcsec is not None:
        values["error_over_bound"] = score.nadir_error_arcsec / bound.known_arcsec
    return Row(
        case=case,
        camera=camera,
        band=band,
        estimator=estimator,
        expected=str(expected.outcome),
        borderline=expected.borderline,
        frame_address=frame_address,
        image_address=image_address,
        **{name: rounded(name, value) for name, value in values.items()},
    )


def to_digits(score: Score) -> Score:
    """Return a score whose numbers are rounded as a row's are (:func:`make_row`)."""
    return replace(score, **{name: rounded(name, value) for name, value in vars(score).items()})


def rounded(name: str, value: Any) -> Any:
    """Return the value of a column rounded to the digits that are results."""
    if not isinstance(value, float):
        return value
    return round(value, ARCSEC_DECIMALS) if name in _IN_ARCSEC else float(f"{value:.{SIGNIFICANT}g}")


def _columns() -> tuple[Column, ...]:
    hints = get_type_hints(Row, include_extras=True)
    columns = []
    for field in fields(Row):
        annotation, meaning = get_args(hints[field.name])
        kinds = set(get_args(annotation) or (annotation,))
        (kind,) = kinds - {NoneType}
        columns.append(Column(field.name, meaning.unit, meaning.text, _SQL_TYPES[kind], optional=NoneType in kinds))
    return tuple(columns)


COLUMNS = _columns()
"""The columns of the table of results, in its order."""

ARCSEC_DECIMALS = 7
SIGNIFICANT = 10
"""Digits of a row's numbers that are not in arcsec."""

_IN_ARCSEC = {column.name for column in COLUMNS if column.unit == "arcsec"}

RETIRED = ("determined_deg",)
"""Columns of tables of earlier versions that are not read."""

_REQUIRED = tuple(field.name for field in fields(Row) if field.default is MISSING)


LARGEST_TABLE = 1 << 34
"""Size of a table [bytes]."""

_PATTERN = re.compile(r"[*?\[]")
"""What DuckDB does not take for itself in a path."""


def write_results(rows: Iterable[Row], path: Path) -> Path:
    """Write rows to a Parquet file; the file appears whole or not at all."""
    ordered = sorted(rows, key=lambda row: row.sort_key)
    columns = ", ".join(f'unnest(${i + 1}::{c.sql_type}[]) AS "{c.name}"' for i, c in enumerate(COLUMNS))
    # One thread keeps row order and row groups, hence the bytes, independent of the machine.
    with atomic.temporary_in(path.parent, path.name) as temporary, duckdb.connect(config={"threads": 1}) as connection:
        values = [[getattr(row, column.name) for row in ordered] for column in COLUMNS]
        connection.execute(f"CREATE TABLE results AS SELECT {columns}", values)
        where = str(temporary.absolute()).replace("'", "''")
        seal = f"{{'{sealed.KEY}': '{sealed.BLANK}'}}"
        connection.execute(f"COPY results TO '{where}' (FORMAT parquet, COMPRESSION zstd, KV_METADATA {seal})")
        atomic.write_bytes(path, sealed.fill_in(temporary.read_bytes()))
    return path


def open_results(path: Path, connection: duckdb.DuckDBPyConnection) -> duckdb.DuckDBPyRelation:
    """Return the rows of a file as a relation, after a look at its seal.

    Raises
    ------
    UserError
        There is no such file, or it is no regular one.
    DamagedFileError
        The file is not what was written, or not readable as Parquet.
    """
    data = files.read_bytes(path, largest=LARGEST_TABLE, expected="results.parquet of a run")
    try:
        sealed.check(data, path)
    except DamagedFileError as error:
        raise type(error)(error.what, where=str(path), fix="make the run again") from None
    try:
        return connection.read_parquet(_literal(path), hive_partitioning=False)
    except duckdb.Error as error:
        raise _unreadable(error, path) from error


def _literal(path: Path) -> str:
    """Return a path as DuckDB takes it for itself and not for a pattern."""
    text = path.absolute().as_posix()
    if "\\" in text and _PATTERN.search(text):
        raise UserError(
            "a path with a backslash and one of *?[ cannot be opened as a table",
            where=str(path),
            fix="give the folder another name",
        )
    return _PATTERN.sub(r"[\g<0>]", text)


def _unreadable(error: duckdb.Error, path: Path) -> DamagedFileError:
    return DamagedFileError(f"cannot be read as Parquet ({str(error).splitlines()[0]})", where=str(path))


def read_results(path: Path) -> list[Row]:
    """Read rows back, in the stored order.

    Raises
    ------
    UserError
        There is no such file, or its columns are not ours.
    DamagedFileError
        The file is not what was written, or not readable as Parquet.
    """
    with duckdb.connect(config={"threads": 1}) as connection:
        relation = open_results(path, connection)
        try:
            names, records = relation.columns, relation.fetchall()
        except duckdb.Error as error:
            raise _unreadable(error, path) from error
    # A table from before a column existed has none of it; all others must be ours, in our order.
    known = [column.name for column in COLUMNS if column.name in names or not column.optional]
    if [name for name in names if name not in RETIRED] != known:
        different = sorted(set(names) ^ set(known))
        raise UserError(
            f"columns differ: {different or 'order'}",
            where=str(path),
            expected="the columns of this version",
            fix="make the run again",
        )
    try:
        return [
            Row.from_dict({name: value for name, value in zip(names, record, strict=True) if name not in RETIRED})
            for record in records
        ]
    except ValueError as error:
        raise DamagedFileError(f"not a row of results ({error})", where=str(path)) from error
