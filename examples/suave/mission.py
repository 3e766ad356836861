"""SUAVE's mission with a time limit: guided mode, then the tasks `search_pipeline` and `inspect_pipeline`."""

from std_msgs.msg import Bool, String

from midstride import Component, Output, guarantee

comp = Component("mission")
state = comp.create_input("state", String)
detected = comp.create_input("detected", Bool)
set_mode = comp.create_output("set_mode", String)
search = comp.create_output("search", Bool)
inspect = comp.create_output("inspect", Bool)
save = comp.create_output("save", Bool)
plan = comp.create_functionality("plan", inputs=[state, detected], outputs=[set_mode, search, inspect, save])
time_limit = comp.parameter("time_limit", 250.0)
began: float | None = None
found = ended = False
calls = 0
requested: dict[Output, bool] = {}


def request(task: Output, wanted: bool) -> None:
    """At once where that has changed, and once a second."""
    if requested.get(task) is not wanted or calls % 10 == 0:
        requested[task] = wanted
        task.write(Bool(data=wanted))


def normal() -> None:
    global began, found, ended, calls
    guided = state.latest is not None and state.latest.data == "GUIDED"
    if state.latest is not None and not guided:
        set_mode.write(String(data="GUIDED"))
    if guided and began is None:
        began = comp.clock.seconds()
    found = found or (detected.latest is not None and detected.latest.data)
    over = began is not None and comp.clock.seconds() - began >= time_limit.value
    request(search, began is not None and not found and not over)
    request(inspect, found and not over)
    calls += 1
    if over and not ended:
        ended = True
        save.write(Bool(data=True))


yes = guarantee(where={"data": True})
outputs = [set_mode, search, inspect, save]
plan.set_normal_mode(normal, rate=10, outputs=outputs, guarantees={search: yes, inspect: yes})
plan.set_degraded_mode(lambda: None, name="off")
comp.start()
