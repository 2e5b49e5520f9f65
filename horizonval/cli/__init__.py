"""The command line: parse, call, print. No physics.

One file for each family of commands, :mod:`horizonval.cli.app` puts them together. Heavy packages are imported inside
the commands that need them, so that ``--help``, ``list`` and ``estimate`` start without the renderer.
"""

from horizonval.cli.app import main, run_command_line

__all__ = ["main", "run_command_line"]
