"""A warning about a suite names the line of the user's that asked for the run, however deep it is found."""

from __future__ import annotations

from horizonval.api.run import _frames_inside


def test_frames_of_the_package_are_passed_over():
    names = {"__name__": "horizonval.somewhere", "warn": _frames_inside}
    exec("def inner():\n    return warn()\n\ndef outer():\n    return inner()", names)
    assert names["inner"]() == 2
    assert names["outer"]() == 3
