"""The vehicles and lights of one frame, and who sees whom."""
