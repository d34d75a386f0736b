"""Closed-loop drives of several beam policies: the light at other drivers' eyes, in lux."""
