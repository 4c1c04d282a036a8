"""Reads, in one pass over a bag, all of it but the images: their stamps, CameraInfo, poses, and tf."""

from array import array
from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Int64

from ebjax.io.logs.bag import Bag
from ebjax.io.logs.ros_message import (
    HEAD,
    IMU,
    POSES,
    CameraInfo,
    Cursor,
    camera_info_from,
    header_from,
    orientation_from,
    pose_from,
    transforms_from,
)
from ebjax.io.logs.ros_poses import PoseSamples
from ebjax.io.logs.ros_tf import Pair
from ebjax.io.logs.ros_topics import Topics

INFO_BODY = 12  # behind the encapsulation or sequence number, and the stamp


@dataclass
class Collected:
    """What was read, by channel.

    Attributes:
      stamps: row and stamp, ns, of each image.
      infos: the different CameraInfo messages, and how often each occurs.
      poses: of odometry and truth; of an IMU, poses without a place.
      frames: parent and child frame of those poses; of an IMU its own.
      static: tf that holds always.
      moving: tf that moves.
      broken: by topic, how many messages could not be read.
    """

    stamps: dict[int, array] = field(default_factory=lambda: defaultdict(lambda: array("q")))
    infos: dict[int, dict[bytes, tuple[CameraInfo, int]]] = field(default_factory=lambda: defaultdict(dict))
    poses: dict[int, PoseSamples] = field(default_factory=lambda: defaultdict(PoseSamples))
    frames: dict[int, Pair] = field(default_factory=dict)
    static: dict[Pair, PoseSamples] = field(default_factory=lambda: defaultdict(PoseSamples))
    moving: dict[Pair, PoseSamples] = field(default_factory=lambda: defaultdict(PoseSamples))
    broken: dict[str, int] = field(default_factory=lambda: defaultdict(int))

    def rows_and_stamps(self, channel: int) -> Int64[np.ndarray, "N 2"]:
        """Row and stamp of each image of a channel."""
        return np.array(self.stamps[channel], np.int64).reshape(-1, 2)

    def camera_infos(self, channel: int) -> list[tuple[CameraInfo, int]]:
        """The different messages of a CameraInfo channel, and how often each occurs."""
        return list(self.infos[channel].values())


def _take(found: Collected, topics: Topics, bag: Bag, channel: int, row: int, content: bytes) -> None:
    kind, encoding, received = bag.channels[channel].type, bag.channels[channel].encoding, int(bag.time_ns[row])
    if channel in (topics.image, topics.depth):
        found.stamps[channel].extend((row, header_from(Cursor(content, encoding)).stamp_ns))
    elif channel in (topics.camera_info, topics.depth_info):
        different = found.infos[channel]
        info, count = different.get(content[INFO_BODY:]) or (camera_info_from(content, encoding), 0)
        different[content[INFO_BODY:]] = (info, count + 1)
    elif kind == IMU:
        turned = orientation_from(content, encoding)
        if turned is not None:
            found.frames.setdefault(channel, ("", turned.header.frame_id))
            found.poses[channel].add(turned.header.stamp_ns, received, turned.translation, turned.quaternion)
    elif kind in POSES:
        pose = pose_from(content, encoding, kind)
        found.frames.setdefault(channel, (pose.header.frame_id, pose.child))
        found.poses[channel].add(pose.header.stamp_ns, received, pose.translation, pose.quaternion)
    else:
        table = found.static if bag.channels[channel].topic.endswith("tf_static") else found.moving
        for one in transforms_from(content, encoding):
            samples = table[one.header.frame_id, one.child]
            samples.add(one.header.stamp_ns, received, one.translation, one.quaternion)


def collect(bag: Bag, topics: Topics) -> Collected:
    """Reads the chosen topics; of images only the first bytes: most of an uncompressed bag is never read."""
    limits: dict[int, int | None] = {k: None for k in topics.tf}
    for channel in (topics.camera_info, topics.depth_info, topics.odometry, topics.truth, topics.imu):
        if channel is not None:
            limits[channel] = None
    for channel in (topics.image, topics.depth):
        if channel is not None:
            limits[channel] = HEAD
    found = Collected()
    for channel, row, content in bag.scan(limits):
        try:
            _take(found, topics, bag, channel, row, content)
        except ValueError:
            found.broken[bag.channels[channel].topic] += 1
    return found
