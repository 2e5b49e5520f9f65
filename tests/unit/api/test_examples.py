"""Every public name has an example in its docstring, and all of them run."""

from __future__ import annotations

import doctest
import sys

import pytest

import horizonval as hv

THINGS = {name: getattr(hv, name) for name in hv.__all__ if name != "__version__"}


@pytest.mark.parametrize("name", THINGS)
def test_a_public_name_has_an_example_that_runs(name, in_user_folder, capsys):
    thing = THINGS[name]
    module = sys.modules[thing.__module__]
    examples = doctest.DocTestFinder().find(thing, name, module)
    own = examples[0] if examples else None
    assert own is not None
    assert own.examples, f"{name} has no example in its docstring"
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    for example in examples:
        runner.run(example, clear_globs=False)
    assert not runner.failures, capsys.readouterr().out
