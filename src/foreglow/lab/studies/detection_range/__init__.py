"""From what distance vehicles in sight are detected: what UN R48 asks of the camera."""
