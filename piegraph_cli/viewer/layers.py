"""The layers, in the order in which they are listed and drawn: add a line for a new one."""

from piegraph_cli.viewer.hand_layer import Hand
from piegraph_cli.viewer.image_layer import Cameras
from piegraph_cli.viewer.layer import Layer
from piegraph_cli.viewer.model_layer import Predictions
from piegraph_cli.viewer.object_layers import Cloud, Particles, Truth
from piegraph_cli.viewer.plan_layer import PlanLayer

LAYERS: list[type[Layer]] = [Cameras, Hand, Cloud, Particles, Truth, Predictions, PlanLayer]
