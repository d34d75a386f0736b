"""The vehicles and lights of one frame, and the lines of sight between them."""
