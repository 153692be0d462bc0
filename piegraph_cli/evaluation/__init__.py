"""Metrics, statistics, scores against truth, figures."""
