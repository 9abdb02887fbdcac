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
from scipy.spatial.transform import Rotation

from mjtactile.core.design import load_sensor
from mjtactile.export.effective_camera import effective_camera
from mjtactile.export.frames import moving_frames
from mjtactile.recording.mounting import Mounting
from tests.fake_run import fake_cycle

NODE = Path(__file__).resolve().parents[2] / "examples/ros2/touch_node.py"
TYPES = (
    "geometry_msgs/msg/TransformStamped",
    "geometry_msgs/msg/WrenchStamped",
    "rosgraph_msgs/msg/Clock",
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/PointField",
)
ZEROS = {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}


def message_class(store, kind):
    """Return a class whose instances have only the message's fields, initially zero."""
    fields = store.fielddefs[kind][1]

    def initial(form):
        node_kind = form[0].name
        of = form[1]
        if node_kind == "BASE":
            return ZEROS.get(of[0], 0)
        return message_class(store, of)() if node_kind == "NAME" else []

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
    """Return the message as a rosbags message, which checks every type when it is written."""

    def real(value, form):
        node_kind = form[0].name
        of = form[1]
        if node_kind == "NAME":
            return convert(value)
        if node_kind == "BASE":
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
def ros(monkeypatch):  # noqa: C901  # one stand-in per class of rclpy
    """Provide the modules that the node imports; `sent` stores the published messages."""
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    sent = SimpleNamespace(topics=[], frames=[], fixed=[], qos={}, clock=100.0)
    stamp = message_class(store, "builtin_interfaces/msg/Time")

    class FakeTime(float):
        def __new__(cls, seconds=0.0, nanoseconds=0):
            return float.__new__(cls, seconds + 1e-9 * nanoseconds)

        def __sub__(self, other):
            return FakeTime(float(self) - float(other))

        def __add__(self, other):
            return FakeTime(float(self) + float(other))

        def to_msg(self):
            sec, nanosec = divmod(round(1e9 * self), 10**9)
            return stamp(sec=sec, nanosec=nanosec)

    class LifecycleNode:
        def __init__(self, name):
            self.name = name
            self.values = {}

        def declare_parameter(self, name, value):
            self.values.setdefault(name, value)

        def get_parameter(self, name):
            return SimpleNamespace(value=self.values[name])

        def create_publisher(self, kind, topic, qos):
            sent.qos[topic] = qos
            return SimpleNamespace(
                publish=lambda message: sent.topics.append((topic, kind, to_wire(store, message)))
            )

        def get_clock(self):
            return SimpleNamespace(now=lambda: FakeTime(sent.clock))

        def get_logger(self):
            return SimpleNamespace(error=sent.topics.append)

        def on_activate(self, state):
            return "success"

        on_deactivate = on_activate

    def broadcaster(found):
        class Broadcaster:
            def __init__(self, node):
                pass

            def sendTransform(self, transforms):
                found.append([to_wire(store, each) for each in transforms])

        return Broadcaster

    class ActionServer:
        def __init__(self, node, kind, name, execute, *, goal_callback, cancel_callback):
            assert (kind.__name__, name) == ("Grasp", "~/grasp")

        def destroy(self):
            sent.topics.append("destroyed")

    fields = {"phase": "", "message": "", "success": False, "force_normal": ()}
    part = type("Part", (SimpleNamespace,), fields)
    grasp = type("Grasp", (), {"Result": part, "Feedback": part})
    answers = SimpleNamespace(
        ACCEPT="accept", REJECT="reject", SUCCESS="success", FAILURE="failure"
    )
    modules = {
        "rclpy": {},
        "rclpy.action": {
            "ActionServer": ActionServer,
            "CancelResponse": answers,
            "GoalResponse": answers,
        },
        "rclpy.duration": {"Duration": lambda *, seconds: FakeTime(seconds)},
        "rclpy.executors": {"MultiThreadedExecutor": None},
        "rclpy.lifecycle": {"LifecycleNode": LifecycleNode, "TransitionCallbackReturn": answers},
        "rclpy.qos": {"qos_profile_sensor_data": "sensor data"},
        "rclpy.time": {"Time": FakeTime},
        "mjtactile_msgs.action": {"Grasp": grasp},
        "tf2_ros": {
            "TransformBroadcaster": broadcaster(sent.frames),
            "StaticTransformBroadcaster": broadcaster(sent.fixed),
        },
    }
    for kind in TYPES:
        package, _, name = kind.split("/")
        modules.setdefault(f"{package}.msg", {})[name] = message_class(store, kind)
    for name, content in modules.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    return sent


