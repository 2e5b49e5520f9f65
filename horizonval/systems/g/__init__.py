"""System G: quadrant sensor."""
