"""The infrared horizon of a frame: where the radiance of a thermal band drops, all round the Earth, without renderer.

A horizon sensor in a thermal band does not see the hard horizon. It sees the limb of the air, whose height follows from
the temperature and the gases there. This room integrates the limb radiance along exact rays and finds that height;
:mod:`horizonval.render` draws the frame by other means. Clear sky: clouds, which lie below the opaque bands' horizon and
on a window band's, are left out, as is refraction (0.1 km in the height of the window's horizon, nothing at 40 km).

``rays`` is the geometry, ``radiance`` the integral, ``locators`` finds the heights, ``around`` puts a frame's truth
together.
"""
