"""The layers, in the order in which they are listed and drawn: add a line for a new one."""

from piegraph_cli.viewer.layer import Layer
from piegraph_cli.viewer.particle_layers import Particles

LAYERS: list[type[Layer]] = [Particles]
