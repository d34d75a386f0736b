"""The paper's table of detectors."""
