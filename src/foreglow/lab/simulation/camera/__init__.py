"""The camera: from luminance to grey levels through lens and imager, with rain and snow."""
