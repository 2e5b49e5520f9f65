"""System B: the local vertical from two perpendicular visible cameras (Belokonov, Lomaka and others).

The two cameras over a rendered Earth: their applicability region and model error, their failures in the shadow and
under the Sun, and their claim to be as good as an infrared sensor. The test bench is in
:mod:`horizonval.systems.b.rig`.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from horizonval.estimation.methods.video_vertical import END_PIXELS, PIXEL_SIGMA_PX, ChordEnds
from horizonval.geometry.camera import camera_from_spec
from horizonval.spec.sensor.camera import CameraSpec
from horizonval.systems.b.pair import figures
from horizonval.systems.b.pair.applicability import (
    LIMIT_DEG,
    REGION_DEG,
    Applicability,
    Map,
    applicability,
    rms,
    share_answered,
)
from horizonval.systems.b.pair.frames import ALTITUDE_KM, FIELD_DEG, pair
from horizonval.systems.b.pair.orbit import Lap, lap
from horizonval.systems.b.pair.orbit_report import orbit_rows, orbit_table, verdict
from horizonval.systems.b.pair.sun import sun_in_frame
from horizonval.systems.b.pair.sun_report import sun_rows, sun_table
from horizonval.systems.b.rig.experiment import rig_parts
from horizonval.systems.result import ComparisonRow, Figure, Reproduction, Table
from horizonval.systems.task_cache import TaskCache

PUBLISHED_RMS_DEG = 0.038
SHOWN_SUN_DEG = (30.0, 80.0, 98.0, 109.0, 112.0)


def reproduce(cache: TaskCache) -> Reproduction:
    """Do the published experiments again, and return them beside the published figures."""
    region = applicability(cache)
    orbit = lap(cache)
    suns = sun_in_frame(cache)
    bench_rows, bench_tables, bench_figures, bench_text = rig_parts(cache)
    rows = (*region_rows(region), *orbit_rows(orbit), *sun_rows(suns))
    tables = (readings_table(region.model), earth_table(region), orbit_table(orbit), sun_table(suns))
    drawn = (
        Figure(
            "map",
            "Applicability region: error of the vertical over the tilts of the longitudinal axis, from rendered frames "
            f"of a sphere without air, {ALTITUDE_KM:g} km up. Left, a field of {FIELD_DEG:g} deg; right, the shipped "
            "cameras' 60 deg, which lose the horizon as soon as an attitude presses it below the frame. Small squares "
            "are the attitudes between.",
            partial(figures.maps, {f"{FIELD_DEG:g} deg": region.model, "60 deg": region.shipped}),
        ),
        Figure(
            "map-earth",
            "The same at half the resolution: without air, on the ellipsoid, and with air and a Sun 30 deg off the "
            "zenith.",
            partial(figures.maps, dict(region.coarse)),
        ),
        Figure(
            "orbit",
            "Once round an orbit through the Earth's shadow: error of the vertical of all four sensors in the same "
            "attitudes. Marks below the line are refusals.",
            partial(figures.orbit, orbit),
        ),
        Figure(
            "sun",
            "The Sun in the forward camera's frame (square root of the digital numbers), seen through two lenses, and "
            "the error of what the method claims from these and the other camera's frames.",
            partial(figures.sun, suns, SHOWN_SUN_DEG),
        ),
    )
    return Reproduction(
        system="B",
        title="Video-vertical: the local vertical from two perpendicular cameras",
        source="I. Belokonov, I. Lomaka and others (Samara), about 2015; English version IFAC-PapersOnLine, 2016",
        summary={"text": f"{summary(region, orbit)}\n\n{bench_text}"},
        rows=(*rows, *bench_rows),
        tables=(*tables, *bench_tables),
        figures=(*drawn, *bench_figures),
        settings={"cameras": pair(), "altitude_km": ALTITUDE_KM},
    )


def summary(region: Applicability, orbit: Lap) -> str:
    """Return what was done and what came of it, in a few sentences."""
    inside = region.model.within(REGION_DEG)
    return (
        "Two perpendicular cameras are rendered in every attitude; Canny edges, the longest arc, its circle, its end "
        "points, and the cross product of the two chords give the vertical. With lines of sight to the arc's two end "
        f"pixels the method has an rms error of {rms(region.model.error_deg(ChordEnds.PIXEL.name)[inside]):.3f} deg "
        f"within +-{REGION_DEG:g} deg (published {PUBLISHED_RMS_DEG} deg), which is the rounding of four pixels; with "
        f"the mean of {END_PIXELS} pixels for every end, which is as exact, "
        f"{rms(region.model.error_deg()[inside]):.3f} deg. With the end points on the fitted circle it would be "
        f"{rms(region.model.error_deg(ChordEnds.CIRCLE.name)[inside]):.2f} deg, because the horizon's image is "
        f"a conic, and with chords in the image plane {rms(region.model.error_deg(ChordEnds.PLANE.name)[inside]):.1f} "
        "deg. " + verdict(orbit)
    )


def region_rows(region: Applicability) -> list[ComparisonRow]:
    """Return the rows of the map over a sphere."""
    model = region.model
    inside = model.within(REGION_DEG)
    error = model.error_deg()
    finite = error[inside][np.isfinite(error[inside])]
    camera = camera_from_spec(CameraSpec.model_validate(pair()).camera)
    pixel_deg = float(np.degrees(PIXEL_SIGMA_PX / camera.fx))
    unanswered = np.isnan(error)
    missed = model.horizon_missed()
    cone = rms(model.error_deg("CONE")[inside])
    return [
        ComparisonRow(
            "model RMS inside the applicability region",
            PUBLISHED_RMS_DEG,
            rms(error[inside]),
            "deg",
            f"Every end of an arc is the mean of {END_PIXELS} whole pixels; one cone through all pixels of both arcs "
            f"would have {cone:.4f} deg.",
            limit=PUBLISHED_RMS_DEG,
        ),
        ComparisonRow(
            "model RMS with single end pixels",
            PUBLISHED_RMS_DEG,
            rms(model.error_deg(ChordEnds.PIXEL.name)[inside]),
            "deg",
            f"The published recipe to the letter: the rounding of four pixels, {pixel_deg:.3f} deg each at the image's "
            "middle, makes figures of this size.",
            limit=PUBLISHED_RMS_DEG,
        ),
        ComparisonRow(
            "model RMS of the angle to the longitudinal axis",
            None,
            rms(model.values("tilt_error_deg")[inside]),
            "deg",
            "The system's output is this angle, one of the vertical's two components; the source does not say which of "
            "the two its RMS is.",
        ),
        ComparisonRow(
            "half side of the region answered throughout with error below 1 deg",
            "about 20",
            model.half_side_deg(),
            "deg",
            f"{int(np.sum(unanswered & missed))} of the {int(unanswered.sum())} attitudes of the map without an answer "
            "have no horizon in one of the frames: the field decides the region, not the method.",
            limit=REGION_DEG,
            at_least=True,
        ),
        ComparisonRow(
            "largest error inside the applicability region",
            "< 1",
            float(finite.max()) if len(finite) else 180.0,
            "deg",
            f"Over {len(finite)} attitudes.",
            limit=LIMIT_DEG,
        ),
        ComparisonRow(
            "half side of that region with a field of 60 deg",
            None,
            region.shipped.half_side_deg(),
            "deg",
            "The source does not name its cameras; level boresights with this field see the horizon 8 deg above the "
            "lower edge from 500 km, and lose it beyond.",
        ),
        ComparisonRow(
            "mean normalised error squared inside the region",
            None,
            float(np.nanmean(model.values("nees")[inside])),
            "",
            "An honest covariance has 2.",
        ),
    ]


def readings_table(model: Map) -> Table:
    """Return the table of what the end points are taken to be."""
    inside = model.within(REGION_DEG)
    lines = []
    names = {ends.name: ends.value for ends in ChordEnds} | {"CONE": "(no end points: one cone through all pixels)"}
    for key, text in names.items():
        error = model.error_deg(key)[inside]
        lines.append((text, rms(error), float(np.nanmax(error))))
    return Table(
        "What the vector joins",
        ("end points", "rms [deg]", "largest [deg]"),
        tuple(lines),
        f"Within +-{REGION_DEG:g} deg, on the same frames. The first two are exact for any attitude: unit lines of "
        "sight on a cone about the vertical, and their means, differ by vectors across it. The circle misses the "
        f"arcs' pixels by {rms(model.values('circle_px')[inside]):.1f} px rms, since a sphere's image is a conic.",
    )


def earth_table(region: Applicability) -> Table:
    """Return the table of altitudes, fields and Earths."""
    lines = []
    square = 10.0
    every: dict[str, Map] = {
        f"{FIELD_DEG:g} deg, 1024 px, sphere": region.model,
        "60 deg, 1024 px, sphere": region.shipped,
        **{f"{FIELD_DEG:g} deg, 512 px, {name}": one for name, one in region.coarse.items()},
        **{f"{FIELD_DEG:g} deg, 1024 px, sphere, {km:g} km": one for km, one in region.by_altitude.items()},
    }
    for name, one in every.items():
        reach = min(REGION_DEG, float(np.abs(one.pitch_deg).max()))
        reach = reach if reach > square else square
        error = one.error_deg()[one.within(reach)]
        nees = one.values("nees")[one.within(reach)]
        lines.append(
            (
                name,
                f"+-{reach:g}",
                share_answered(one),
                rms(error),
                rms(one.error_deg("CONE")[one.within(reach)]),
                float(np.nanmean(nees)),
            )
        )
    return Table(
        "Field, altitude and the real Earth",
        ("frames", "square [deg]", "answered (whole map)", "rms [deg]", "rms of one cone [deg]", "NEES"),
        tuple(lines),
        "Errors are those of the square. The method takes the Earth for a sphere: on the ellipsoid its vertical leaves "
        "the geocentric one, which no covariance of pixels covers; NEES is the mean normalised error squared (honest: "
        "2).",
    )
