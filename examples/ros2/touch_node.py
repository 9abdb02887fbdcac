"""Touch in ROS 2: a lifecycle node with a grasp as an action, and its wrenches, membranes, images,
jaws and frames as topics. The frames are those of `export --format rosbag2`.

In a Python that has ROS 2, mjtactile, and `mjtactile_msgs` (written by that export):

    python3 touch_node.py --ros-args -p rig:=my_gripper.toml
    ros2 lifecycle set /mjtactile configure && ros2 lifecycle set /mjtactile activate
    ros2 action send_goal --feedback /mjtactile/grasp mjtactile_msgs/action/Grasp \
        "{object: egg, controller: adaptive}"

With `publish_clock:=true` the simulated rig is the source of /clock and of all stamps. Otherwise
stamps are the times of the measurements on the node's clock, also with use_sim_time.
"""

from array import array

import numpy as np
import rclpy
from geometry_msgs.msg import TransformStamped, WrenchStamped
from mjtactile_msgs.action import Grasp
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.duration import Duration
from rclpy.executors import MultiThreadedExecutor
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2, PointField
from tf2_ros import StaticTransformBroadcaster, TransformBroadcaster

import mjtactile

DEFAULTS = {"rig": "sim", "sensor": "dense", "time_limit_s": 60.0, "publish_clock": False}


class TouchNode(LifecycleNode):
    def __init__(self):
        super().__init__("mjtactile")
        for name, value in DEFAULTS.items():
            self.declare_parameter(name, value)
        self.topics = {}
        self.server = None
        self.active = self.busy = False
        self.offset = None

    # -- lifecycle

    def on_configure(self, state):
        self.requested = {name: self.get_parameter(name).value for name in DEFAULTS}
        try:
            self.design = mjtactile.load_sensor(self.requested["sensor"])
        except mjtactile.InputError as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        self.moving = TransformBroadcaster(self)
        self.fixed = StaticTransformBroadcaster(self)
        self.server = ActionServer(
            self,
            Grasp,
            "~/grasp",
            self.grasp,
            goal_callback=self.accept,
            cancel_callback=lambda goal: CancelResponse.ACCEPT,
        )
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state):
        self.active = True
        return super().on_activate(state)

    def on_deactivate(self, state):
        self.active = False
        return super().on_deactivate(state)

    def on_cleanup(self, state):
        if self.server is not None:
            self.server.destroy()
        self.server = None
        return TransitionCallbackReturn.SUCCESS

    # -- messages

    def stamp(self, time):
        """Return the stamp of a time on the rig's clock, s."""
        if self.requested["publish_clock"]:
            return Time(nanoseconds=round(1e9 * time)).to_msg()
        return (self.offset + Duration(seconds=time)).to_msg()

    def send(self, topic, message, frame, time, qos=qos_profile_sensor_data):
        if frame is not None:
            message.header.frame_id = frame
            message.header.stamp = self.stamp(time)
        if topic not in self.topics:
            self.topics[topic] = self.create_publisher(type(message), topic, qos)
        self.topics[topic].publish(message)

    def transform(self, parent, child, p, R, time):
        message = TransformStamped()
        message.header.frame_id = parent
        message.header.stamp = self.stamp(time)
        message.child_frame_id = child
        vector(message.transform.translation, p)
        x, y, z, w = quaternion(R)
        q = message.transform.rotation
        q.x, q.y, q.z, q.w = x, y, z, w
        return message

    def start_cycle(self, now):
        """Set the relation of the rig's clock and that of ROS; `now` is on the rig's, s."""
        if self.requested["publish_clock"]:
            clock = Clock()
            clock.clock = self.stamp(now)
            self.send("/clock", clock, None, now, 10)
        else:
            self.offset = self.get_clock().now() - Duration(seconds=now)

    def publish_fixed(self, fingers, perceptions, time):
        """Send the start of the gripper, and each camera in its sensor."""
        sent = [self.transform("world", "gripper_start", np.zeros(3), np.eye(3), time)]
        for finger, pipeline in zip(fingers, perceptions, strict=True):
            flat = pipeline.state.flat
            camera = camera_of(finger)
            R, p = camera.pose(flat.R_SC, flat.p_SC)
            sent.append(
                self.transform(f"{finger.name}_sensor", f"{finger.name}_camera", p, R, time)
            )
        self.fixed.sendTransform(sent)

    def publish_frames(self, names, cycle):
        """Send the lift, and sensors that face the axis of the gripper, y up."""
        jaws = cycle.gripper
        time = jaws.time if np.isfinite(jaws.time) else cycle.time
        height = np.array([0.0, 0.0, jaws.lift_height])
        sent = [self.transform("gripper_start", "gripper", height, np.eye(3), time)]
        for k, name in enumerate(names):
            angle = np.pi + 2 * np.pi * k / len(names)
            out = np.array([np.cos(angle), np.sin(angle), 0.0])
            up = np.array([0.0, 0.0, 1.0])
            R = np.column_stack([np.cross(up, -out), up, -out])
            sent.append(
                self.transform("gripper", f"{name}_sensor", out * jaws.opening / 2, R, time)
            )
        self.moving.sendTransform(sent)
        joints = JointState(
            name=["opening", "lift"],
            position=[jaws.opening, jaws.lift_height],
            velocity=[jaws.speed, 0.0],
            effort=[jaws.effort, 0.0],
        )
        self.send("joint_states", joints, "gripper", time, 10)

    def publish(self, names, cycle, cameras):
        """Send all messages of a cycle; `cameras` are the effective ones of the fingers."""
        self.publish_frames(names, cycle)
        for name, touch, image, camera in zip(
            names, cycle.touch, cycle.images, cameras, strict=True
        ):
            frame = f"{name}_camera"
            self.send(f"{name}/image", image_message(image), frame, image.time)
            self.send(f"{name}/camera_info", camera_info(camera), frame, image.time)
            sensor = f"{name}_sensor"
            # otherwise the force is unknown; touch.status gives the reason
            if touch.traction is not None:
                message = WrenchStamped()
                vector(message.wrench.force, touch.traction.wrench[:3])
                vector(message.wrench.torque, touch.traction.wrench[3:])
                self.send(f"{name}/wrench", message, sensor, image.time)
            if touch.surface is not None:
                self.send(f"{name}/membrane", cloud(touch.surface), sensor, image.time)

    # -- action

    def accept(self, goal):
        return GoalResponse.ACCEPT if self.active and not self.busy else GoalResponse.REJECT

    def grasp(self, handle):
        """Run one grasp: feedback every cycle, and a retreat when it is canceled."""
        self.busy = True
        result = Grasp.Result()
        try:
            result.phase = self.run(handle)
            result.success = result.phase == "done"
        except mjtactile.MjtactileError as error:
            result.phase = "abort"
            result.message = " ".join(str(error).split())
        finally:
            self.busy = False
        if handle.is_cancel_requested:
            handle.canceled()
        elif result.success:
            handle.succeed()
        else:
            handle.abort()
        return result

    def run(self, handle):
        goal = handle.request
        controller = mjtactile.load_controller(goal.controller or "adaptive")
        options = {"object_name": goal.object or "egg"}
        with mjtactile.open_session(self.requested["rig"], self.design, **options) as session:
            session.take_references()
            fingers = session.rig.fingers
            names = [finger.name for finger in fingers]
            cameras = [camera_of(finger).camera for finger in fingers]
            self.start_cycle(session.rig.clock.now())
            self.publish_fixed(fingers, session.perceptions, session.rig.clock.now())

            def on_cycle(cycle):
                self.start_cycle(session.rig.clock.now())
                self.publish(names, cycle, cameras)
                feedback = Grasp.Feedback()
                feedback.phase = cycle.sent.phase
                feedback.force_normal = [touch.force_normal for touch in cycle.touch]
                handle.publish_feedback(feedback)
                if handle.is_cancel_requested or not self.active:
                    session.make_safe("the goal was canceled")

            limit = self.requested["time_limit_s"]
            return session.run(controller, time_limit=limit, on_cycle=on_cycle).phase


