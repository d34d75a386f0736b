"""How well the place and time at which a hidden vehicle comes into sight are predicted."""
