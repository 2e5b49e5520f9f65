"""Lights beside sunlight on the air: Moon, airglow, the Sun's own disc."""
