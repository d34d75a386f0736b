"""Every table, figure and number of the paper beside ours."""
