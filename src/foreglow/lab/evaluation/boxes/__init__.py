"""Metrics of boxes and of the light that they hold."""
