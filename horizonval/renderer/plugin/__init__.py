"""The plugins that Mitsuba loads: integrator, camera, and the choice of its back-end."""
