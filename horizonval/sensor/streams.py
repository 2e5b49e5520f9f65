"""Named random streams: every stage of every image draws from its own.

A stream is seeded with the sha256 of what it belongs to (scene, camera, band, stage, replicate). Neighbouring seeds
share nothing, and a stage that is switched off or draws more numbers does not shift another's.
"""

from __future__ import annotations

import hashlib
import json

import numpy as np


def stream(scene_id: str, camera: str, band: str, stage: str, seed: int) -> np.random.Generator:
    """Return the generator of one stage; equal arguments give equal numbers on every machine."""
    # JSON keeps the parts apart: ("ab", "c") and ("a", "bc") must differ.
    identity = json.dumps([scene_id, camera, band, stage, seed])
    digest = hashlib.sha256(identity.encode()).digest()
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(int.from_bytes(digest, "big"))))
