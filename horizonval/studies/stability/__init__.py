"""How steady the infrared horizon is round an orbit and through the year, and what that costs a horizon sensor."""
