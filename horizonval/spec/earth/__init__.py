"""The parts of a scene file that say what the Earth, its air and its lights are."""