NAMES = ("left", "right")


def configured(**parameters):
    """Return the node after its first transition."""
    node = runpy.run_path(str(NODE))["TouchNode"]()
    node.values |= parameters
    assert node.on_configure(None) == "success"
    return node


def cameras():
    return [effective_camera(load_sensor("dense")).camera] * 2


def test_the_node_publishes_the_estimates(ros):
    node = configured()
    cycle = fake_cycle(30)  # at 1 s on the rig's clock, 0.01 s ago
    node.start_cycle(1.01)
    node.publish(NAMES, cycle, cameras())
    topics = {topic: message for topic, _, message in ros.topics}
    info = topics["left/camera_info"]
    np.testing.assert_array_equal(info.d, cameras()[0].distortion)
    assert ros.qos["left/image"] == ros.qos["right/wrench"] == "sensor data"
    assert set(topics) == {
        "joint_states",
        "left/camera_info",
        "left/image",
        "left/wrench",
        "left/membrane",
        "right/camera_info",
        "right/image",
        "right/wrench",
        "right/membrane",
    }
    touch = cycle.touch[1]
    estimated = topics["right/wrench"].wrench
    assert [estimated.force.x, estimated.force.y, estimated.force.z] == list(
        touch.traction.wrench[:3]
    ) and estimated.force.z < -0.5
    assert (topics["right/wrench"].header.frame_id, topics["left/wrench"].header.stamp.nanosec) == (
        "right_sensor",
        990_000_000,
    )
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


def test_an_unknown_force_is_not_published(ros):
    node = configured()
    cycle = fake_cycle(30)
    unknown = SimpleNamespace(traction=None, surface=None, age=0.0)
    node.start_cycle(1.0)
    node.publish(
        NAMES,
        SimpleNamespace(
            gripper=cycle.gripper, images=cycle.images, touch=(unknown, unknown), time=cycle.time
        ),
        cameras(),
    )
    assert not {topic for topic, _, _ in ros.topics if topic.endswith(("wrench", "membrane"))}


def test_frames_are_those_of_an_exported_bag(ros):
    node = configured()
    cycle = fake_cycle(30)
    node.start_cycle(1.0)
    node.publish_frames(NAMES, cycle)
    row = {"opening": cycle.gripper.opening, "lift_height": cycle.gripper.lift_height}
    requested = list(moving_frames(Mounting.assumed(2), NAMES, row))
    assert len(ros.frames[0]) == len(requested)
    for found, own in zip(ros.frames[0], requested, strict=True):
        assert (found.header.frame_id, found.child_frame_id) == (own.parent, own.child)
        t = found.transform
        at = [t.translation.x, t.translation.y, t.translation.z]
        np.testing.assert_allclose(at, own.p, atol=1e-12)
        q = [t.rotation.x, t.rotation.y, t.rotation.z, t.rotation.w]
        same = Rotation.from_quat(q).as_matrix()
        np.testing.assert_allclose(same, own.R, atol=1e-12)


def test_a_simulated_rig_can_be_the_clock(ros):
    """Stamps are then the rig's times, and /clock has the time of the cycle."""
    node = configured(publish_clock=True)
    node.start_cycle(1.01)
    node.publish(NAMES, fake_cycle(30), cameras())
    topics = {topic: message for topic, _, message in ros.topics}
    clock = topics["/clock"].clock
    stamp = topics["left/image"].header.stamp
    assert (clock.sec, clock.nanosec, stamp.sec, stamp.nanosec) == (1, 10_000_000, 1, 0)


def test_an_inactive_node_rejects_a_goal_and_a_wrong_sensor_is_no_transition(ros):
    node = configured()
    assert node.accept(None) == "reject"
    node.on_activate(None)
    assert node.accept(None) == "accept"
    node.on_deactivate(None)
    assert node.accept(None) == "reject"
    node.values["sensor"] = "none"
    assert node.on_configure(None) == "failure"
    assert node.on_cleanup(None) == "success" and "destroyed" in ros.topics


def test_a_goal_that_fails_has_its_reason(ros):
    node = configured()
    states = []
    request = SimpleNamespace(object="egg", controller="none_such")
    handle = SimpleNamespace(
        request=request, is_cancel_requested=False, abort=lambda: states.append("aborted")
    )
    result = node.grasp(handle)
    assert states == ["aborted"] and "none_such" in result.message and not node.busy
