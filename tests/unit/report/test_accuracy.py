"""The report says how far the rendered light can be trusted, for what the frames hold and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from horizonval.frame import FrameTruth
from horizonval.report import accuracy


def _truth(make_truth: Callable[..., FrameTruth], **atmosphere: Any) -> FrameTruth:
    truth = make_truth()
    air = {"profile": "us_standard", "file": None, "aerosol": "none", "refraction": False} | atmosphere
    return replace(truth, scene={**truth.scene, "atmosphere": air}, sun_visible_fraction=1.0)


def test_only_what_is_there_is_spoken_of(make_truth: Callable[..., FrameTruth]) -> None:
    assert accuracy.accuracy_of([]) == []
    assert accuracy.accuracy_of([_truth(make_truth)]) == [accuracy.SUNLIGHT]
    assert accuracy.accuracy_of([_truth(make_truth, profile="none")]) == []
    hazy = _truth(make_truth, aerosol="background")
    assert accuracy.accuracy_of([_truth(make_truth), hazy]) == [accuracy.SUNLIGHT, accuracy.PARTICLES]
    bent = replace(_truth(make_truth), sun_visible_fraction=0.0, horizon_rise_m=1770.0)
    assert accuracy.accuracy_of([bent]) == [accuracy.SUNLIGHT, accuracy.REFRACTION, accuracy.NIGHT]
    infrared = replace(hazy, camera={**hazy.camera, "band": [{"kind": "thermal"}]})
    assert accuracy.accuracy_of([infrared]) == []
