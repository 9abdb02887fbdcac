"""Grasp from Python: a session provides references, control loop and supervision.

It uses the shipped controller, and a callback observes each cycle. `open_session` takes the same
values as `--rig`: "sim", "emulated", a recording, or the rig file of your own gripper.
"""

import mjtactile

design = mjtactile.load_sensor("dense")
controller = mjtactile.load_controller("adaptive")
seen = []  # (phase, estimated normal forces in N, slip states), one per cycle


def on_cycle(cycle):
    left, right = forces = [touch.force_normal for touch in cycle.touch]
    slips = [touch.slip.state if touch.slip else "unknown" for touch in cycle.touch]
    if not seen or seen[-1][0] != cycle.sent.phase:
        print(f"{cycle.time:5.2f} s  {cycle.sent.phase:<9} {left:5.2f} {right:5.2f} N  {slips}")
    seen.append((cycle.sent.phase, forces, slips))


with mjtactile.open_session("sim", design, object_name="strawberry", seed=3) as session:
    # references of each sensor, flat and inflated; no contact is allowed
    session.take_references()
    last = session.run(controller, time_limit=60, on_cycle=on_cycle)

held = [forces for phase, forces, _ in seen if phase == "hold"]
print(
    f"ended as {last.phase!r}; held with {sum(map(sum, held)) / 2 / len(held):.3f} N on each finger"
)
