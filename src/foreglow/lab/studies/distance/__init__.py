"""The paper's box plots of ranges."""
