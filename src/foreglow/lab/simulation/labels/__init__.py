"""Labels of a simulated drive: what an annotator would mark, and when."""
