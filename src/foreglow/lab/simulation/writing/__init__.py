"""Data sets on disk: PVDN's layout, and the truth beside it."""
