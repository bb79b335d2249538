"""A ROS 2 node (rclpy) that maps depth images and plans velocity commands with a bundle, and publishes what it knows.

ros2 run is not needed: python examples/ros2_node.py --ros-args -p bundle:=BUNDLE -p drive:=false

It subscribes to ``odom`` (nav_msgs/Odometry, twist in the base frame), ``joint_states`` (sensor_msgs/JointState, in
the order of legs FL, FR, RL, RR and joints hip, thigh, knee, angles as the bundle's robot counts them),
``foot_forces`` (std_msgs/Float64MultiArray, four numbers), ``wish`` (geometry_msgs/Twist, what the operator would
like) and the images and camera info of a depth camera. It publishes ``map/steppable`` (nav_msgs/OccupancyGrid),
``plan`` (visualization_msgs/MarkerArray), ``times/plan`` (std_msgs/Float64) and, with ``drive``, ``cmd_vel`` (a
Twist). Topics and messages are those of recordings of ``legtool replay``: one layout of a viewer shows both.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import Point, Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Float64, Float64MultiArray
from visualization_msgs.msg import Marker, MarkerArray

import legtool_runtime
from legtool_runtime.motion.planning.pilot import Pilot
from legtool_runtime.motion.planning.plan import Goal, Plan, PlannerSettings, planar_commands
from legtool_runtime.motion.planning.planner import Planner
from legtool_runtime.motion.tracker import StepTracker
from legtool_runtime.rotations import from_angles, rotation_of, yaw_of
from legtool_runtime.terrain import ElevationGrid, FootCostmap, foot_costmap

#: From an optical frame (x right, y down) to a body's that looks the same way (x ahead, y left).
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
#: The ground around a robot that starts is taken to be flat within this [m].
ASSUMED_FLAT_M = 0.9
#: Shares of the robot's weight with which a foot lands, and below which it lifts off.
LANDS, LIFTS = 0.08, 0.03


class Walker(Node):
    """Maps, plans, and tells what it knows."""

    def __init__(self) -> None:
        super().__init__("legtool")
        given = {
            "bundle": "bundle", "weight": 200.0, "drive": False, "camera_position": [0.28, 0.0, 0.06],
            "camera_pitch": 0.5, "horizon": 5,
        }  # fmt: skip
        held = {name: self.declare_parameter(name, value).value for name, value in given.items()}
        bundle = legtool_runtime.load_bundle(held["bundle"])
        self.robot, self.drive = bundle.robot, bool(held["drive"])
        instant, settings = bundle.motion.instant, PlannerSettings(horizon=held["horizon"])
        planner = Planner(bundle.motion, bundle.robot, commands=planar_commands(), settings=settings, instant=instant)
        planner.warm_up()
        self.pilot = Pilot(planner)
        on, off = LANDS * held["weight"], LIFTS * held["weight"]
        self.tracker = StepTracker(contact_on=on, contact_off=off, instant=instant)
        self.grid = ElevationGrid()
        self.mount = np.eye(4)
        self.mount[:3, :3] = from_angles(0.0, held["camera_pitch"], 0.0) @ OPTICAL
        self.mount[:3, 3] = held["camera_position"]
        self.intrinsics = self.costmap = self.odometry = self.joints = None
        self.wish, self.command = np.zeros(3), np.zeros(3)
        self.forces = np.full(4, held["weight"] / 4)
        self.began = False
        sensor = qos_profile_sensor_data
        self.create_subscription(Odometry, "odom", self.on_odometry, sensor)
        self.create_subscription(JointState, "joint_states", self.on_joints, sensor)
        self.create_subscription(Float64MultiArray, "foot_forces", self.on_forces, sensor)
        self.create_subscription(CameraInfo, "camera/depth/camera_info", self.on_camera, sensor)
        self.create_subscription(Image, "camera/depth/image", self.on_image, sensor)
        self.create_subscription(Twist, "wish", self.on_wish, 10)
        self.maps = self.create_publisher(OccupancyGrid, "map/steppable", 1)
        self.plans = self.create_publisher(MarkerArray, "plan", 1)
        self.times = self.create_publisher(Float64, "times/plan", 10)
        self.commands = self.create_publisher(Twist, "cmd_vel", 1)

    def on_wish(self, message: Any) -> None:
        """The operator's wish."""
        self.wish = np.array([message.linear.x, message.linear.y, message.angular.z])

    def on_joints(self, message: Any) -> None:
        """Joint angles."""
        self.joints = np.array(message.position[:12]).reshape(4, 3)

    def on_forces(self, message: Any) -> None:
        """Forces on the feet."""
        self.forces = np.array(message.data[:4])

    def on_camera(self, message: Any) -> None:
        """Intrinsics: focal lengths and centre."""
        self.intrinsics = np.array([message.k[0], message.k[4], message.k[2], message.k[5]])

    def on_image(self, message: Any) -> None:
        """Fuse a depth image into the map, and publish where a foot may stand."""
        if self.intrinsics is None or self.odometry is None:
            return
        kinds = {"32FC1": (np.float32, 1.0), "16UC1": (np.uint16, 1e-3)}
        if message.encoding not in kinds:
            self.get_logger().error(f"depth images are encoded as {message.encoding}, expected {' or '.join(kinds)}")
            return
        kind, scale = kinds[message.encoding]
        rows = np.frombuffer(bytes(message.data), dtype=np.uint8).reshape(message.height, message.step)
        pixels = np.ascontiguousarray(rows[:, : message.width * np.dtype(kind).itemsize]).view(kind)
        depth = np.where(pixels > 0, pixels * np.float32(scale), np.float32(np.nan)).astype(np.float32)
        time_s, position, rotation, _ = self.odometry
        self.grid.move_to(position[:2])
        if not self.began:
            ground = position[2] - self.robot.standing_height
            self.grid.assume_flat(position[:2], radius_m=ASSUMED_FLAT_M, height_m=ground)
            self.began = True
        base = np.eye(4)
        base[:3, :3], base[:3, 3] = rotation, position
        self.grid.update(depth, self.intrinsics, transform_camera_to_world=base @ self.mount, time_s=time_s)
        self.costmap = foot_costmap(self.grid.map())
        self.maps.publish(occupancy(self.costmap, message.header.stamp))

    def on_odometry(self, message: Any) -> None:
        """Follow the robot's steps; plan while all feet stand, or as a pair lands."""
        stamp, pose, twist = message.header.stamp, message.pose.pose, message.twist.twist
        q = pose.orientation
        position = np.array([pose.position.x, pose.position.y, pose.position.z])
        rotation = rotation_of([q.w, q.x, q.y, q.z])
        velocity = np.array([twist.linear.x, twist.linear.y, twist.angular.z])
        time_s = stamp.sec + 1e-9 * stamp.nanosec
        self.odometry = time_s, position, rotation, velocity
        if self.joints is None:
            return
        self.tracker.update(
            time_s, velocity=velocity, feet_base=self.robot.feet(self.joints), contact_force=self.forces,
            reference=self.command,
        )  # fmt: skip
        if not self.tracker.at_instant or self.costmap is None:
            return
        self.command = self.pilot.command(
            self.tracker.state(), self.costmap, position=position, rotation=rotation,
            goal=Goal.from_joystick(self.wish, position=position, heading=float(yaw_of(rotation))), time_s=time_s,
            steps=self.tracker.steps,
        )  # fmt: skip
        assert self.pilot.plan is not None
        self.plans.publish(markers(self.pilot.plan, position, stamp))
        self.times.publish(Float64(data=float(self.pilot.plan.planning_time_s)))
        if self.drive:
            told = Twist()
            told.linear.x, told.linear.y, told.angular.z = (float(value) for value in self.command)
            self.commands.publish(told)


