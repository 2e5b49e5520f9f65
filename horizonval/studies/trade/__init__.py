"""Trade studies: designs compared on the same frames, with the same samples of clouds and noise.

A study file (:mod:`horizonval.spec.suite`) becomes a suite (:mod:`design`), the campaign engine makes its frames
(:mod:`run`), and :mod:`conclude` computes the results from the rows alone.
"""
