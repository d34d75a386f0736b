"""From luminance to grey levels: lens, imager, rain and snow."""
