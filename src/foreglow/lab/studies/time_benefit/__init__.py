"""How long before a production system and a human a vehicle is detected."""
