"""Descriptions of drives: the scenario language, and the scenarios that are drawn in it."""
