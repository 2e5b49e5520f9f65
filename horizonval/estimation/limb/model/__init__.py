"""What moves limb points off the hard horizon, and how far each may be trusted."""
