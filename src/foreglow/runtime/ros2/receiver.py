"""Takes the messages of a node's subscriptions: all that have come, in one go.

rclpy's executors look after services, timers and guards as well, take one message a round, and make all of that anew
for each round. As `rclpy.wait_for_message`, this waits for subscriptions and nothing else.
"""

from __future__ import annotations

from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation

MAX_MESSAGES = 100
"""Of one subscription, at once."""


class Receiver:
    """Calls the callbacks of a node's subscriptions, in the order in which these were made."""

    def __init__(self, node: Any) -> None:
        """Takes the node of rclpy, which has all its subscriptions by now."""
        self._subscriptions = list(node.subscriptions)
        count = len(self._subscriptions)
        self._waiting = rclpy_implementation.WaitSet(count, 0, 0, 0, 0, 0, node.context.handle)

    def receive(self, timeout_s: float) -> None:
        """Waits for messages, `timeout_s` at most, and hands over all that have come."""
        waiting = self._waiting
        waiting.clear_entities()
        for one in self._subscriptions:
            waiting.add_subscription(one.handle)
        waiting.wait(max(0, round(timeout_s * 1e9)))
        ready = set(waiting.get_ready_entities("subscription"))
        for one in self._subscriptions:
            if one.handle.pointer in ready:
                for _ in range(MAX_MESSAGES):
                    taken = one.handle.take_message(one.msg_type, one.raw)
                    if taken is None:
                        break
                    one.callback(taken[0])
