"""The cost model counts what the renderer works on."""

from __future__ import annotations

import pytest

from horizonval.earth.atmosphere.air import TOP_M
from horizonval.earth.optical import node_counts, optical_model
from horizonval.precheck.cost import frame_cost, marched_cells
from horizonval.renderer.scene.frame import render_frame
from horizonval.sensor.observe import observe
from horizonval.spec.load import load_scene
from horizonval.store.store import Store
from horizonval.truth.frame_truth import truth_of


def loaded(name, **changes):
    scene, camera = load_scene(name)
    scene = scene.model_copy(update={"render": scene.render.model_copy(update=changes)})
    return scene, camera


@pytest.mark.parametrize("name", ["limb-noon-vis", "day-limb", "sun-behind-limb"])
def test_cells_are_those_whose_rays_meet_the_air(name):
    """By the rendered frame's own map of tangent heights. Within a fiftieth of the image: the grid on which cells are
    counted has 48 lines a side."""
    scene, camera = loaded(name, subsamples=1, nodes=8, orders="single")
    frame = render_frame(scene, camera)
    marched = (frame.maps["tangent_height"] < TOP_M).sum()
    pixels = camera.camera.width * camera.camera.height
    assert marched_cells(frame.truth, camera, 1) == pytest.approx(marched, abs=pixels / 50)
    assert 0.1 * pixels < marched < pixels


def test_time_goes_with_cells_nodes_and_bands():
    scene, camera = loaded("limb-noon-vis")
    truth = truth_of(scene, camera)
    spectral = node_counts(optical_model(scene, camera))
    whole = frame_cost(truth, scene, camera, spectral, 1)
    assert whole.evaluations == pytest.approx(whole.cells * scene.render.nodes * spectral["vis"])
    half, _ = loaded("limb-noon-vis", nodes=scene.render.nodes // 2)
    assert frame_cost(truth, half, camera, spectral, 1).evaluations == pytest.approx(whole.evaluations / 2)
    fine, _ = loaded("limb-noon-vis", subsamples=4)
    assert frame_cost(truth, fine, camera, spectral, 1).cells == pytest.approx(4 * whole.cells)
    single, _ = loaded("limb-noon-vis", orders="single")
    assert frame_cost(truth, single, camera, spectral, 1).tables == 0 < whole.tables


def test_disk_is_that_of_the_archive(tmp_path):
    """Of a rendered frame within 1.5: what compression leaves hangs on what is in the picture."""
    scene, camera = loaded("limb-noon-vis", subsamples=1, nodes=16, orders="single")
    frame = render_frame(scene, camera)
    store = Store(tmp_path)
    stored = [store.path(store.add_frame(frame)), store.path(store.add_image(observe(frame, camera)))]
    cost = frame_cost(frame.truth, scene, camera, {"vis": 4}, 1)
    predicted = cost.frame_bytes + cost.image_bytes
    assert 1 / 1.5 < predicted / sum(path.stat().st_size for path in stored) < 1.5
