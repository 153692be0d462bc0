"""The tabs beside the scene, in their order: add a line for a new one."""

from piegraph_cli.viewer.curves import CurvePanel
from piegraph_cli.viewer.hand_panel import HandPanel
from piegraph_cli.viewer.image_panel import ImagePanel
from piegraph_cli.viewer.layer import Panel
from piegraph_cli.viewer.layer_panel import LayerPanel
from piegraph_cli.viewer.model_panel import ModelPanel
from piegraph_cli.viewer.plan_panel import PlanPanel
from piegraph_cli.viewer.run_panel import RunPanel

PANELS: list[type[Panel]] = [ImagePanel, CurvePanel, LayerPanel, ModelPanel, PlanPanel, HandPanel, RunPanel]
