"""What the limb of every frame of a study allows: rendered, seen by the expected detector, and no estimator run."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from horizonval.core.code import code_digest
from horizonval.jobs.engine import Recorded
from horizonval.jobs.progress import Stopwatch
from horizonval.renderer.scene.frame import render_in_turn
from horizonval.renderer.scene.shared_view import shared_view
from horizonval.scoring.bound import bound_of
from horizonval.scoring.expected import expected_outcome
from horizonval.scoring.information import information_of
from horizonval.spec.load import Case
from horizonval.suites.identity import frame_identity

CODE = ("horizonval.scoring.bound", "horizonval.scoring.expected", "horizonval.scoring.information")
"""What makes a record, beside the frame."""


class InformationWork(Recorded[Case]):
    """Cases of a study's suite, into a folder of one record each."""

    def __init__(self, folder: Path) -> None:
        self.folder: Path | None = folder
        self.records = folder

    def name(self, item: Case) -> str:
        """Return the name of the case."""
        return item.name

    def group(self, item: Case) -> str:
        """Return what says whose tables of light a case shares."""
        return shared_view(item.scene, item.camera)

    def path(self, item: Case) -> Path:
        """Return the file of the case."""
        return self.records / f"{item.name}.json"

    def identity(self, item: Case) -> str:
        """Return the digest of the frame's identity and of the code that weighs it."""
        return hashlib.sha256(f"{frame_identity(item)} {code_digest(*CODE)}".encode()).hexdigest()

    def record(self, item: Case, watch: Stopwatch) -> dict[str, Any]:
        """Render a case and return the bounds of its bands, and whether an answer is due."""
        with watch.stage("render"):
            frame = render_in_turn(item.scene, item.camera)
        bands = {}
        with watch.stage("bound"):
            for band in item.camera.band:
                bound = bound_of(information_of(frame, item.camera, band.name), frame.truth, band.name)
                bands[band.name] = {
                    "noise_arcsec": bound.noise_arcsec,
                    "bound_arcsec": bound.known_arcsec,
                    "altitude_m": bound.altitude_m,
                    "expected": str(expected_outcome(frame.truth, band.name).outcome),
                }
        return {"case": item.name, "bands": bands}
