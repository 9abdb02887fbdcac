"""Tests of the ROS 2 node against the message definitions of ROS 2 Humble; the node's own library
is not installed here.

Stand-in classes have exactly the fields of the definitions. rosbags serializes their values and
reads them back. A replayed grasp supplies touch and motion.
"""

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from tests.fake_run import fake_cycle

NODE = Path(__file__).resolve().parents[2] / "examples/ros2/touch_node.py"
TYPES = (
    "geometry_msgs/msg/WrenchStamped",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/PointField",
)
ZEROS = {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}


def message_class(store, kind):
    """A class whose instances have the message's fields, zero at first, and take no others."""
    fields = store.fielddefs[kind][1]

    def initial(form):
        what = form[0].name
        of = form[1]
        if what == "BASE":
            return ZEROS.get(of[0], 0)
        return message_class(store, of)() if what == "NAME" else []

    def __init__(self, **values):
        for name, form in fields:
            setattr(self, name, values.pop(name) if name in values else initial(form))
        assert not values, f"{kind} has no {list(values)}"

    body = {"__slots__": [name for name, _ in fields], "__init__": __init__, "KIND": kind}
    return type(
        kind.rpartition("/")[2],
        (),
        body | {name: value for name, _, value in store.fielddefs[kind][0]},
    )


def to_wire(store, message):
    """The message as rosbags' own, which checks every type when it is written."""

    def real(value, form):
        what = form[0].name
        of = form[1]
        if what == "NAME":
            return convert(value)
        if what == "BASE":
            return value
        inner = of[0]
        if inner[0].name == "NAME":
            return [convert(each) for each in value]
        return list(value) if inner[1][0] == "string" else np.asarray(value, inner[1][0])

    def convert(part):
        return store.types[part.KIND](
            **{
                name: real(getattr(part, name), form)
                for name, form in store.fielddefs[part.KIND][1]
            }
        )

    return store.deserialize_cdr(store.serialize_cdr(convert(message), message.KIND), message.KIND)


@pytest.fixture
def ros(monkeypatch):
    """Provide the modules that the node imports; `sent` stores the published messages."""
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    sent = []
    stamp = message_class(store, "builtin_interfaces/msg/Time")

    class FakeTime(float):
        def __sub__(self, other):
            return FakeTime(float(self) - float(other))

        def to_msg(self):
            return stamp(sec=int(self), nanosec=round(1e9 * (self % 1)))

    def duration(*, seconds):
        return FakeTime(seconds)

    class Node:
        def __init__(self, name):
            self.name = name

        def declare_parameter(self, name, value):
            return SimpleNamespace(value=value)

        def create_publisher(self, kind, topic, depth):
            return SimpleNamespace(
                publish=lambda message: sent.append((topic, kind, to_wire(store, message)))
            )

        def get_clock(self):
            return SimpleNamespace(now=lambda: FakeTime(100.0))

    modules = {"rclpy": {}, "rclpy.node": {"Node": Node}, "rclpy.duration": {"Duration": duration}}
    for kind in TYPES:
        package, _, name = kind.split("/")
        modules.setdefault(f"{package}.msg", {})[name] = message_class(store, kind)
    for name, content in modules.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    return sent


def test_what_the_node_publishes_is_what_was_felt(ros):
    node = runpy.run_path(str(NODE))["TouchNode"]()
    cycle = fake_cycle(30)
    node.publish(("left", "right"), cycle)
    topics = {topic: message for topic, _, message in ros}
    assert set(topics) == {
        "joint_states",
        "left/image",
        "left/wrench",
        "left/membrane",
        "right/image",
        "right/wrench",
        "right/membrane",
    }
    touch = cycle.touch[1]
    felt = topics["right/wrench"].wrench
    assert [felt.force.x, felt.force.y, felt.force.z] == list(
        touch.traction.wrench[:3]
    ) and felt.force.z < -0.5
    assert (
        topics["right/wrench"].header.frame_id,
        topics["right/wrench"].header.stamp.nanosec,
    ) == ("right_sensor", 990_000_000)
    image = topics["right/image"]
    np.testing.assert_array_equal(
        image.data.reshape(image.height, image.width), cycle.images[1].pixels
    )
    assert (image.encoding, image.step, image.header.frame_id) == (
        "mono8",
        image.width,
        "right_camera",
    )
    cloud = topics["right/membrane"]
    points = np.frombuffer(cloud.data.tobytes(), "<f4").reshape(cloud.width, cloud.point_step // 4)
    assert [(field.name, field.offset, field.datatype) for field in cloud.fields] == [
        ("x", 0, 7),
        ("y", 4, 7),
        ("z", 8, 7),
    ]
    np.testing.assert_allclose(
        points[:, 2].reshape(touch.surface.z.shape), touch.surface.z, atol=1e-9
    )
    # the first row is along x
    np.testing.assert_allclose(points[:21, 0], touch.surface.x, atol=1e-9)
    joints = topics["joint_states"]
    assert joints.name == ["opening", "lift"] and joints.position[0] == cycle.gripper.opening


def test_a_force_that_is_not_known_is_not_published(ros):
    node = runpy.run_path(str(NODE))["TouchNode"]()
    cycle = fake_cycle(30)
    unknown = SimpleNamespace(traction=None, surface=None, age=0.0)
    node.publish(
        ("left", "right"),
        SimpleNamespace(gripper=cycle.gripper, images=cycle.images, touch=(unknown, unknown)),
    )
    assert {topic for topic, _, _ in ros} == {"joint_states", "left/image", "right/image"}