def camera_of(finger):
    """Return the camera without a glass that has the same image, with the measured lens."""
    design = finger.design
    if finger.calibration is not None:
        design = finger.calibration.used(design).design(design)
    return mjtactile.effective_camera(design)


def vector(message, values):
    message.x, message.y, message.z = map(float, values)


def quaternion(R):
    """Return x, y, z, w of a rotation (3, 3), from the eigenvector of its symmetric form."""
    (a, b, c), (d, e, f), (g, h, i) = R
    K = [
        [a - e - i, b + d, c + g, h - f],
        [b + d, e - a - i, f + h, c - g],
        [c + g, f + h, i - a - e, d - b],
        [h - f, c - g, d - b, a + e + i],
    ]
    q = np.linalg.eigh(K)[1][:, -1]
    return (q if q[3] >= 0 else -q).tolist()


def image_message(image):
    height, width = image.pixels.shape
    data = array("B", image.pixels.tobytes())
    return Image(height=height, width=width, encoding="mono8", step=width, data=data)


def camera_info(camera):
    P = np.column_stack([camera.K, np.zeros(3)])
    return CameraInfo(
        height=camera.height,
        width=camera.width,
        distortion_model=camera.distortion_model,
        d=list(camera.distortion),
        k=camera.K.ravel(),
        r=np.eye(3).ravel(),
        p=P.ravel(),
    )


def cloud(surface):
    x, y = np.meshgrid(surface.x, surface.y)
    points = np.stack([x, y, surface.z], axis=-1).reshape(-1, 3).astype("<f4")
    count = len(points)
    message = PointCloud2(height=1, width=count, point_step=12, row_step=12 * count, is_dense=True)
    message.fields = [
        PointField(name=axis, offset=4 * k, datatype=PointField.FLOAT32, count=1)
        for k, axis in enumerate("xyz")
    ]
    message.data = array("B", points.tobytes())
    return message


if __name__ == "__main__":
    rclpy.init()
    executor = (
        MultiThreadedExecutor()
    )  # a grasp runs concurrently with /clock, parameters and cancellation
    executor.add_node(TouchNode())
    executor.spin()
    rclpy.shutdown()
