"""Writes the run of a TUM folder as a ROS bag, ROS 1 (lz4) or ROS 2 (mcap), frame by frame; needs rosbags, no ROS.

Topics: /camera/image_raw/compressed, /camera/depth/image_raw/compressedDepth, /camera/camera_info, /odom,
/ground_truth, /tf (odom -> base_link) and /tf_static (base_link -> camera_optical_frame). The images' files are copied
as they are; every message is stamped and received at its row's time.
"""

import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.logs.bag_index import EXTRA
from ebjax.io.logs.camera import calibration_of
from ebjax.io.logs.log import Log
from ebjax.io.logs.tum_folder import open_tum_folder
from ebjax.io.poses import quaternion_from_rotation

BagKind = Literal["bag", "mcap"]
BASE, CAMERA, ODOM, WORLD = "base_link", "camera_optical_frame", "odom", "world"
IMAGE, DEPTH, INFO = "/camera/image_raw/compressed", "/camera/depth/image_raw/compressedDepth", "/camera/camera_info"
COMPRESSED, ODOMETRY, TF = "sensor_msgs/msg/CompressedImage", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
CODECS = {".jpg": "jpeg", ".jpeg": "jpeg", ".png": "png"}
DEPTH_HEAD = struct.pack("<iff", 0, 0.0, 0.0)
MILLIMETRES = 1000.0


def require_rosbags() -> None:
    """Raises ValueError, with the remedy, where rosbags or lz4 is missing."""
    try:
        import lz4.frame  # noqa: F401
        import rosbags  # noqa: F401
    except ImportError as error:
        raise ValueError(f"writing bags needs {error.name}: {EXTRA}") from None


def write_bag(path: str | Path, folder: str | Path, kind: BagKind) -> None:
    """Writes a bag, whole or not at all.

    Args:
      path: of the bag, one file.
      folder: the run, in TUM layout.
      kind: bag is ROS 1, mcap is ROS 2.

    Raises:
      ValueError: rosbags is missing, or the folder has no camera.json, images other than JPEG and PNG, or depth other
        than PNG in millimetres; names the file and the remedy.
    """
    require_rosbags()
    path, log = Path(path), open_tum_folder(folder)
    path.parent.mkdir(parents=True, exist_ok=True)
    if (camera := calibration_of(log)) is None:
        raise ValueError(f"{folder}: {log.missing['camera']}")
    if log.colour.fitting((camera.width, camera.height)) is not log.colour:
        raise ValueError(
            f"{folder}: its images must be turned as EXIF asks, which a bag cannot tell; "
            f"write them so: python -m ebjax.logs {folder} --out FOLDER"
        )
    depth_files = _depth_files(log, camera)
    with tempfile.TemporaryDirectory(prefix=f".{path.name}.", suffix=".partial", dir=path.parent) as temporary:
        bag = _Bag(Path(temporary), kind)
        with bag.writer:
            bag.static_tf(log.colour.timestamps[0], camera)
            for time, _, what, row in _in_time_order(log):
                if what == "image":
                    bag.image(time, log.colour.files[row])
                    bag.info(time, camera)
                elif what == "depth":
                    bag.depth(time, depth_files[row])
                elif what == "odometry" and log.odometry is not None:
                    bag.odometry("/odom", time, ODOM, log.odometry.poses[row])
                    bag.tf("/tf", time, ODOM, BASE, log.odometry.poses[row])
                elif log.truth is not None:
                    bag.odometry("/ground_truth", time, WORLD, log.truth.poses[row])
        bag.file.replace(path)


def _depth_files(log: Log, camera: Calibration) -> tuple[Path, ...]:
    if log.depth is None:
        return ()
    files = log.depth.files
    if camera.depth_scale != MILLIMETRES:
        raise ValueError(
            f"{log.path / 'camera.json'}: 'depth_scale' is {camera.depth_scale}; a bag has depth in millimetres: store "
            "the images so, with depth_scale 1000"
        )
    if wrong := next((file for file in files if file.suffix.lower() != ".png"), None):
        raise ValueError(f"{wrong}: a bag has depth as PNG; store it so")
    return files


def _in_time_order(log: Log) -> Iterator[tuple[float, int, str, int]]:
    """(time, order at that time, what, row) of everything in a run: poses before the images that were taken there."""
    parts = (("odometry", log.odometry), ("truth", log.truth), ("image", log.colour), ("depth", log.depth))
    rows = [
        (float(time), order, what, row)
        for order, (what, part) in enumerate(parts)
        if part is not None
        for row, time in enumerate(part.timestamps)
    ]
    yield from sorted(rows)


