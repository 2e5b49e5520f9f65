"""What ``import horizonval as hv`` offers: one file for each kind of object, its functions beside it.

:mod:`horizonval` itself names all of it and loads a module here when one of its names is first used. Nothing in this
room computes: it calls what the commands call.
"""
