"""Trade studies: designs compared on the same frames, with the same draws of clouds and noise.

A study file (:mod:`horizonval.spec.suite`) becomes a suite (:mod:`design`), the campaign engine makes its frames
(:mod:`run`), and what the designs deliver is worked out from the rows of results alone (:mod:`conclude`).
"""
