"""Other people's simulators and recorders: our images and attitudes as their messages.

Everything here is asked for by name and needs an extra; nothing else of the package imports it.
"""
