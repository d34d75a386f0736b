"""The renderer: from triangles and lamps to luminance."""
