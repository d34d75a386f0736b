"""What an annotator would mark, and when."""
