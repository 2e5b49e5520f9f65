"""A scene dictionary as Mitsuba's XML.

Mitsuba's own writer (``mi.parser.write_file``, 3.9.1) takes transforms apart and writes a wrong scale for the
ellipsoid, and it does not know plugins written in Python.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from xml.etree import ElementTree

import mitsuba as mi
import numpy as np

from horizonval.renderer.types import PluginDict

VERSION = "3.0.0"
_TAGS = {
    "integrator": ("horizon_limb", "volpath"),
    "sensor": ("horizon_camera", "perspective"),
    "film": ("hdrfilm",),
    "rfilter": ("box",),
    "sampler": ("independent",),
    "medium": ("heterogeneous",),
    "volume": ("gridvolume", "constvolume"),
    "phase": ("rayleigh", "isotropic", "hg", "blendphase"),
    "shape": ("sphere", "shapegroup", "instance"),
    "bsdf": ("diffuse", "null"),
    "emitter": ("directional",),
}
_TAG_OF = {plugin: tag for tag, plugins in _TAGS.items() for plugin in plugins}
_POINTS = ("center",)


def scene_xml(scene: PluginDict, comment: str) -> str:
    """Return the XML document of a scene dictionary that holds the plugins of :mod:`horizonval.renderer` only.

    Parameters
    ----------
    comment : str
        Told at the head of the document.
    """
    root = ElementTree.Element("scene", version=VERSION)
    root.append(ElementTree.Comment(f" {comment.replace('--', '-')} "))
    for name, value in scene.items():
        if name != "type":
            root.append(_element(name, value, named=False))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _element(name: str, value: Any, named: bool = True) -> ElementTree.Element:
    if isinstance(value, dict):
        return _plugin(name, value, named)
    if isinstance(value, mi.ScalarTransform4f):
        transform = ElementTree.Element("transform", name=name)
        transform.append(ElementTree.Element("matrix", value=_numbers(np.array(value.matrix).ravel())))
        return transform
    if isinstance(value, list):
        tag = "point" if name in _POINTS else "vector"
        return ElementTree.Element(tag, name=name, value=_numbers(value))
    # bool is an int to Python, so it comes first
    for kind, tag in ((bool, "boolean"), (int, "integer"), (float, "float"), (str, "string")):
        if isinstance(value, kind):
            text = str(value).lower() if kind is bool else str(value)
            return ElementTree.Element(tag, name=name, value=text)
    raise TypeError(f"{name}: {type(value).__name__} has no XML")


def _plugin(name: str, data: PluginDict, named: bool) -> ElementTree.Element:
    label: dict[str, str] = {"name": name} if named else {}
    kind = data["type"]
    if kind == "ref":
        return ElementTree.Element("ref", label | {"id": data["id"]})
    if kind == "uniform":
        return ElementTree.Element("spectrum", label | {"value": str(data["value"])})
    element = ElementTree.Element(_TAG_OF[kind], label | {"type": kind})
    if "id" in data:
        element.set("id", data["id"])
    for key, value in data.items():
        if key not in ("type", "id"):
            element.append(_element(key, value))
    return element


def _numbers(values: Iterable[float]) -> str:
    return ", ".join(repr(float(v)) for v in values)
