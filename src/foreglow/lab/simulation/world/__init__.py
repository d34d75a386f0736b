"""What stands still, and the bodies of vehicles: triangles with materials."""
