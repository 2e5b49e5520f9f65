"""Radiance along given rays: the integrators alone, without camera or film."""
