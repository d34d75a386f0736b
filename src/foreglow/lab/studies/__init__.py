"""What `foreglow experiment NAME` computes, a module an experiment; `reports` makes pages of the results."""
