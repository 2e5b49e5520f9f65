"""The parts of the search for the limb: smaller copies, proposed cones, their likelihood, points below the pixel."""
