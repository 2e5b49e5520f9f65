"""The infrared horizon of a frame: where the radiance of a thermal band drops, all round the Earth, without renderer.

A horizon sensor in a thermal band does not see the hard horizon. It sees the limb of the air, whose height follows from
the temperature and the gases there. This room integrates the limb radiance along exact rays and finds that height;
:mod:`horizonval.renderer` draws the frame by other means.

Clear sky: clouds are left out. They lie below the horizon of the opaque bands; that of a window band they lift to their
tops. Light is taken as straight, as in all truths; refraction lifts the horizon of a window band by up to 1 km, that of
the opaque bands, at 40 km, by 5 m.

``rays`` is the geometry, ``radiance`` the integral, ``locators`` finds the heights, ``around`` puts a frame's truth
together.
"""
