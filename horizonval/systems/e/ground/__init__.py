"""What a station's camera sees, and the directions read off it."""
