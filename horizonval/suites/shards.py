"""Results of shards that were made in other folders, taken over into one."""

from __future__ import annotations

from horizonval.core.errors import UserError
from horizonval.jobs.engine import take_over
from horizonval.spec.load import Suite
from horizonval.store.entry import INDEX_PREFIX
from horizonval.store.folder import RunFolder, read_json
from horizonval.suites.identity import suite_identity

ROOMS = ("archive", "cases", "state", "stability")


def adopt(source: RunFolder, target: RunFolder, suite: Suite) -> None:
    """Copy the results of a run of the same suite that ``target`` does not have.

    They are looked at like the folder's own: what is damaged or of other code is made again. The archive's index is not
    copied; that of ``target`` catches up with the files. Raises ``UserError`` if ``source`` is no folder of a run, or
    of another suite's.
    """
    run = read_json(source.suite)
    if run is None:
        raise UserError("no run.json", where=str(source.root), expected="the folder of a run")
    if run.get("suite_sha256") != suite_identity(suite):
        raise UserError(
            f"holds a run of other frames, cameras or estimators (suite {run.get('suite')!r})",
            where=str(source.root),
            expected=f"a run of {suite.name!r} as it is now",
        )
    take_over(source.root, target.root, ROOMS, lambda path: not path.name.startswith((".", INDEX_PREFIX)))
