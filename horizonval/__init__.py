"""Physically based rendering validation of Earth horizon sensors.

::

    import horizonval as hv

    camera = hv.Camera.from_file("mycam.toml")  # or a shipped name
    scene = hv.Scene(camera=camera, altitude_km=550, latitude_deg=10, epoch_utc="2026-03-20T12:00Z")
    print(hv.check(scene))
    frame = hv.render(scene)
    image = frame.observe(seed=1)
    fit = hv.estimate(image, "guarded-altitude-free")
    print(hv.score(fit, frame).nadir_error_deg)
    run = hv.run("orbit.toml", out="out")

Importing the package loads nothing but this file: each name loads what it needs when it is first used, and the renderer
comes with the first frame.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from horizonval.core.environment import name_library

if TYPE_CHECKING:
    from horizonval.api.camera import Camera
    from horizonval.api.check import check
    from horizonval.api.client import Client
    from horizonval.api.derivatives import FrameDerivatives
    from horizonval.api.estimate import estimate, score
    from horizonval.api.frame import Frame, open_frame, render, render_reference
    from horizonval.api.image import Image, observe, open_image
    from horizonval.api.info import list_cameras, list_estimators, list_scenes, list_suites
    from horizonval.api.locate import Located, locate
    from horizonval.api.run import Run, open_run, run
    from horizonval.api.scene import Scene
    from horizonval.api.session import Session
    from horizonval.core.errors import UserError
    from horizonval.core.outcome import Outcome, Refusal
    from horizonval.estimation.methods.ideal import horizon_sensor
    from horizonval.estimation.observation import Estimator, Fit, Observation
    from horizonval.estimation.prior import Prior
    from horizonval.scoring.row import Score
    from horizonval.sensor.conical_scanner import ConicalScanner
    from horizonval.sensor.quadrant import QuadrantSensor

__version__ = "0.1.0"

__all__ = [
    "Camera",
    "Client",
    "ConicalScanner",
    "Estimator",
    "Fit",
    "Frame",
    "FrameDerivatives",
    "Image",
    "Located",
    "Observation",
    "Outcome",
    "Prior",
    "QuadrantSensor",
    "Refusal",
    "Run",
    "Scene",
    "Score",
    "Session",
    "UserError",
    "__version__",
    "check",
    "estimate",
    "horizon_sensor",
    "list_cameras",
    "list_estimators",
    "list_scenes",
    "list_suites",
    "locate",
    "observe",
    "open_frame",
    "open_image",
    "open_run",
    "render",
    "render_reference",
    "run",
    "score",
]

_HOMES = {
    "api.camera": ("Camera",),
    "api.check": ("check",),
    "api.client": ("Client",),
    "api.derivatives": ("FrameDerivatives",),
    "api.estimate": ("estimate", "score"),
    "api.frame": ("Frame", "open_frame", "render", "render_reference"),
    "api.image": ("Image", "observe", "open_image"),
    "api.info": ("list_cameras", "list_estimators", "list_scenes", "list_suites"),
    "api.locate": ("Located", "locate"),
    "api.run": ("Run", "open_run", "run"),
    "api.scene": ("Scene",),
    "api.session": ("Session",),
    "core.errors": ("UserError",),
    "core.outcome": ("Outcome", "Refusal"),
    "estimation.methods.ideal": ("horizon_sensor",),
    "estimation.observation": ("Estimator", "Fit", "Observation"),
    "estimation.prior": ("Prior",),
    "scoring.row": ("Score",),
    "sensor.conical_scanner": ("ConicalScanner",),
    "sensor.quadrant": ("QuadrantSensor",),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}

# Whoever imports Dr.Jit after this package gets the library that works; see the module.
name_library()


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'horizonval' has no attribute {name!r}")
    value = getattr(import_module(f"horizonval.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
