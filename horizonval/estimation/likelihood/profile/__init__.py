"""The whole profile of the limb over height, as tables of rendered limbs predict it, fitted to the pixels."""
