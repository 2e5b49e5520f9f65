"""The cost model counts what the renderer works on."""

from __future__ import annotations

import pytest

from horizonval.api.check.cost import frame_cost, marched_cells
from horizonval.api.check.frames import Group, look_at, total_cost
from horizonval.earth.atmosphere.air import TOP_M
from horizonval.earth.optical import node_counts, optical_model
from horizonval.renderer.frame import render_frame
from horizonval.sensor.observe import observe
from horizonval.spec.load import Case, load_scene
from horizonval.store.store import Store
from horizonval.truth.frame_truth import truth_of


def loaded(name, **changes):
    scene, camera = load_scene(name)
    scene = scene.model_copy(update={"render": scene.render.model_copy(update=changes)})
    return scene, camera


@pytest.mark.parametrize("name", ["limb-noon-vis", "sun-behind-limb"])
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


@pytest.mark.parametrize(("method", "tables"), [("table", True), ("march", False)])
def test_frames_from_one_place_share_its_view_tables(method, tables):
    """Turned cameras cost the tables once, and each its own looks; without tables every frame costs its march."""
    scene, camera = loaded("limb-noon-vis", method=method)

    def total(*rolls_deg):
        attitudes = [scene.attitude.model_copy(update={"roll_deg": roll}) for roll in rolls_deg]
        group = Group("camera", tuple(Case(scene.model_copy(update={"attitude": a}), camera) for a in attitudes))
        return total_cost([group], [look_at(group, 9, {}, infrared=False)], "none").render_s

    alone, both = total(scene.attitude.roll_deg), total(scene.attitude.roll_deg, scene.attitude.roll_deg + 1e-6)
    cost = frame_cost(truth_of(scene, camera), scene, camera, node_counts(optical_model(scene, camera)), 1)
    assert alone == pytest.approx(cost.render_s + cost.view_tables_s, rel=1e-3)
    assert both == pytest.approx(2 * cost.render_s + cost.view_tables_s, rel=1e-3)
    assert bool(cost.view_tables_s) == tables
