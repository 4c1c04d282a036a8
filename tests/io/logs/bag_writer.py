"""Writes small bags of every kind with rosbags' writers."""

import struct
from contextlib import AbstractContextManager

import cv2
import numpy as np

from ebjax.io.logs import rvl

KINDS = ("ros1", "ros1-lz4", "ros1-bz2", "sqlite3", "sqlite3-message", "mcap", "mcap-storage", "mcap-file")
K = [50.0, 0, 15.5, 0, 50.0, 11.5, 0, 0, 1]
P = [48.0, 0, 15, 0, 0, 48.0, 11, 0, 0, 0, 1, 0]
OPTICAL = (0.5, -0.5, 0.5, -0.5)  # wxyz -> a camera that looks ahead


class BagWriter(AbstractContextManager):
    """Writes messages; `path` is the bag."""

    def __init__(self, folder, kind, name="run"):
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.kind, self.is_ros1 = kind, kind.startswith("ros1")
        self.path = folder / (f"{name}.bag" if self.is_ros1 else name)
        self.store = get_typestore(Stores.ROS1_NOETIC if self.is_ros1 else Stores.ROS2_HUMBLE)
        if self.is_ros1:
            text = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
            self.store.register(get_types_from_msg(text, "tf/msg/tfMessage"))
        self.writer = self._writer()
        self.writer.open()
        self.connections = {}

    def _writer(self):
        from rosbags import rosbag1, rosbag2

        storage, _, packed = self.kind.partition("-")
        if self.is_ros1:
            writer = rosbag1.Writer(self.path)
            if packed:
                writer.set_compression(rosbag1.Writer.CompressionFormat[packed.upper()])
            return writer
        writer = rosbag2.Writer(self.path, version=9, storage_plugin=rosbag2.StoragePlugin[storage.upper()])
        if packed:
            writer.set_compression(rosbag2.CompressionMode[packed.upper()], rosbag2.CompressionFormat.ZSTD)
        return writer

    def __exit__(self, *_):
        self.writer.close()

    def make(self, name, *fields):
        return self.store.types[name](*fields)

    def header(self, stamp, frame):
        ns = round(stamp * 1e9)
        time = self.make("builtin_interfaces/msg/Time", ns // 10**9, ns % 10**9)
        return self.make("std_msgs/msg/Header", *([0] if self.is_ros1 else []), time, frame)

    def write(self, topic, kind, message, received):
        key = topic, kind
        if key not in self.connections:
            self.connections[key] = self.writer.add_connection(topic, kind, typestore=self.store)
        serialize = self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr
        self.writer.write(self.connections[key], round(received * 1e9), serialize(message, kind))

    def raw(self, topic, stamp, pixels, encoding, frame="camera_optical", received=None, padding=0, big=False):
        pixels = np.ascontiguousarray(pixels)
        height = pixels.shape[0] * 2 // 3 if encoding == "nv12" else pixels.shape[0]
        rows = pixels.reshape(pixels.shape[0], -1).view(np.uint8)
        rows = np.pad(rows, ((0, 0), (0, padding)))
        fields = height, pixels.shape[1], encoding, int(big), rows.shape[1], rows.reshape(-1)
        message = self.make("sensor_msgs/msg/Image", self.header(stamp, frame), *fields)
        self.write(topic, "sensor_msgs/msg/Image", message, stamp if received is None else received)

    def compressed(self, topic, stamp, data, layout, frame="camera_optical", received=None):
        data = np.frombuffer(bytes(data), np.uint8)
        message = self.make("sensor_msgs/msg/CompressedImage", self.header(stamp, frame), layout, data)
        self.write(topic, "sensor_msgs/msg/CompressedImage", message, stamp if received is None else received)

    def info(self, topic, stamp, size=(32, 24), model="plumb_bob", D=(), k=K, p=P, binning=(0, 0), roi=(0, 0, 0, 0),
             frame="camera_optical"):  # fmt: skip
        x, y, width, height = roi
        roi = self.make("sensor_msgs/msg/RegionOfInterest", x, y, height, width, False)
        arrays = [np.array(values, np.float64) for values in (D, k, np.eye(3).ravel(), p)]
        fields = (size[1], size[0], model, *arrays, *binning, roi)
        message = self.make("sensor_msgs/msg/CameraInfo", self.header(stamp, frame), *fields)
        self.write(topic, "sensor_msgs/msg/CameraInfo", message, stamp)

    def pose(self, translation, quaternion):
        w, x, y, z = quaternion
        return self.make("geometry_msgs/msg/Point", *translation), self.make("geometry_msgs/msg/Quaternion", x, y, z, w)

    def odometry(self, topic, stamp, translation, yaw=0.0, child="base_link", received=None, quaternion=None):
        quaternion = quaternion or (np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
        vector = self.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        pose = self.make("geometry_msgs/msg/Pose", *self.pose(translation, quaternion))
        pose = self.make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))
        twist = self.make("geometry_msgs/msg/Twist", vector, vector)
        twist = self.make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36))
        message = self.make("nav_msgs/msg/Odometry", self.header(stamp, "odom"), child, pose, twist)
        self.write(topic, "nav_msgs/msg/Odometry", message, stamp if received is None else received)

    def imu(self, topic, stamp, quaternion, frame="imu_link", known=True):
        w, x, y, z = quaternion
        turned, still = (
            self.make("geometry_msgs/msg/Quaternion", x, y, z, w),
            self.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 9.81),
        )
        covariance = np.zeros(9) if known else np.array([-1.0, *np.zeros(8)])
        fields = turned, covariance, still, np.zeros(9), still, np.zeros(9)
        message = self.make("sensor_msgs/msg/Imu", self.header(stamp, frame), *fields)
        self.write(topic, "sensor_msgs/msg/Imu", message, stamp)

    def pose_stamped(self, topic, stamp, translation, yaw=0.0):
        pose = self.make("geometry_msgs/msg/Pose", *self.pose(translation, (np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))))
        message = self.make("geometry_msgs/msg/PoseStamped", self.header(stamp, "map"), pose)
        self.write(topic, "geometry_msgs/msg/PoseStamped", message, stamp)

    def tf(self, stamp, *links, static=False, received=None, kind="tf2_msgs/msg/TFMessage"):
        """Links are (parent, child, translation, quaternion wxyz)."""
        transforms = []
        for parent, child, translation, quaternion in links:
            _, rotation = self.pose(translation, quaternion)
            move = self.make("geometry_msgs/msg/Vector3", *map(float, translation))
            transform = self.make("geometry_msgs/msg/Transform", move, rotation)
            header = self.header(stamp, parent)
            transforms.append(self.make("geometry_msgs/msg/TransformStamped", header, child, transform))
        topic = "/tf_static" if static else "/tf"
        self.write(topic, kind, self.make(kind, transforms), stamp if received is None else received)


