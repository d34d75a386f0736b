"""The run-time of each stage: the figure of the paper, in process, live, and over ROS 2."""
