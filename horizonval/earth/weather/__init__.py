"""Air of single days: climates with Antarctic winters, random weather over the globe, real states."""
