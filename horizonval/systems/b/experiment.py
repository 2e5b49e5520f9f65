"""System B: the local vertical from two perpendicular visible cameras (Belokonov, Lomaka and others).

The two cameras over a rendered Earth: their applicability region and model error, their failures in the shadow and
under the Sun, and their claim to be as good as an infrared sensor. The test bench is in
:mod:`horizonval.systems.b.rig`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from horizonval.systems.b.pair import figures
from horizonval.systems.b.pair.applicability import applicability, earth_table, ends_table, region_rows, region_summary
from horizonval.systems.b.pair.frames import ALTITUDE_KM, FIELD_DEG, pair
from horizonval.systems.b.pair.orbit import lap, orbit_rows, orbit_table, verdict
from horizonval.systems.b.pair.sun import height_table, sun_claim, sun_in_frame, sun_rows, sun_table
from horizonval.systems.b.rig import figures as rig_pictures
from horizonval.systems.b.rig.experiment import (
    film_rows,
    measure_rig,
    rig_figures,
    rig_rows,
    rig_summary,
    rig_view,
)
from horizonval.systems.b.rig.film import film
from horizonval.systems.b.rig.runs import ablation_table, sensitivity_table
from horizonval.systems.published import page_text, published
from horizonval.systems.result import Claim, ComparisonRow, Reproduction, Status
from horizonval.systems.task_cache import TaskCache

TEXT = page_text("B")
PRINTED = published("B").figures


def claims(
    rows: Sequence[ComparisonRow], summary: dict[str, float], verdict: dict[str, float], sun: Claim
) -> list[Claim]:
    """Return every printed figure and claim, from the rows that decide them, the bench's and the orbit's summary."""

    def row(key: str) -> ComparisonRow:
        begin = TEXT.rows[key].name.partition("{")[0]
        return next(one for one in rows if one.name.startswith(begin))

    def judged(key: str, status: Status, /, **fields: Any) -> Claim:
        return TEXT.claim(key, PRINTED[key].value if key.endswith("rms") else str(PRINTED[key].value), status, **fields)

    mean, single, shadow = row("model"), row("model_single"), row("shadow")
    both = mean.holds and single.holds
    model = Status.REPRODUCED if both else Status.BOUNDED if mean.holds or single.holds else Status.CONTRADICTED
    inside = summary["low"] <= PRINTED["rig_rms"].value <= summary["high"]  # type: ignore[operator]
    comparable = Status.BOUNDED if verdict["comparable"] else Status.CONTRADICTED
    return [
        judged("model_rms", model, mean=mean.measured, single=single.measured),
        judged("rig_rms", Status.BOUNDED if inside else Status.CONTRADICTED, **summary),
        judged("region", Status.NOT_DETERMINABLE, half_side=row("region").measured),
        judged("shadow", Status.REPRODUCED if shadow.holds else Status.CONTRADICTED, share=shadow.measured),
        sun,
        judged("infrared", comparable, **verdict),
    ]


def reproduce(cache: TaskCache) -> Reproduction:
    """Do the published experiments again, and return them beside the published figures."""
    region = applicability(cache)
    orbit = lap(cache)
    suns = sun_in_frame(cache)
    rig, picture = measure_rig(cache)
    view = rig_view(cache, picture)
    shown = film(cache, picture)
    summary = rig_summary(rig, cache.rng("plausible benches"))
    of_sun = sun_rows(suns)
    rows = (
        *region_rows(region),
        *orbit_rows(orbit),
        *of_sun,
        *rig_rows(rig, cache.rng("plausible benches")),
        *film_rows(shown),
    )
    maps: dict[str, Any] = {f"{FIELD_DEG:g} deg": region.model, "60 deg": region.shipped}
    return TEXT.reproduction(
        rows=rows,
        claims=claims(rows, summary, verdict(orbit), sun_claim(of_sun, suns)),
        tables=(
            ends_table(region.model),
            earth_table(region),
            orbit_table(orbit),
            sun_table(suns, cache.rng("twins")),
            height_table(suns),
            ablation_table(rig),
            sensitivity_table(rig.whole),
        ),
        figures=(
            TEXT.figure("map", partial(figures.maps, maps), altitude_km=ALTITUDE_KM, field_deg=FIELD_DEG),
            TEXT.figure("map-earth", partial(figures.maps, dict(region.coarse))),
            TEXT.figure("orbit", partial(figures.orbit, orbit)),
            TEXT.figure("sun", partial(figures.sun, suns)),
            *rig_figures(rig, view),
            TEXT.figure("film", partial(rig_pictures.film, shown)),
        ),
        settings={"cameras": pair(), "altitude_km": ALTITUDE_KM},
        region=region_summary(region),
        verdict=verdict(orbit),
        rig=summary,
        published={"model": published("B").number("model_rms"), "rig": published("B").number("rig_rms")},
    )
