"""Named random streams: every stage of every image draws from its own.

A stream is seeded with the sha256 of what it belongs to (scene, camera, band, stage, replicate). Neighbouring seeds
share nothing, and a stage that is switched off or draws more numbers does not shift another's.

Scenes that say ``scene.draw`` share the streams of that name, of the same seed and head: what is then drawn for an
array of the same size is the same, however the scenes differ.
"""

from __future__ import annotations

import hashlib
import json

import numpy as np

from horizonval.frame import FrameTruth


def noise_identity(truth: FrameTruth) -> str:
    """Return the identity that the noise of a frame is drawn under: the scene's own, or that of its ``draw``."""
    scene = truth.scene.get("scene", {})
    if scene.get("draw") is None:
        return truth.scene_id
    return hashlib.sha256(json.dumps(["draw", scene["draw"], scene.get("seed"), truth.head]).encode()).hexdigest()


def stream(scene_id: str, camera: str, band: str, stage: str, seed: int) -> np.random.Generator:
    """Return the generator of one stage; equal arguments give equal numbers on every machine."""
    # JSON keeps the parts apart: ("ab", "c") and ("a", "bc") must differ.
    identity = json.dumps([scene_id, camera, band, stage, seed])
    digest = hashlib.sha256(identity.encode()).digest()
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(int.from_bytes(digest, "big"))))
