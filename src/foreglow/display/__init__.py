"""What a person looks at while the system runs: overlays, pictures of the beam, videos, the viewer, progress."""
