"""Nightly accuracy regression: three lanes, gates with margins declared in the suite's file, a verdict.

* *replay*: today's estimators on the frozen detector images of the accepted baseline.
* *re-render*: the baseline's scenes and noise seeds again, compared by digest, then by region of the image.
* *fresh*: new scenes every night.
"""
