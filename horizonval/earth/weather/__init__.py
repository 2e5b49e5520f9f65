"""Air as it is on one day: climates with Antarctic winters, random weather over the globe, real states."""
