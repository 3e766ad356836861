"""The clock of the simulated hall: ``/clock``, on ROS 2, at a speed that can be set while it runs.

Nodes with ``use_sim_time`` follow it, the hall itself among them. It begins at the time of day, and moves 100 times a
second of real time.
"""

import time

INTERVAL = 0.01  # s


class SimClock:
    """``speed``: its seconds in a second of real time."""

    def __init__(self, speed: float) -> None:
        self.shown, self.moved = time.time_ns(), time.monotonic_ns()
        self.set_speed(speed)

    def set_speed(self, speed: float) -> None:
        """Raises ValueError, by which the parameter is refused."""
        if not 0.0 <= speed <= 10.0:
            raise ValueError(f"the speed of /clock is from 0 (it stands still) to 10, not {speed:g}")
        self.speed = speed

    def publish(self, node) -> None:
        """``node``: rclpy's; on no other platform is there anything to publish."""
        if not hasattr(node, "create_publisher"):
            return
        from rclpy.clock import Clock, ClockType
        from rosgraph_msgs.msg import Clock as ClockMessage

        publisher = node.create_publisher(ClockMessage, "/clock", 10)

        def move() -> None:
            now = time.monotonic_ns()
            self.shown, self.moved = self.shown + round((now - self.moved) * self.speed), now
            message = ClockMessage()
            message.clock.sec, message.clock.nanosec = divmod(self.shown, 1_000_000_000)
            publisher.publish(message)

        node.create_timer(INTERVAL, move, clock=Clock(clock_type=ClockType.STEADY_TIME))
