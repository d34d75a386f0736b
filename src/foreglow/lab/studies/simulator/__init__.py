"""How close simulated drives come to real ones."""