class _Bag:
    """A bag that is being written in a folder of its own: `file` in the end."""

    def __init__(self, folder: Path, kind: BagKind):
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.is_ros1 = kind == "bag"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.is_ros1 else Stores.ROS2_HUMBLE)
        self.connections: dict[str, Any] = {}
        self.writer: Any
        if self.is_ros1:
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
            self.file = folder / "run.bag"
            self.writer = rosbag1.Writer(self.file)
            self.writer.set_compression(rosbag1.Writer.CompressionFormat.LZ4)
        else:
            self.file = folder / "run" / "run.mcap"
            self.writer = rosbag2.Writer(folder / "run", version=9, storage_plugin=rosbag2.StoragePlugin.MCAP)

    def static_tf(self, time: float, camera: Calibration) -> None:
        """Where the camera sits; late subscribers get it too."""
        assert camera.base_from_camera is not None
        self.tf("/tf_static", time, BASE, CAMERA, camera.base_from_camera)

    def image(self, time: float, file: Path) -> None:
        """A colour image's file."""
        codec = CODECS.get(file.suffix.lower())
        if codec is None:
            raise ValueError(f"{file}: a bag has images as JPEG or PNG; store it so")
        content = np.frombuffer(file.read_bytes(), np.uint8)
        layout = f"rgb8; {codec} compressed bgr8"
        self._write(IMAGE, COMPRESSED, time, self._header(time, CAMERA), layout, content)

    def depth(self, time: float, file: Path) -> None:
        """A depth image's PNG behind the 12 bytes of compressedDepth."""
        content = np.frombuffer(DEPTH_HEAD + file.read_bytes(), np.uint8)
        layout = "16UC1; compressedDepth png"
        self._write(DEPTH, COMPRESSED, time, self._header(time, CAMERA), layout, content)

    def info(self, time: float, camera: Calibration) -> None:
        """K and the lens of the raw image; P is K, without distortion."""
        is_pinhole = camera.distortion_model == "pinhole"
        model = "plumb_bob" if is_pinhole else camera.distortion_model
        lens = np.zeros(5) if is_pinhole else np.array(camera.distortion, np.float64)
        k = camera.intrinsics.astype(np.float64)
        p = np.concatenate([k, np.zeros((3, 1))], axis=1)
        region = self._make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
        fields = camera.height, camera.width, model, lens, k.ravel(), np.eye(3).ravel(), p.ravel(), 0, 0, region
        self._write(INFO, "sensor_msgs/msg/CameraInfo", time, self._header(time, CAMERA), *fields)

    def odometry(self, topic: str, time: float, parent: str, pose: Float[np.ndarray, "4 4"]) -> None:
        """The base's pose in a frame; velocities and covariances stay 0."""
        still = self._make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        at = self._make("geometry_msgs/msg/Point", *map(float, pose[:3, 3]))
        pose_of = self._make("geometry_msgs/msg/Pose", at, self._quaternion(pose))
        pose_of = self._make("geometry_msgs/msg/PoseWithCovariance", pose_of, np.zeros(36))
        twist = self._make("geometry_msgs/msg/Twist", still, still)
        twist = self._make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36))
        self._write(topic, ODOMETRY, time, self._header(time, parent), BASE, pose_of, twist)

    def tf(self, topic: str, time: float, parent: str, child: str, pose: Float[np.ndarray, "4 4"]) -> None:
        """One transform, parent_from_child."""
        move = self._make("geometry_msgs/msg/Vector3", *map(float, pose[:3, 3]))
        transform = self._make("geometry_msgs/msg/Transform", move, self._quaternion(pose))
        stamped = self._make("geometry_msgs/msg/TransformStamped", self._header(time, parent), child, transform)
        self._write(topic, TF, time, [stamped])

    def _make(self, name: str, *fields: Any) -> Any:
        return self.store.types[name](*fields)

    def _quaternion(self, pose: Float[np.ndarray, "4 4"]) -> Any:
        w, x, y, z = map(float, quaternion_from_rotation(pose[None, :3, :3])[0])
        return self._make("geometry_msgs/msg/Quaternion", x, y, z, w)

    def _header(self, time: float, frame: str) -> Any:
        stamp = self._make("builtin_interfaces/msg/Time", *divmod(round(time * 1e9), 10**9))
        return self._make("std_msgs/msg/Header", *([0] if self.is_ros1 else []), stamp, frame)

    def _write(self, topic: str, kind: str, time: float, *fields: Any) -> None:
        if topic not in self.connections:
            self.connections[topic] = self._connect(topic, kind)
        message = self._make(kind, *fields)
        content = (self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr)(message, kind)
        self.writer.write(self.connections[topic], round(time * 1e9), content)

    def _connect(self, topic: str, kind: str) -> Any:
        options: dict[str, Any] = {}
        if topic == "/tf_static":
            options = {"latching": 1} if self.is_ros1 else {"offered_qos_profiles": [_latched()]}
        return self.writer.add_connection(topic, kind, typestore=self.store, **options)


def _latched() -> Any:
    """ROS 2's quality of service for a topic that late subscribers get too."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    forever = QosTime(2147483647, 4294967295)
    kept = QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL
    return Qos(*kept, forever, forever, QosLiveliness.AUTOMATIC, forever, False)
