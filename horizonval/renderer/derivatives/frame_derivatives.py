"""All derivatives of a frame, from its scene and camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from horizonval.core.errors import UserError
from horizonval.core.progress import Progress
from horizonval.earth.atmosphere.air import NO_ATMOSPHERE
from horizonval.renderer.derivatives.parameters import AIR_STEPS, GAIN, POSE, changed_air
from horizonval.renderer.derivatives.whole_frames import Images, central_difference, radiance_images
from horizonval.renderer.scene.description import Described, describe
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec


def frame_derivatives(
    scene: SceneSpec, camera: CameraSpec, parameters: Sequence[str], progress: Progress | None = None
) -> tuple[dict[str, Images], tuple[str, ...]]:
    """Return the derivative of every band by the parameters, and what the frame has whose derivative is left out.

    Pose comes from the chain rule (:mod:`horizonval.renderer.derivatives.pose`), the air from central differences of
    whole frames with the steps :data:`~horizonval.renderer.derivatives.parameters.AIR_STEPS`.

    Parameters
    ----------
    scene : SceneSpec
    camera : CameraSpec
    parameters : sequence of str
        Of :data:`~horizonval.renderer.derivatives.parameters.PARAMETERS`.
    progress : Progress, optional
        Told about tables that take long.

    Raises
    ------
    UserError
        For a scene with parts, whose light would change too; else as
        :func:`horizonval.renderer.scene.frame.render_frame`.
    """
    if scene.part:
        raise UserError(
            "derivatives of frames with parts of the spacecraft in view are not known",
            where="part",
            expected="a scene without [[part]]",
        )
    described = describe(scene, camera)
    out: dict[str, Images] = {}
    left_out: tuple[str, ...] = ()
    if any(p in POSE for p in parameters):
        pose, left_out = _pose(described, progress)
        out |= {p: pose[p] for p in parameters if p in POSE}
    if GAIN in parameters:
        out[GAIN] = _images(described, progress)
    for parameter in parameters:
        if parameter not in AIR_STEPS:
            continue
        if _changes_nothing(scene, parameter):
            shape = described.camera.height, described.camera.width
            out[parameter] = {band: np.zeros(shape) for band in described.model.bands}
            continue

        def images_at(step: float, parameter: str = parameter) -> Images:
            return _images(describe(scene, camera, changed_air(parameter, step)), progress)

        out[parameter] = central_difference(images_at, AIR_STEPS[parameter])
    return {p: out[p] for p in parameters}, left_out


def _pose(described: Described, progress: Progress | None) -> tuple[dict[str, Images], tuple[str, ...]]:
    from horizonval.renderer.derivatives.pose import PoseFrame
    from horizonval.renderer.plugin.integrator import prepare
    from horizonval.renderer.plugin.plugins import mitsuba_scene

    prepare(described.limb, progress)
    integrator = mitsuba_scene(described.limb, described.sensor).integrator()
    return PoseFrame.of(integrator, described.sensor, described.truth.ellipsoid).derivatives()


def _images(described: Described, progress: Progress | None) -> Images:
    from horizonval.renderer.plugin.integrator import prepare

    prepare(described.limb, progress)
    return radiance_images(described.limb, described.sensor)


def _changes_nothing(scene: SceneSpec, parameter: str) -> bool:
    atmosphere = scene.atmosphere
    if atmosphere.file is not None:
        return False
    if atmosphere.profile_file is None and atmosphere.profile == NO_ATMOSPHERE:
        return True
    return parameter == "aerosol" and atmosphere.aerosol == "none"
