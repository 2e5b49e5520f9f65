"""Multiple scattering: tables of the diffuse source."""
