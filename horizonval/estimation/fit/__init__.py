"""The fit of a limb to pixels: image models, a bundle of unknowns, and the solver that all methods share."""
