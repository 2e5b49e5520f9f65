"""A night: run the lanes and the anchors, compare, decide, and write it all down.

The folder of a night::

    verdict.json    everything decided, for machines
    junit.xml       the same for a CI service
    index.html      the same for people, with the trend of the last 60 nights
    night.json      rows and digests, from which `horizonval baseline accept` makes the next baseline
    history.jsonl   one line for every night that used this folder
    .work/          finished units; an interrupted night goes on from them
"""

from __future__ import annotations

from horizonval.core import atomic
from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.core.progress import Progress, Silent
from horizonval.spec.load import Suite
from horizonval.store.folder import RunFolder, write_json
from horizonval.store.verify import withdraw_manifest, write_manifest
from horizonval.studies.regression.baseline import history
from horizonval.studies.regression.baseline.baseline import read_baseline, release_path
from horizonval.studies.regression.bench import NightWork, Task, sweep
from horizonval.studies.regression.junit import write_junit
from horizonval.studies.regression.tonight.conclude import verdict_of
from horizonval.studies.regression.tonight.gathered import Gathered
from horizonval.studies.regression.tonight.wanted import WORK, Published, Wanted, check_folder, checked, reference_of
from horizonval.suites.suite import load_suite


def run_night(wanted: Wanted, progress: Progress | None = None, published: Published | None = None) -> JsonObject:
    """Do a night and return the content of ``verdict.json``.

    Parameters
    ----------
    wanted : Wanted
    progress : Progress, optional
    published : callable, optional
        What the lane of that name does, in a suite that asks for it; without, it is left out.

    Raises
    ------
    UserError
        A mistake in the suite or the baseline's files, no ``[regression]`` table, a folder in which another night runs,
        or no back-end to render with.
    """
    from horizonval.renderer.plugin.backend import probe
    from horizonval.studies.regression.frames import of_night
    from horizonval.studies.regression.page import write_page

    suite = load_suite(wanted.suite)
    spec, plan = checked(suite)
    accepted = read_baseline(wanted.baseline, suite.name) if wanted.baseline.is_file() else None
    release = None
    if accepted is not None and release_path(wanted.baseline).is_file():
        release = read_baseline(release_path(wanted.baseline), suite.name)
    reference = None if wanted.reference is None else reference_of(wanted.reference, suite.name, wanted.night)
    if probe().chosen is None:
        raise UserError("no back-end can render on this machine", fix="see `horizonval doctor`")
    check_folder(wanted.out)
    (wanted.out / WORK).mkdir(parents=True, exist_ok=True)
    folder = RunFolder(wanted.out / WORK)
    with folder.locked():
        withdraw_manifest(wanted.out)
        for path in atomic.leftovers(wanted.out / WORK, below=False):
            path.unlink(missing_ok=True)
        gathered = Gathered(suite, spec, plan, wanted, accepted, progress or Silent())
        gathered.work_first()
        gathered.compute_published(published)
        verdict = verdict_of(gathered, release, reference)
        write_json(wanted.out / "night.json", gathered.content(), indent=None)
        # A folder that serves every night must not grow with them.
        sweep(wanted.out / WORK, gathered.identities)
        history.append(wanted.out / history.FILE, verdict)
        verdict["trend"] = history.steps_of(history.read(wanted.out / history.FILE))
        write_json(wanted.out / "verdict.json", verdict)
        write_junit(wanted.out / "junit.xml", verdict)
        write_page(wanted.out / "index.html", verdict, history.read(wanted.out / history.FILE), of_night(gathered))
        pages = [wanted.out / name for name in ("night.json", "verdict.json", "junit.xml", "index.html", history.FILE)]
        units = [wanted.out / WORK / f"{name}{end}" for name in gathered.identities for end in (".json", ".npz")]
        write_manifest(wanted.out, [*pages, *units])
    return verdict


def planned(wanted: Wanted) -> tuple[Suite, NightWork, list[Task]]:
    """Return what a night would begin with, and how it is made; nothing is made. Errors as :func:`run_night`."""
    suite = load_suite(wanted.suite)
    spec, plan = checked(suite)
    accepted = read_baseline(wanted.baseline, suite.name) if wanted.baseline.is_file() else None
    gathered = Gathered(suite, spec, plan, wanted, accepted, Silent())
    return suite, NightWork(plan, wanted.out / WORK), list(gathered.first_tasks().values())
