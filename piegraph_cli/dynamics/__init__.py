"""Predicting where particles go under a stroke: canonical action, networks, losses, training, models by name."""
