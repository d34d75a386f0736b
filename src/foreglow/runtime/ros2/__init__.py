"""The pipeline as a network of ROS 2 nodes: one process a stage, standard messages between them.

`topics` names the topics. `header`, `table`, `messages` and `results` convert values to messages and back; `join` and
`frame_reader` make a frame of the messages that belong to it. `node` is the base of all compute nodes, `stages` has the
nodes, with `output` for beam commands, and `source` publishes frames. `supervisor` starts the nodes, and `measurement`
runs a network over frames and times it. `docs/ros2.md` describes the topics.
"""

STAGE_NODES = ("proposals", "classifier", "distance", "tracking", "beam")
"""The nodes of a network with a process for each stage, in the order in which a frame passes them."""
