"""Render one frame of a scene: radiance per band, truth maps, and the exact truth beside them."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from horizonval.frame import RadianceFrame
from horizonval.renderer.description import describe
from horizonval.renderer.frame_cost import refuse_too_large, shared_view, viewpoint_key
from horizonval.renderer.table_store import TABLES
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

if TYPE_CHECKING:
    from horizonval.core.progress import Progress
    from horizonval.renderer.viewpoint import Viewpoint

_last: dict[str, Viewpoint] = {}
"""The viewpoint of a campaign's frame before, by its key."""
_place: dict[str, str] = {}
"""Whose tables are in memory."""


def render_frame(scene: SceneSpec, camera: CameraSpec, progress: Progress | None = None) -> RadianceFrame:
    """Return the frame a scene's camera sees: the same bytes for any number of threads.

    Raises
    ------
    UserError
        Anything in the scene or camera that cannot be rendered (bands outside the tables, a camera below the
        ground), a frame that does not fit into memory, or no back-end that works here.
    """
    return viewpoint_of(scene, camera, progress).frame(scene)


def render_in_turn(scene: SceneSpec, camera: CameraSpec, *, maps: bool = True) -> RadianceFrame:
    """Return the same bytes as :func:`render_frame`, and keep the viewpoint for the next frame.

    For campaigns, whose files do not change while they run. ``maps``: False leaves out the truth maps, which a detector
    does not need.
    """
    refuse_too_large(scene, camera)
    key, place = viewpoint_key(scene, camera), shared_view(scene, camera)
    if key not in _last:
        # What was before goes first: memory need not hold both. Frames of one place come one after another.
        _last.clear()
        if place != _place.get("tables"):
            TABLES.clear()
            _flush_allocator()
        _place["tables"] = place
        _last[key] = viewpoint_of(scene, camera)
    return _last[key].frame(scene, maps=maps)


def _flush_allocator() -> None:
    """Give back memory that Dr.Jit keeps for arrays of the sizes that it had."""
    drjit = sys.modules.get("drjit")
    if drjit is not None:
        drjit.flush_malloc_cache()


def viewpoint_of(scene: SceneSpec, camera: CameraSpec, progress: Progress | None = None) -> Viewpoint:
    """Return the place of a scene, from which frames of any attitude are rendered; arguments and errors as above."""
    refuse_too_large(scene, camera)
    described = describe(scene, camera)
    # Nothing that imports Mitsuba is loaded before its back-end is chosen.
    from horizonval.renderer.viewpoint import Viewpoint

    return Viewpoint(scene, camera, described, progress)
