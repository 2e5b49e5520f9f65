"""One pose fitted to the images of all heads of a body."""
