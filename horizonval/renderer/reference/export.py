"""Scenes as files that a Mitsuba user opens: the deterministic frame, and the same scene in stock plugins."""

from __future__ import annotations

from pathlib import Path

from horizonval.core import atomic
from horizonval.renderer.reference.reference import HOLDS, LEAVES_OUT, placement
from horizonval.renderer.scene.description import Described, describe
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

SCENE, REFERENCE, README = "scene.xml", "reference.xml", "README.txt"
LOAD = (
    "from horizonval.renderer.plugin.backend import activate; activate(); import mitsuba as mi; "
    f"image = mi.render(mi.load_file('{SCENE}'))"
)
"""Python that renders the exported deterministic scene."""


def export_scene(scene: SceneSpec, camera: CameraSpec, folder: Path) -> list[Path]:
    """Write ``scene.xml``, ``README.txt`` and, where a band is solar, ``reference.xml`` with its grids.

    Parameters
    ----------
    folder : Path
        Made if need be; files of these names are replaced.

    Returns
    -------
    list of Path
        Everything written.

    Raises
    ------
    UserError
        As :func:`horizonval.renderer.scene.frame.render_frame`.
    """
    described = describe(scene, camera)
    from horizonval.renderer.plugin.scene_text import camera_properties, limb_properties
    from horizonval.renderer.reference.scene_xml import scene_xml

    folder.mkdir(exist_ok=True)
    bands = ", ".join(described.model.bands)
    needs = "needs horizonval and the data files of the scene"
    about = f'{SCENE} ({needs}): python -c "{LOAD}" gives radiance [W m-2 sr-1] of band {bands}.'
    head = f"horizonval scene {scene.scene.name}: deterministic limb march; W m-2 sr-1; bands {bands}"
    plugins = {"integrator": limb_properties(scene, camera), "sensor": camera_properties(described.sensor)}
    atomic.write_text(folder / SCENE, scene_xml({"type": "scene", **plugins}, head))
    reference = _write_reference(scene, described, folder)
    atomic.write_text(folder / README, f"{about}\n{reference}\n")
    return sorted(folder.iterdir())


def _write_reference(scene: SceneSpec, described: Described, folder: Path) -> str:
    """Write the stock scene of the first solar band's heaviest node; return the line that says what it is."""
    from horizonval.renderer.reference import reference_scene as stock
    from horizonval.renderer.reference.grid_volume import grid_volumes, seen_air
    from horizonval.renderer.reference.scene_xml import scene_xml

    solar = [node for node in described.model.nodes if node.solar_irradiance > 0.0]
    if not solar:
        return f"No {REFERENCE}: the camera has thermal bands only, and stock media do not glow."
    node = max((n for n in solar if n.band == solar[0].band), key=lambda n: n.weight)
    place = placement(described)
    box = seen_air(described.model, place, described.camera, node.extinction_per_m)
    air = "no air in view"
    if box is not None:
        x, y, z = (f"{v * 1e-3:.2g}" for v in box.spacing_m)
        air = f"air on a grid of {x} x {y} x {z} km around what the camera sees, up to {box.top_m * 1e-3:.0f} km"
        volume = grid_volumes(described.model, node, place, box, folder)
    else:
        volume = stock.shell_volumes(described.model, place)
    sensor = stock.perspective(described.camera, place)
    orders = 1 if scene.render.orders == "single" else None
    data = stock.reference_scene(described.model, node, place, sensor, volume, orders)
    data["sun"]["irradiance"]["value"] = node.solar_irradiance
    lens = "" if stock.is_stock(described.camera) else "; undistorted pinhole of the same fx, not the camera's own lens"
    about = (
        f"by Monte Carlo in stock Mitsuba 3, at {node.wavelength_um:.4g} um alone [W m-2 sr-1 um-1]: {HOLDS}; "
        f"without {LEAVES_OUT}; {air}{lens}; kilometres, origin on the ground below the camera"
    )
    atomic.write_text(folder / REFERENCE, scene_xml(data, f"horizonval scene {scene.scene.name} {about}"))
    return f"{REFERENCE} (mitsuba -m llvm_ad_mono {REFERENCE}): {about}."
