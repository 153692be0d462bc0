"""Cameras that are plugged in: one interface, RealSense behind it, takes that become sequence folders, a live picture."""
