"""A program of a suite or study file as an estimator, outside a run."""

from __future__ import annotations

from pathlib import Path

from horizonval.core.errors import UserError, nearest
from horizonval.estimation import installed
from horizonval.estimation.observation import Estimator
from horizonval.estimation.process.limits import Limits
from horizonval.spec.files import find
from horizonval.spec.load import read_toml, validate
from horizonval.spec.suite import StudyHead, StudySpec, SuiteHead, SuiteSpec


def program_of(suite: str | Path, name: str) -> Estimator | None:
    """Return the estimator that a suite or study file calls by a name; None for a name it uses but does not define.

    Parameters
    ----------
    suite : str or Path
        A file, or the name of a shipped suite.
    name : str
        Of one of its ``[[estimator]]`` tables, or of an installed estimator in its list.

    Raises
    ------
    UserError
        There is no such file, it is wrong, or it knows no estimator of that name.
    """
    path = find("suite", suite)
    data = read_toml(path)
    head: StudyHead | SuiteHead
    if "study" in data:
        study = validate(StudySpec, data, str(path))
        head, programs = study.study, study.estimator
    else:
        spec = validate(SuiteSpec, data, str(path))
        head, programs = spec.suite, spec.estimator
    for program in programs:
        if program.name == name:
            return installed.get(
                name, Limits(head.time_limit_s, head.memory_limit_mb, (program,), path.resolve().parent)
            )
    if name in head.estimators:
        return None
    known = nearest(name, [*(program.name for program in programs), *head.estimators])
    raise UserError(f"no estimator {name!r}", where=str(path), expected=f"one of {', '.join(known)}")
