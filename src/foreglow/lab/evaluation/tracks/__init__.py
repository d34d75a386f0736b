"""Metrics of tracks."""
