"""Bridges to simulators and recorders: our images and attitudes as their messages. Each needs an extra."""
