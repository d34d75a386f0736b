"""The pipeline as a network of ROS 2 nodes: one process a stage, standard messages between them.

`table`, `messages` and `results` say what travels; `join` puts together again what belongs to one frame; `node` is what
all nodes share, `detector`, `distance`, `tracking`, `beam`, `whole` and `source` are the nodes; `supervisor` starts
them all, and `measurement` runs a network over frames and times it. `docs/ros2.md` has the topics.
"""
