"""Mitsuba and Dr.Jit live here: back-end, march, plugins, frames.

Dr.Jit picks its LLVM library when it is first imported, and some system libraries abort the process when they compile.
So the library that came with this package is named before anything in this room imports Dr.Jit.
"""

from horizonval.core.environment import name_library

name_library()
