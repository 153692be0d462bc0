"""The tabs beside the scene, in their order: add a line for a new one."""

from piegraph_cli.viewer.hand_panel import HandPanel
from piegraph_cli.viewer.layer import Panel
from piegraph_cli.viewer.layer_panel import LayerPanel

PANELS: list[type[Panel]] = [LayerPanel, HandPanel]
