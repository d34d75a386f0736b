"""Night drives from physics: frames with exact labels, as another source beside the data sets."""
