"""How far the light in a run's frames can be trusted: the renderer's tested accuracy, for what the scenes hold."""

from __future__ import annotations

from collections.abc import Iterable

from horizonval.frame import FrameTruth

SUNLIGHT = (
    "Scattered sunlight: radiance within 1 % of independent Monte Carlo, from a high Sun to one 18° below the horizon, "
    "molecules and ozone; tables of multiple scattering read over the ellipsoid add less than 0.5 %."
)
PARTICLES = (
    "Particles: 1 % by day (1.5 % in dense layers with sharp edges), 1 % until the Sun is 2° below the horizon; 5 % in "
    "dark rays until 12°, after an eruption 8 %."
)
REFRACTION = (
    "Refraction: single rays 0.1 % for light scattered once; frames of 128 nodes 0.5 % in bright pixels with the Sun "
    "up, 0.9 % in twilight, 4 % in pixels a thousand times darker; light scattered more than once is not refracted."
)
NIGHT = "Airglow is known to a factor of two, the Moon's brightness to 3 %."


def accuracy_of(truths: Iterable[FrameTruth]) -> list[str]:
    """Return sentences for what the frames hold; none for frames without scattered sunlight."""
    solar = [t for t in truths if any(band["kind"] == "solar" for band in t.camera.get("band", []))]
    # frames of other versions may say less
    airs = [{"profile": "none", "file": None} | t.scene.get("atmosphere", {}) for t in solar]
    sentences = []
    if any(air["profile"] != "none" or air["file"] is not None for air in airs):
        sentences.append(SUNLIGHT)
    if any(air.get("aerosol", "none") != "none" or air["file"] is not None for air in airs):
        sentences.append(PARTICLES)
    if any(t.horizon_rise_m > 0.0 or air.get("refraction") for t, air in zip(solar, airs, strict=True)):
        sentences.append(REFRACTION)
    if any(t.sun_visible_fraction == 0.0 for t in solar):
        sentences.append(NIGHT)
    return sentences