def occupancy(costmap: FootCostmap, stamp: Any) -> Any:
    """Where feet may not stand: 100 unsafe, 0 safe, -1 never seen."""
    values = np.where(costmap.known, np.where(costmap.unsafe, 100, 0), -1).astype(np.int8)
    grid = OccupancyGrid()
    grid.header.stamp, grid.header.frame_id = stamp, "odom"
    grid.info.resolution = float(costmap.resolution_m)
    grid.info.width, grid.info.height = values.shape
    grid.info.origin.position.x, grid.info.origin.position.y = (float(value) for value in costmap.lower_corner)
    grid.info.origin.orientation.w = 1.0
    grid.data = values.T.ravel().tolist()
    return grid


def markers(plan: Plan, position: np.ndarray, stamp: Any) -> Any:
    """The way of the trunk as a line, and where its feet are to come down."""
    way = np.vstack([position[None], plan.position]) if len(plan.position) else np.empty((0, 3))
    out = MarkerArray()
    for number, (kind, points, size) in enumerate(
        ((Marker.LINE_STRIP, way, 0.01), (Marker.SPHERE_LIST, plan.touchdowns.reshape(-1, 3), 0.04))
    ):
        marker = Marker()
        marker.header.stamp, marker.header.frame_id = stamp, "odom"
        marker.ns, marker.id, marker.type = ("way", "touchdowns")[number], number, kind
        marker.action = Marker.ADD if len(points) else Marker.DELETE
        marker.pose.orientation.w = 1.0
        marker.scale.x = marker.scale.y = marker.scale.z = size
        marker.color.g, marker.color.a = 0.6, 1.0
        marker.points = [Point(x=float(x), y=float(y), z=float(z)) for x, y, z in points]
        out.markers.append(marker)
    return out


def main() -> None:
    """Run until it is shut down."""
    rclpy.init()
    node = Walker()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
