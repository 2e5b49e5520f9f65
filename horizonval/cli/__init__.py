"""The command line: parse, call, print. No physics.

One file for each family of commands; :mod:`horizonval.cli.app` combines them. Commands import heavy packages on demand,
so that ``--help``, ``list`` and ``estimate`` start without the renderer.
"""

from horizonval.cli.app import main, run_command_line

__all__ = ["main", "run_command_line"]
