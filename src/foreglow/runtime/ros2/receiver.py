"""Receives all waiting messages of a node's subscriptions at once.

An executor of rclpy also serves services, timers and guard conditions, takes one message a round, and builds its wait
set anew for each round. Like `rclpy.wait_for_message`, this waits for subscriptions and nothing else.
"""

from __future__ import annotations

from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation

MAX_MESSAGES = 100
"""Taken from one subscription at once."""


class Receiver:
    """Calls the callbacks of a node's subscriptions, in the order in which the subscriptions were made."""

    def __init__(self, node: Any) -> None:
        """A receiver for an rclpy node that already has all its subscriptions."""
        self._subscriptions = list(node.subscriptions)
        count = len(self._subscriptions)
        self._waiting = rclpy_implementation.WaitSet(count, 0, 0, 0, 0, 0, node.context.handle)

    def receive(self, timeout_s: float) -> None:
        """Waits for messages, `timeout_s` at most, and calls the callbacks for all that have arrived."""
        waiting = self._waiting
        waiting.clear_entities()
        for subscription in self._subscriptions:
            waiting.add_subscription(subscription.handle)
        waiting.wait(max(0, round(timeout_s * 1e9)))
        ready = set(waiting.get_ready_entities("subscription"))
        for subscription in self._subscriptions:
            if subscription.handle.pointer in ready:
                for _ in range(MAX_MESSAGES):
                    taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
                    if taken is None:
                        break
                    subscription.callback(taken[0])
