"""Networks in ONNX files: the contract is kept to the letter, and what breaks it is refused in one line."""

from __future__ import annotations

import numpy as np
import pytest

import horizonval as hv
from horizonval import cli
from horizonval.core.errors import UserError
from horizonval.geometry.camera import CameraModel
from horizonval.plugins.onnx_model import model_estimator

onnx = pytest.importorskip("onnx", reason="writes models")
pytest.importorskip("onnxruntime", reason="runs models: pip install 'horizonval[onnx]'")
from onnx import TensorProto, helper  # noqa: E402

CAMERA = CameraModel(8, 6, 10.0, 11.0, 3.5, 2.5, (0.1, 0.0, 0.0, 0.0, 0.0))
IMAGE = np.arange(48.0).reshape(6, 8)


def model(
    path, *, covariance=(1, 3, 3), claim=1.0, size=(6, 8), leave_out="", camera=False, image_type=TensorProto.FLOAT
):
    """The mean of the image over full scale as x, fx of the camera (or 1) as z; a constant covariance and claim."""
    values = np.zeros(covariance, np.float32)
    values[0] = 1e-6 * np.diag(np.arange(1, covariance[-1] + 1))
    nodes = [
        helper.make_node("ReduceMean", ["image", "axes"], ["mean"], keepdims=0),
        helper.make_node("Reshape", ["mean", "one"], ["x"]),
        helper.make_node("Slice", ["camera", "zero", "unit", "second"], ["z"])
        if camera
        else helper.make_node("Identity", ["ones"], ["z"]),
        helper.make_node("Concat", ["x", "nought", "z"], ["nadir_cam"], axis=1),
        helper.make_node("Identity", ["matrix"], ["covariance"]),
        helper.make_node("Identity", ["flag"], ["claim"]),
    ]
    constants = {
        "axes": np.array([1, 2, 3]), "one": np.array([1, 1]), "ones": np.ones((1, 1), np.float32),
        "nought": np.zeros((1, 1), np.float32), "matrix": values, "flag": np.array([claim], np.float32),
        "zero": np.array([0]), "unit": np.array([1]), "second": np.array([1]),
    }  # fmt: skip
    inputs = [helper.make_tensor_value_info("image", image_type, [1, 1, *size])]
    if camera:
        inputs.append(helper.make_tensor_value_info("camera", TensorProto.FLOAT, [1, 9]))
    shapes = {"nadir_cam": [1, 3], "covariance": covariance, "claim": [1]}
    outputs = [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in shapes.items() if n != leave_out]
    graph = helper.make_graph(
        nodes, "g", inputs, outputs, [onnx.numpy_helper.from_array(v, n) for n, v in constants.items()]
    )
    built = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    path.write_bytes(built.SerializeToString())
    return path


def asked(path, **known):
    observation = hv.Observation(image=IMAGE, camera=CAMERA, full_scale=100.0, **known)
    return model_estimator(path).run(observation)


def test_image_and_camera_come_as_is_said(tmp_path):
    fit = asked(model(tmp_path / "a.onnx", camera=True))
    wanted = np.array([IMAGE.mean() / 100.0, 0.0, 10.0])
    assert np.allclose(fit.nadir_cam, wanted / np.linalg.norm(wanted), atol=1e-7)
    assert np.allclose(fit.covariance_nadir_cam, 1e-6 * np.diag([1.0, 2.0, 3.0]))
    assert fit.pitch_rad == pytest.approx(-np.arctan2(wanted[0], wanted[2]), abs=1e-7)


def test_a_covariance_across_the_nadir_is_turned_into_camera_axes(tmp_path):
    fit = asked(model(tmp_path / "a.onnx", covariance=(1, 2, 2)))
    n = fit.nadir_cam
    # The nadir has no y at all, so that h is y: e1 = y x n, e2 = n x e1 = y.
    e1, e2 = np.cross([0.0, 1.0, 0.0], n), np.array([0.0, 1.0, 0.0])
    assert np.allclose(fit.covariance_nadir_cam, 1e-6 * (np.outer(e1, e1) + 2.0 * np.outer(e2, e2)), atol=1e-12)


def test_no_claim_and_other_images_are_refusals(tmp_path):
    assert asked(model(tmp_path / "a.onnx", claim=0.4)).status == "not_converged"
    other = asked(model(tmp_path / "b.onnx", size=(6, 9)))
    assert (other.status, other.reason) == ("bad_input", "the model takes 9 x 6 pixels, the image has 8 x 6")
    assert asked(model(tmp_path / "c.onnx", size=("h", "w"))).status == "valid"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"leave_out": "covariance"}, "has no output 'covariance'"),
        ({"covariance": (1, 4, 4)}, "its output 'covariance' is a tensor(float) of shape (1, 4, 4)"),
        ({"size": (6,)}, "its input 'image' is a tensor(float) of shape (1, 1, 6)"),
        (None, "cannot be read as an ONNX model"),
    ],
)
def test_wrong_models_are_refused_in_one_line(change, told, tmp_path, capsys):
    path = tmp_path / "wrong.onnx"
    if change is None:
        path.write_bytes(b"no model")
    elif change.get("size") == (6,):
        # Rank three: no mean over four axes.
        graph = helper.make_graph(
            [helper.make_node("Identity", ["image"], ["nadir_cam"])],
            "g",
            [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 1, 6])],
            [helper.make_tensor_value_info("nadir_cam", TensorProto.FLOAT, [1, 1, 6])],
        )
        path.write_bytes(
            helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9).SerializeToString()
        )
    else:
        model(path, **change)
    with pytest.raises(UserError) as error:
        model_estimator(path)
    assert told in str(error.value)
    assert str(path) in str(error.value)
    assert cli.run_command_line(["estimate", "image.png", "--estimator", str(path)]) == 2
    said = capsys.readouterr().err.strip()
    assert told in said
    assert "\n" not in said


def test_without_the_extra_it_says_what_to_install(tmp_path, monkeypatch):
    path = model(tmp_path / "a.onnx")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"horizonval\[onnx\]"):
        model_estimator(path)


def test_a_model_is_an_estimator_by_its_file(tmp_path):
    path = model(tmp_path / "a.onnx")
    camera = {"camera": {"width": 8, "height": 6, "fx": 10.0, "fy": 11.0}}
    fit = hv.estimate(IMAGE.astype(np.uint8), str(path), camera=camera)
    assert fit.status == "valid"
    with pytest.raises(UserError, match="no such file"):
        hv.estimate(IMAGE.astype(np.uint8), "none.onnx", camera=camera)
