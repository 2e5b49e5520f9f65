"""Parts of the spacecraft before the camera: how they are lit, and how they are laid over the picture."""
