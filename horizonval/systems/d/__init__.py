"""System D: four linear infrared heads."""
