"""JUnit XML, which CI services read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

from horizonval.core import atomic


@dataclass(frozen=True)
class TestCase:
    """A test case: its group and name, ``outcome``, the verdict's word and a sentence."""

    __test__ = False  # pytest would collect a class of this name

    group: str
    name: str
    outcome: Literal["pass", "failure", "skipped", "error"]
    verdict: str
    text: str


def write(path: Path, name: str, properties: Mapping[str, str], cases: Iterable[TestCase]) -> None:
    """Write a file with one test suite."""
    suites = ElementTree.Element("testsuites")
    suite = ElementTree.SubElement(suites, "testsuite", name=name)
    listed = ElementTree.SubElement(suite, "properties")
    for key, value in properties.items():
        ElementTree.SubElement(listed, "property", name=key, value=_clean(value))
    counts = dict.fromkeys(("tests", "failure", "error", "skipped"), 0)
    for one in cases:
        text = _clean(one.text)
        case = ElementTree.SubElement(suite, "testcase", classname=one.group, name=_clean(one.name))
        counts["tests"] += 1
        if one.outcome == "skipped":
            ElementTree.SubElement(case, "skipped", message=f"{one.verdict}: {text}")
        elif one.outcome != "pass":
            ElementTree.SubElement(case, one.outcome, message=text[:500], type=one.verdict).text = text
        if one.outcome != "pass":
            counts[one.outcome] += 1
        ElementTree.SubElement(case, "system-out").text = f"{one.verdict}: {text}"
    for key, word in (("tests", "tests"), ("failure", "failures"), ("error", "errors"), ("skipped", "skipped")):
        suite.set(word, str(counts[key]))
    ElementTree.indent(suites)
    atomic.write_text(path, ElementTree.tostring(suites, encoding="unicode", xml_declaration=True))


def _clean(text: str) -> str:
    """Return text without characters that XML forbids."""
    return "".join(c for c in text if c in "\t\n\r" or 0x20 <= ord(c) < 0xFFFE)
