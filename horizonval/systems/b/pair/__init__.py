"""System B without its test bench: two perpendicular cameras over the Earth, in every attitude and round an orbit."""
