"""Foreglow: provident vehicle detection at night."""
