"""The paper's listener: relies on hearing ten messages a second, and says what it hears."""

from std_msgs.msg import String

from midstride import Component

comp = Component("listener")
heard = comp.create_input("in", String, rate=10)
listen = comp.create_functionality("listen", inputs=[heard])


def normal(message: String) -> None:
    comp.logger.info(f"I heard: {message.data}")


def degraded() -> None:
    comp.logger.info("I hear nothing I could rely on")


listen.set_normal_mode(normal, inputs=[heard])
listen.set_degraded_mode(degraded)
comp.start()
