"""System G: a static quadrant sensor, designed for one altitude and flown at another."""