def jpeg(rgb):
    return cv2.imencode(".jpg", rgb[:, :, ::-1])[1].tobytes()


def png(values):
    return cv2.imencode(".png", values)[1].tobytes()


def compressed_depth(depth_m, encoding, codec):
    """The bytes of compressedDepth: 32FC1 is quantised as ROS does, with its usual parameters."""
    if encoding == "16UC1":
        values, A, B = np.round(depth_m * 1000).astype(np.uint16), 0.0, 0.0
    else:
        quantum, farthest = 100.0, 10.0
        A = quantum * (quantum + 1)
        B = 1 - A / farthest
        safe = np.where(depth_m > 0, depth_m, 1)
        values = np.where(depth_m > 0, A / safe + B, 0).astype(np.uint16)
    head = struct.pack("<iff", 0, A, B)
    if codec == "png":
        return head + png(values)
    return head + struct.pack("<II", depth_m.shape[1], depth_m.shape[0]) + rvl.encode(values)


def picture(k, height=24, width=32):
    """A smooth picture that JPEG keeps to a few levels: red grows with k, blue is high."""
    across = np.linspace(0, 60, width)[None].repeat(height, 0)
    return np.stack([10 * k + across / 4, 40 + across, np.full((height, width), 200.0)], 2).astype(np.uint8)


def write_run(bag, count=8, start=1000.0):
    """A run: pictures and depth at 5 Hz, CameraInfo, odometry at 20 Hz, tf of a camera that looks ahead."""
    for k in range(count):
        time = start + k * 0.2
        for j in range(4):
            bag.odometry("/odom", time + j * 0.05, (k + j / 4.0, 0.0, 0.0), received=time + j * 0.05 + 0.01)
        bag.info("/camera/color/camera_info", time)
        bag.raw("/camera/color/image_raw", time, picture(k), "rgb8", received=time + 0.03)
        depth = np.full((24, 32), 1000 + k, np.uint16)
        depth[0] = 0
        bag.raw("/camera/depth/image_raw", time, depth, "16UC1", received=time + 0.04)
    bag.tf(start, ("base_link", "camera_link", (0.2, 0, 0.5), (1, 0, 0, 0)), static=True)
    bag.tf(start + 1, ("/camera_link", "/camera_optical", (0, 0, 0), OPTICAL), static=True)
