"""How high the limb of a band stands along its arc, from its shipped profiles."""
