"""The verdict as JUnit XML, which CI services show: a test case for every gate, anchor and published figure, and one
for completeness.

FAIL is a failure. INCONCLUSIVE is ``skipped`` with its reason: neither passed nor failed, and shown as neither.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from horizonval.studies.regression.formatting import anchor_sentence, gate_sentence, published_sentence
from horizonval.studies.regression.statistics.decide import Verdict


def write_junit(path: Path, verdict: Mapping[str, Any]) -> None:
    """Write ``junit.xml``."""
    suites = ElementTree.Element("testsuites")
    name = f"horizonval.regress.{verdict['suite']}"
    suite = ElementTree.SubElement(suites, "testsuite", name=name)
    properties = ElementTree.SubElement(suite, "properties")
    for key, value in (
        ("night", verdict["night"]),
        ("verdict", verdict["verdict"]),
        ("version", verdict["environment"]["version"]),
        ("commit", verdict["environment"]["commit"] or ""),
    ):
        ElementTree.SubElement(properties, "property", name=key, value=str(value))
    for gate in verdict["gates"]:
        _case(suite, f"{name}.{gate['against']}", gate["name"], gate["verdict"], gate_sentence(gate))
    for anchor in verdict["anchors"]:
        _case(suite, f"{name}.anchors", anchor["name"], anchor["verdict"], anchor_sentence(anchor))
    for one in verdict["published"]:
        title = f"{one['system']}: {one['name']}"
        _case(suite, f"{name}.published", title, one["verdict"], published_sentence(one))
    case = ElementTree.SubElement(suite, "testcase", classname=name, name="complete")
    if verdict["problems"]:
        text = "; ".join(verdict["problems"])
        ElementTree.SubElement(case, "error", message=_clean(text[:500]), type="incomplete").text = _clean(text)
    cases = suite.findall("testcase")
    for key, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
        suite.set(key, str(sum(one.find(tag) is not None for one in cases)))
    suite.set("tests", str(len(cases)))
    ElementTree.indent(suites)
    ElementTree.ElementTree(suites).write(path, encoding="utf-8", xml_declaration=True)


def _case(suite: ElementTree.Element, group: str, name: str, verdict: str, text: str) -> None:
    case = ElementTree.SubElement(suite, "testcase", classname=group, name=name)
    text = _clean(text)
    if verdict == Verdict.FAIL:
        ElementTree.SubElement(case, "failure", message=text, type=verdict).text = text
    elif verdict == Verdict.INCONCLUSIVE:
        ElementTree.SubElement(case, "skipped", message=f"INCONCLUSIVE: {text}")
    ElementTree.SubElement(case, "system-out").text = f"{verdict}: {text}"


def _clean(text: str) -> str:
    """Return text without what XML cannot hold."""
    return "".join(c for c in text if c in "\t\n\r" or 0x20 <= ord(c) < 0xFFFE)
