"""What ``import horizonval as hv`` offers, and what the command line calls: one file for each kind of object.

:mod:`horizonval` itself names the public part of it and loads a module here when one of its names is first used.
"""
