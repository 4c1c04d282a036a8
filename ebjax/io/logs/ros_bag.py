"""ROS bags as a log: ROS 1 .bag, ROS 2 .db3 and .mcap, files or folders; needs no ROS.

Opening reads where the messages are, the images' stamps, and all of the small topics; images are read when asked for.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.logs.bag import Bag, open_files
from ebjax.io.logs.log import Images, Log
from ebjax.io.logs.mount_options import MOUNT
from ebjax.io.logs.ros_camera_info import calibration_from
from ebjax.io.logs.ros_clock import clock
from ebjax.io.logs.ros_collect import Collected, collect
from ebjax.io.logs.ros_images import bits_in_use, colour_from, images_of
from ebjax.io.logs.ros_imu import leant_by_imu
from ebjax.io.logs.ros_mount import mount
from ebjax.io.logs.ros_odometry import odometry_from_tf, trajectory_of_base
from ebjax.io.logs.ros_register import depth_decoder
from ebjax.io.logs.ros_tf import TfTree
from ebjax.io.logs.ros_topics import Topics, choose
from ebjax.io.trajectory import Trajectory

GIVE = {
    "camera": "no CameraInfo with values; give --camera FILE",
    "mount": f"tf does not join the camera with base_link; {MOUNT}",
    "odometry": "no odometry topic with poses, and no odom frame in tf: the run is measured by the floor alone",
    "depth": "no depth topic: the floor is metric without depth",
}


def bag_contents(path: str | Path) -> tuple[str, ...]:
    """The topics of a bag, a line each: name, type, how many messages.

    Raises:
      ValueError: no such file, or not a bag; names it.
    """
    return open_files(path).contents()


@dataclass
class _Opening:
    """A bag while it is opened, and what is said of it on the way."""

    bag: Bag
    topics: Topics
    found: Collected
    by_receipt: bool
    tree: TfTree
    notes: list[str]
    missing: dict[str, str]

    def name(self, channel: int) -> str:
        return f"{self.bag.channels[channel].topic} of {self.bag.path}"

    def camera(self, base_from_camera: np.ndarray | None) -> Calibration | None:
        camera, channel = None, self.topics.camera_info
        try:
            if channel is not None:
                topic, images = self.bag.channels[channel].topic, self.bag.channels[self.topics.image].topic
                camera = calibration_from(self.found.camera_infos(channel), topic, self.name(channel), images)
        except ValueError as error:
            self.missing["camera"] = str(error)
        if base_from_camera is None:
            self.missing["mount"] = GIVE["mount"]
        if camera is not None:
            self.notes += camera.notes
            return dataclasses.replace(camera, base_from_camera=base_from_camera)
        self.missing.setdefault("camera", GIVE["camera"])
        return None

    def depth(self, base: str | None, camera: Calibration | None, times: np.ndarray) -> Images | None:
        if self.topics.depth is None:
            self.missing["depth"] = GIVE["depth"]
            return None
        try:
            decoder, said = depth_decoder(self.bag, self.found, self.topics, self.tree, base, camera, times)
        except ValueError as error:
            self.missing["depth"] = str(error)
            return None
        images, more = images_of(self.bag, self.found, self.topics.depth, self.by_receipt, decoder)
        self.notes += (*said, *more)
        return images

    def poses(self, channel: int, base: str | None) -> Trajectory | None:
        samples, frames = self.found.poses[channel], self.found.frames.get(channel, ("", ""))
        trajectory, said = trajectory_of_base(
            samples, frames, self.tree, base, name=self.name(channel), by_receipt=self.by_receipt
        )
        self.notes += said
        return trajectory

    def odometry(self, base: str | None) -> Trajectory | None:
        if self.topics.odometry is not None:
            odometry = self.poses(self.topics.odometry, base)
        else:
            odometry, said = odometry_from_tf(self.tree, base, f"/tf of {self.bag.path}")
            self.notes += said
        if odometry is None:
            self.missing["odometry"] = GIVE["odometry"]
        elif self.topics.imu is not None and len(self.found.poses[self.topics.imu]):
            samples, (_, frame) = self.found.poses[self.topics.imu], self.found.frames[self.topics.imu]
            imu, _ = samples.trajectory(self.name(self.topics.imu), self.by_receipt)
            odometry, said = leant_by_imu(odometry, imu, frame, self.tree, base)
            self.notes += said
        return odometry


def _times(bag: Bag, found: Collected, topics: Topics) -> dict[str, np.ndarray]:
    """Stamp and receipt of the messages of each topic that is used."""
    times = {}
    for channel in (topics.image, topics.depth):
        if channel is not None:
            table = found.rows_and_stamps(channel)
            times[bag.channels[channel].topic] = np.stack([table[:, 1], bag.time_ns[table[:, 0]]], axis=1)
    for channel in (topics.odometry, topics.truth, topics.imu):
        if channel is not None and len(found.poses[channel]):
            times[bag.channels[channel].topic] = found.poses[channel].times_ns()
    if topics.odometry is None and found.moving:
        times["/tf"] = np.concatenate([samples.times_ns() for samples in found.moving.values()])
    return times


def open_bag(path: str | Path, *, topics: Mapping[str, str] | None = None) -> Log:
    """Opens a ROS bag as a log.

    Args:
      path: a .bag, .db3 or .mcap, also cut off or packed with zstd, or the folder of a ROS 2 bag.
      topics: role -> topic, where another topic is to be used than the one that is found; the roles are image, depth,
        camera_info, odometry, truth, imu. Ground truth is read only if it is named.

    Raises:
      ValueError: no bag, no images in it, or a topic that is not there; names the file and the topics that are there.
    """
    bag = open_files(path)
    chosen = choose(bag, topics or {})
    found = collect(bag, chosen)
    by_receipt, notes = clock(bag.channels[chosen.image].topic, _times(bag, found, chosen))
    broken = [f"{topic}: {count} messages cannot be read" for topic, count in found.broken.items()]
    tree = TfTree(found.static, found.moving, by_receipt=by_receipt, path=str(path))
    notes = (*bag.notes, *chosen.notes, *broken, *notes, *tree.notes)
    opening = _Opening(bag, chosen, found, by_receipt, tree, list(notes), {})
    bits = bits_in_use(bag, chosen.image)
    colour, about_images = images_of(bag, found, chosen.image, by_receipt, partial(colour_from, bits=bits))
    if bits is not None:
        opening.notes.append(f"{opening.name(chosen.image)}: grey of 16 bits, of which {bits} are in use")
    base_from_camera, base, about_mount = mount(tree, chosen.frames[chosen.image], colour.timestamps)
    opening.notes += (*about_images, *about_mount)
    camera = opening.camera(base_from_camera)
    return Log(
        path=Path(path),
        kind=bag.kind,
        colour=colour,
        depth=opening.depth(base, camera, colour.timestamps),
        camera=camera,
        odometry=opening.odometry(base),
        truth=None if chosen.truth is None else opening.poses(chosen.truth, base),
        notes=tuple(opening.notes),
        contents=bag.contents(),
        base_from_camera=None if camera is not None else base_from_camera,
        missing=opening.missing,
    )
