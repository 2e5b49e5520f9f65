"""The limb by maximum likelihood: a model of the pixels across it, and the pose that makes them most probable."""
