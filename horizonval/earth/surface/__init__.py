"""Ground: land and sea, reflection, emission, temperature."""
