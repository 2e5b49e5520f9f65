"""Masks as COCO has them: one JSON file of pictures and of what is where in them, for programs that learn.

Categories are made of the exact truth maps: ``earth`` (ground or cloud), ``sunlit_earth`` (the part of it on which the
Sun shines), ``limb`` (air without ground behind it). A mask is a run-length code down the columns, uncompressed, which
``pycocotools`` and its relatives read; it marks a crowd (``iscrowd = 1``), as COCO wants of such codes. Pictures are
those of :func:`horizonval.store.export.export_files.export_file` with ``png``.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.frame import Hit, RadianceFrame
from horizonval.store import attributes

CATEGORIES = ("earth", "sunlit_earth", "limb")


def masks_of(frame: RadianceFrame) -> dict[str, NDArray[np.bool_]]:
    """Return the masks of a frame by the names of their categories, shape (H, W) each."""
    earth = attributes.earth_mask(frame.maps) > 0
    return {
        "earth": earth,
        "sunlit_earth": earth & (attributes.sunlit_mask(frame.maps, frame.truth) > 0),
        "limb": frame.maps["hit"] == Hit.ATMOSPHERE,
    }


def coco_text(frames: Sequence[tuple[str, RadianceFrame]]) -> str:
    """Return the JSON file of some frames.

    Parameters
    ----------
    frames : sequence of (str, RadianceFrame)
        Each with the name that its pictures begin with.
    """
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for name, frame in frames:
        marked = masks_of(frame)
        for band in frame.radiance:
            height, width = frame.radiance[band].shape
            number = len(images) + 1
            images.append({"id": number, "file_name": f"{name}-{band}.png", "width": width, "height": height})
            for category, label in enumerate(CATEGORIES, 1):
                mask = marked[label]
                if mask.any():
                    annotations.append(_annotation(len(annotations) + 1, number, category, mask))
    content = {
        "info": {"description": "Masks of the exact truth of rendered frames, by horizonval", "version": "1"},
        "images": images,
        "annotations": annotations,
        "categories": [{"id": k, "name": name, "supercategory": "scene"} for k, name in enumerate(CATEGORIES, 1)],
    }
    return json.dumps(content, separators=(",", ":")) + "\n"


def _annotation(number: int, image: int, category: int, mask: NDArray[np.bool_]) -> dict[str, Any]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    left, top = int(columns[0]), int(rows[0])
    return {
        "id": number,
        "image_id": image,
        "category_id": category,
        "segmentation": {"size": list(mask.shape), "counts": run_lengths(mask)},
        "area": int(mask.sum()),
        "bbox": [left, top, int(columns[-1]) - left + 1, int(rows[-1]) - top + 1],
        "iscrowd": 1,
    }


def run_lengths(mask: NDArray[np.bool_]) -> list[int]:
    """Return how many pixels in turn are outside and inside, down the columns, outside first."""
    flat = mask.ravel(order="F")
    changes = np.flatnonzero(np.diff(flat)) + 1
    lengths = np.diff(np.concatenate([[0], changes, [flat.size]])).tolist()
    return [0, *lengths] if flat[0] else lengths
