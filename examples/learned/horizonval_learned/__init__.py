"""An estimator that learned from rendered frames: geometry does what is known, a network says where a limb lies.

``first_cone``
    A start from the steepest pixels, in closed form.
``patch``
    The image about a horizon, in azimuth and angle off it.
``network``
    What was learned: of one profile across the limb, where the horizon lies in it and how surely. Numpy alone.
``fit``
    Nadir and covariance from all profiles of an image, by least squares.
``estimator``
    These in a row, and the refusals.
``train``, ``score``
    How the weights were made, and the page that says how good they are.
"""
