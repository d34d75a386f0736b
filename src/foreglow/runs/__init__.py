"""What a run leaves in its folder: every file format with its writer and its reader."""
