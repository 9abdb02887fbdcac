"""Touch in ROS 2: a grasp as topics: wrenches, membranes, images, jaws. The frames are those of
`export --format rosbag2`.

In a Python that has both ROS 2 and mjtactile: `python3 touch_node.py --ros-args -p
rig:=my_gripper.toml -p controller:=gentle`
"""

from array import array

import numpy as np
import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.duration import Duration
from rclpy.node import Node
from sensor_msgs.msg import Image, JointState, PointCloud2, PointField

import mjtactile

DEFAULTS = {"rig": "sim", "sensor": "dense", "controller": "gentle", "object": "egg"}


class TouchNode(Node):
    def __init__(self):
        super().__init__("mjtactile")
        self.wanted = {
            name: self.declare_parameter(name, value).value for name, value in DEFAULTS.items()
        }
        self.topics = {}

    def send(self, topic, message, frame, age=0.0):
        if topic not in self.topics:
            self.topics[topic] = self.create_publisher(type(message), topic, 10)
        message.header.frame_id = frame
        message.header.stamp = (self.get_clock().now() - Duration(seconds=age)).to_msg()
        self.topics[topic].publish(message)

    def publish(self, names, cycle):
        jaws = cycle.gripper
        self.send(
            "joint_states",
            JointState(
                name=["opening", "lift"],
                position=[jaws.opening, jaws.lift_height],
                velocity=[jaws.speed, 0.0],
                effort=[jaws.effort, 0.0],
            ),
            "gripper",
        )
        for name, touch, image in zip(names, cycle.touch, cycle.images, strict=True):
            height, width = image.pixels.shape
            self.send(
                f"{name}/image",
                Image(
                    height=height,
                    width=width,
                    encoding="mono8",
                    step=width,
                    data=array("B", image.pixels.tobytes()),
                ),
                f"{name}_camera",
                touch.age,
            )
            # otherwise the force is unknown; touch.status gives the reason
            if touch.traction is not None:
                message = WrenchStamped()
                values = iter(map(float, touch.traction.wrench))
                for part in (message.wrench.force, message.wrench.torque):
                    part.x = next(values)
                    part.y = next(values)
                    part.z = next(values)
                self.send(f"{name}/wrench", message, f"{name}_sensor", touch.age)
            if touch.surface is not None:
                x, y = np.meshgrid(touch.surface.x, touch.surface.y)
                points = np.stack([x, y, touch.surface.z], axis=-1).reshape(-1, 3).astype("<f4")
                cloud = PointCloud2(
                    height=1,
                    width=len(points),
                    point_step=12,
                    row_step=points.nbytes,
                    is_dense=True,
                )
                cloud.fields = [
                    PointField(name=axis, offset=4 * k, datatype=PointField.FLOAT32, count=1)
                    for k, axis in enumerate("xyz")
                ]
                cloud.data = array("B", points.tobytes())
                self.send(f"{name}/membrane", cloud, f"{name}_sensor", touch.age)

    def grasp(self):
        design = mjtactile.load_sensor(self.wanted["sensor"])
        with mjtactile.open_session(
            self.wanted["rig"], design, object_name=self.wanted["object"]
        ) as session:
            session.take_references()
            names = [finger.name for finger in session.rig.fingers]
            return session.run(
                mjtactile.load_controller(self.wanted["controller"]),
                time_limit=60.0,
                on_cycle=lambda cycle: self.publish(names, cycle),
            )


if __name__ == "__main__":
    rclpy.init()
    print(TouchNode().grasp().phase)
    rclpy.shutdown()
