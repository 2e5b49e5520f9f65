"""Nightly accuracy regression: three lanes, gates with declared margins, a verdict.

* *replay*: the accepted baseline's frozen detector images through the estimators of today.
* *re-render*: the baseline's scenes and noise seeds again, compared by hash, then by region of the image.
* *fresh*: scenes nobody has seen, drawn anew every night.

The margins are declared in the suite's file (:mod:`horizonval.spec.suite`), nowhere else.
"""
