"""A network in an ONNX file as an estimator: what a file must hold, and how it is run on an image.

Inputs, by name:

``image``
    float32, shape (1, 1, height, width): digital numbers over full scale, 0 to 1, rows downwards. Height and width are
    fixed, or symbolic in a model that takes any size.
``camera`` (may be missing)
    float32, shape (1, 9): fx, fy, cx, cy in pixels, then k1, k2, p1, p2, k3.

Outputs, by name, float32 or float64:

``nadir_cam``
    Shape (1, 3): direction to the Earth's centre in camera axes (x right, y down, z forward), of any length.
``covariance``
    rad^2. Shape (1, 3, 3): of the unit vector to the nadir, in camera axes. Shape (1, 2, 2): across the nadir, along
    e1 = h x n / \\|h x n\\| and e2 = n x e1, where n is the nadir and h the camera axis of which n has least.
``claim``
    Shape (1,) or (1, 1): above 0.5 where the model claims the attitude; otherwise the answer is a refusal.

The first axis, of one image, may be symbolic too. A file that is not so is refused before any image is looked at.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from horizonval.core import files
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.geometry.frames import inverse, roll_pitch_of_nadir, rotate
from horizonval.geometry.rotation import tangent_basis

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

SUFFIX = ".onnx"
MAX_BYTES = 1 << 30
Shape = tuple[int | None, ...]
INPUTS: dict[str, Shape] = {"image": (1, 1, None, None), "camera": (1, 9)}
OUTPUTS: dict[str, list[Shape]] = {"nadir_cam": [(1, 3)], "covariance": [(1, 3, 3), (1, 2, 2)], "claim": [(1,), (1, 1)]}
_REAL = ("tensor(float)", "tensor(double)")


def is_model(name: str) -> bool:
    """Whether an estimator's name is that of an ONNX file."""
    return name.lower().endswith(SUFFIX)


def model_estimator(path: str | Path, name: str = "", title: str = "") -> Estimator:
    """Return an ONNX file as an estimator, named after the file by default.

    Raises ``UserError``: no such file, not the expected ONNX model, or onnxruntime is not installed.
    """
    place = Path(path)
    if importlib.util.find_spec("onnxruntime") is None:
        raise UserError("onnxruntime is not installed", where=str(path), fix="pip install 'horizonval[onnx]'")
    files.ensure_file(place, expected="an ONNX model")
    _session(str(place.resolve()))

    def run(observation: Observation) -> Fit | Refusal:
        return _ask(_session(str(place.resolve())), observation)

    return Estimator(name or place.name, title or f"The network {place.name}", run)


@cache
def _session(path: str) -> InferenceSession:
    """Return a checked model that runs on one thread, so that its results do not depend on the number of threads."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    data = files.read_bytes(path, largest=MAX_BYTES, expected="an ONNX model")
    try:
        session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as e:
        # The library has exceptions of many kinds for files that are none, and none in common.
        raise UserError(
            f"cannot be read as an ONNX model ({type(e).__name__})", where=path, expected="an ONNX file"
        ) from e
    _check(path, session)
    return session


def _check(path: str, session: InferenceSession) -> None:
    given = {one.name: one for one in session.get_inputs()}
    for name in given:
        if name not in INPUTS:
            raise UserError(f"has an input {name!r}", where=path, expected=" and ".join(INPUTS))
    if "image" not in given:
        raise UserError("has no input 'image'", where=path, expected="float32 of shape (1, 1, height, width)")
    for name, one in given.items():
        _refuse_shape(path, "input", one, [INPUTS[name]], ("tensor(float)",))
    found = {one.name: one for one in session.get_outputs()}
    for name, shapes in OUTPUTS.items():
        if name not in found:
            raise UserError(f"has no output {name!r}", where=path, expected=f"outputs {', '.join(OUTPUTS)}")
        _refuse_shape(path, "output", found[name], shapes, _REAL)


def _refuse_shape(path: str, kind: str, one: Any, shapes: Sequence[Shape], types: Sequence[str]) -> None:
    """Raise where a tensor's type or shape is none of those that it can be; axes of a symbolic length may be any."""
    shape = tuple(one.shape)
    fits = any(
        len(shape) == len(wanted)
        and all(not isinstance(a, int) or b in (None, a) for a, b in zip(shape, wanted, strict=True))
        for wanted in shapes
    )
    if fits and one.type in types:
        return
    expected = " or ".join(str(wanted).replace("None", "any") for wanted in shapes)
    raise UserError(
        f"its {kind} {one.name!r} is a {one.type} of shape {shape}",
        where=path,
        expected=f"{' or '.join(types)} of shape {expected}",
    )


def _ask(session: InferenceSession, observation: Observation) -> Fit | Refusal:
    height, width = observation.image.shape
    inputs_of = {one.name: one.shape for one in session.get_inputs()}
    size = inputs_of["image"][2:]
    if any(isinstance(a, int) and a != b for a, b in zip(size, (height, width), strict=True)):
        return Refusal(
            Outcome.BAD_INPUT, f"the model takes {size[1]} x {size[0]} pixels, the image has {width} x {height}"
        )
    if observation.full_scale is None:
        return Refusal(Outcome.BAD_INPUT, "the model takes digital numbers over full scale, which the image has not")
    if "camera" in inputs_of and not observation.camera.classic:
        return Refusal(Outcome.BAD_INPUT, "the model takes five coefficients, which cannot state this camera's lens")
    inputs = {"image": (observation.image / observation.full_scale).astype(np.float32)[None, None]}
    if "camera" in inputs_of:
        inputs["camera"] = np.array([_camera_vector(observation)], dtype=np.float32)
    nadir, covariance, claim = (np.asarray(out, dtype=np.float64) for out in session.run(list(OUTPUTS), inputs))
    if not claim.ravel()[0] > 0.5:
        return Refusal(Outcome.NOT_CONVERGED, "the model makes no claim")
    return _fit(nadir.ravel(), covariance, observation)


def _camera_vector(observation: Observation) -> list[float]:
    camera = observation.camera
    distortion = [float(k) for k in camera.distortion][:5]
    return [camera.fx, camera.fy, camera.cx, camera.cy, *distortion, *[0.0] * (5 - len(distortion))]


def _fit(vector: FloatArray, covariance: FloatArray, observation: Observation) -> Fit:
    """Return the claim, unchecked: the registry checks the answers of all estimators."""
    nadir = vector / np.linalg.norm(vector)
    matrix = covariance[0]
    if matrix.shape == (2, 2):
        basis = tangent_basis(nadir)
        matrix = basis @ matrix @ basis.T
    # Float32 leaves halves that differ in their last bits.
    matrix = 0.5 * (matrix + matrix.T)
    roll, pitch = roll_pitch_of_nadir(rotate(inverse(observation.q_cam_from_body), nadir))
    return Fit(nadir_cam=nadir, covariance_nadir_cam=matrix, roll_rad=float(roll), pitch_rad=float(pitch))
