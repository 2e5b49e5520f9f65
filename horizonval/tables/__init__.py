"""Tables of rendered profiles of the limb: an ensemble of states, its mean and its modes."""
