"""From triangles and lamps to luminance: the ray caster and its shading."""
