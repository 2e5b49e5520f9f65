"""Sources other than sunlight on the air: Moon, airglow, the Sun's disc."""
