"""The bench of the hardware-in-the-loop experiment, rendered: a camera turned before a panel that shows a horizon.

Bench axes are those of a camera at rest on a perfect bench: x right, y down (along gravity), z to the panel,
millimetres. The published text says no more of its rig than that a camera stood before a displayed horizon and that an
accelerometer measured how it was tilted. One camera's chord measures the turn of the picture about the boresight: this
is the camera of the pitch channel, whose boresight lies along the satellite's pitch axis. So "tilted" is read as turned
about the boresight, which on a bench is horizontal, where an accelerometer can measure it.
"""
