"""Writing simulated drives as a data set: PVDN's format with the truth beside it, as `foreglow.datasets` reads it."""
