"""Random rigid things on a table and random pushes of them, moved by analytic quasi-static pushing alone.

What a prior learns of what does not bend. Outlines, sizes, particles, pressure, friction, pusher and strokes are drawn;
no simulator of the tables takes part.
"""

CORNERS = 40
"""Of an outline that is round or waisted."""
POINTS = 250
"""Random points inside an outline that particles are chosen of."""
STRIDE = 1e-3
"""Metres of the pusher in a step of the integration."""
SIZE = (0.05, 0.22)
"""Root of the area of an outline [m], drawn evenly in its logarithm."""
FRICTION = (0.25, 0.5)
"""With the pusher: median, and standard deviation of its logarithm."""
PRESSURE = (0.8, 0.15)
"""Turning length as a share of the radius of gyration: median (uniform pressure), and deviation of its logarithm."""
REACH = (0.008, 0.45)
"""The pusher's radius [m]: median, and deviation of its logarithm."""
OFF = 0.08
"""Deviation of the centre of friction, as a share of the radius of gyration."""
SHALLOW = 0.0015
"""Metres that a contact is begun with at most, so that a stroke begins where the last one ended."""
