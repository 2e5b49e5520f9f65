"""Air: profiles, climates, molecules, ozone, particles, clouds."""
