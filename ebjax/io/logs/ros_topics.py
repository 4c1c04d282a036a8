"""Chooses among a bag's topics: the images, their CameraInfo, depth, odometry, ground truth, IMU, and tf."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from ebjax.io.logs.bag import Bag
from ebjax.io.logs.bag_index import Channel, topic_name
from ebjax.io.logs.ros_depth import MILLIMETRES
from ebjax.io.logs.ros_message import (
    CAMERA_INFO,
    COMPRESSED,
    HEAD,
    IMAGE,
    IMU,
    ODOMETRY,
    POSES,
    TF,
    Image,
    camera_info_from,
    image_from,
    orientation_from,
)

Message = TypeVar("Message")
ROLES = {
    "image": (IMAGE, COMPRESSED),
    "depth": (IMAGE, COMPRESSED),
    "camera_info": (CAMERA_INFO,),
    "odometry": (ODOMETRY,),
    "truth": POSES,
    "imu": (IMU,),
}
NO_PICTURE = ("disparity", "confidence", "mask", "thermal")
INFRARED = ("infra", "/ir/", "ir_image", "/ir")
TRANSPORTS = ("/compressed", "/compressedDepth")
TRUTH = ("truth", "/gt")
NEARLY = 0.9


@dataclass(frozen=True)
class Topics:
    """The channels to read, None where there is none; `notes` says what else could have been."""

    image: int
    depth: int | None
    camera_info: int | None
    depth_info: int | None
    odometry: int | None
    truth: int | None
    imu: int | None
    tf: tuple[int, ...]
    frames: Mapping[int, str]
    notes: tuple[str, ...]


def _base(topic: str) -> str:
    """An image topic without its transport: /camera/image/compressed -> /camera/image."""
    return next((topic.removesuffix(end) for end in TRANSPORTS if topic.endswith(end)), topic)


def _is_depth(channel: Channel, encoding: str) -> bool:
    if "compresseddepth" in encoding.lower() or channel.topic.endswith("/compressedDepth"):
        return True
    stored, name = encoding.partition(";")[0].strip(), channel.topic.lower()
    if any(word in name for word in (*NO_PICTURE, *INFRARED)):
        return False
    return stored in ("16UC1", "32FC1") or (stored in MILLIMETRES and "depth" in name)


class _Chooser:
    def __init__(self, bag: Bag, wanted: Mapping[str, str]):
        self.bag, self.wanted, self.notes = bag, wanted, list[str]()
        self.counts = {k: bag.count(k) for k in range(len(bag.channels))}
        self.frames, self.encodings = dict[int, str](), dict[int, str]()
        for k in self.of(IMAGE, COMPRESSED):
            head = self.head(k)
            if head is None:
                self.notes.append(f"{bag.path}: {bag.channels[k].topic} is not used: its messages cannot be read")
                self.counts[k] = 0
            else:
                self.frames[k], self.encodings[k] = head.header.frame_id, head.encoding

    def head(self, channel: int) -> Image | None:
        """The head of an image topic."""
        described = self.bag.channels[channel]
        return self.first(channel, HEAD, lambda content: image_from(content, described.encoding, described.type))

    def first(self, channel: int, limit: int | None, read: Callable[[bytes], Message]) -> Message | None:
        """A topic's first message, or another where that is damaged; None where these are too."""
        rows = self.bag.rows(channel)
        for row in rows[[0, len(rows) // 2, -1]].tolist():
            try:
                return read(self.bag.read(row, limit))
            except ValueError:
                continue
        return None

    def topic(self, channel: int) -> str:
        return self.bag.channels[channel].topic

    def of(self, *types: str) -> list[int]:
        """The channels of some types that have messages."""
        channels = enumerate(self.bag.channels)
        return [k for k, c in channels if c.type in types and c.encoding in ("cdr", "ros1") and self.counts[k]]

    def given(self, role: str) -> int | None:
        """The channel that the caller names for a role."""
        if role not in self.wanted:
            return None
        topic, found = topic_name(self.wanted[role]), self.of(*ROLES[role])
        for k in found:
            if self.topic(k) == topic:
                return k
        there = ", ".join(sorted(self.topic(k) for k in found)) or "none"
        raise ValueError(
            f"{self.bag.path}: the topic {topic}, given as {role}, has no messages of {' or '.join(ROLES[role])}; "
            f"such topics are: {there}"
        )

    def info_beside(self, image: int) -> int | None:
        """The CameraInfo beside an image topic."""
        base = _base(self.topic(image))
        for name in (f"{base.rpartition('/')[0]}/camera_info", f"{base}/camera_info"):
            for k in self.of(CAMERA_INFO):
                if self.topic(k) == name:
                    return k
        return None

    def info_of(self, image: int) -> int | None:
        """The CameraInfo beside an image topic; else the only one of the bag, if it is of the same frame."""
        beside, infos = self.info_beside(image), self.of(CAMERA_INFO)
        if beside is not None or len(infos) != 1:
            return beside
        encoding = self.bag.channels[infos[0]].encoding
        info = self.first(infos[0], None, lambda content: camera_info_from(content, encoding))
        return infos[0] if info is not None and info.header.frame_id == self.frames[image] != "" else None

    def one_each(self, channels: Iterable[int]) -> list[int]:
        """One channel of each image: the raw one, unless the compressed one has more messages."""
        kept: dict[str, int] = {}
        for k in sorted(channels, key=lambda k: self.bag.channels[k].type != IMAGE):
            best = kept.setdefault(_base(self.topic(k)), k)
            if self.counts[best] < NEARLY * self.counts[k]:
                kept[_base(self.topic(k))] = k
        return list(kept.values())

    def say(self, role: str, chosen: int, others: Iterable[int]) -> None:
        rest = sorted({self.topic(k) for k in others if k != chosen})
        more = f"; others are {', '.join(rest)}" if rest else ""
        self.notes.append(f"{self.bag.path}: {role} from {self.topic(chosen)}, {self.counts[chosen]} messages{more}")

    def image(self) -> int:
        images = [k for k in self.encodings if not _is_depth(self.bag.channels[k], self.encodings[k])]
        chosen = self.given("image")
        if chosen is None:
            if not images:
                raise ValueError(self._no_images())

            def rank(k: int) -> tuple:
                name = self.topic(k).lower()
                is_odd = any(word in name for word in ("depth", *NO_PICTURE, *INFRARED))
                is_grey = self.encodings[k].partition(";")[0].strip() in ("mono8", "mono16", "8UC1", "16UC1", "32FC1")
                return is_odd, self.info_beside(k) is None, -self.counts[k], is_grey, name

            chosen = min(self.one_each(images), key=rank)
        self.say("images", chosen, images)
        return chosen

    def _no_images(self) -> str:
        named = [c.topic for c in self.bag.channels if c.type in (IMAGE, COMPRESSED)]
        if not len(self.bag.channel):
            what = "the bag has no messages"
        elif named:
            what = "its image topics have no colour or grey images that can be read"
        else:
            what = "no topic has images (sensor_msgs/Image or CompressedImage)"
        there = "; ".join(self.bag.contents()) or "none"
        return f"{self.bag.path}: {what}; record the camera too, or give another file. Topics: {there}"

    def depth(self, image: int) -> int | None:
        depths = [k for k in self.encodings if _is_depth(self.bag.channels[k], self.encodings[k])]
        chosen = self.given("depth")
        if chosen is None:
            if not depths:
                return None
            frame = self.frames[image]
            chosen = min(self.one_each(depths), key=lambda k: (self.frames[k] != frame, -self.counts[k], self.topic(k)))
        self.say("depth", chosen, depths)
        return chosen

    def odometry(self) -> int | None:
        found = self.of(ODOMETRY)
        chosen = self.given("odometry")
        if chosen is None:
            usable = [k for k in found if not self._like_truth(k)]
            if not usable:
                return None

            def rank(k: int) -> tuple:
                name = self.topic(k).lower()
                last = name.rsplit("/", 1)[-1]
                kind = 0 if name == "/odom" else 1 if last == "odom" else 2 if "odom" in name else 3
                return kind, -self.counts[k], name

            chosen = min(usable, key=rank)
        self.say("odometry", chosen, found)
        return chosen

    def truth(self) -> int | None:
        """Only where it is named; a topic that looks like it is told of."""
        chosen = self.given("truth")
        if chosen is None and (like := sorted(self.topic(k) for k in self.of(*POSES) if self._like_truth(k))):
            self.notes.append(f"{self.bag.path}: no truth is read; --topics.truth {like[0]} reads it from there")
        return chosen

    def _like_truth(self, channel: int) -> bool:
        return any(word in self.topic(channel) for word in TRUTH)

    def imu(self) -> int | None:
        """The IMU that says how it is turned; most say only how they are pushed."""
        found = self.of(IMU)
        chosen = self.given("imu")
        if chosen is None:
            turned = [k for k in found if self._is_turned(k)]
            if not turned:
                if found:
                    names = ", ".join(sorted(self.topic(k) for k in found))
                    self.notes.append(
                        f"{self.bag.path}: {names}: without orientation, so roll and pitch are not taken from there"
                    )
                return None
            chosen = min(turned, key=lambda k: (not self.topic(k).endswith("imu/data"), -self.counts[k], self.topic(k)))
        self.say("roll and pitch", chosen, found)
        return chosen

    def _is_turned(self, channel: int) -> bool:
        try:
            content = self.bag.read(int(self.bag.rows(channel)[0]))
            return orientation_from(content, self.bag.channels[channel].encoding) is not None
        except ValueError:
            return False


def choose(bag: Bag, wanted: Mapping[str, str]) -> Topics:
    """Chooses the topics to read.

    Args:
      bag: opened.
      wanted: role -> topic, for the roles of `ROLES`; the others are chosen by type, CameraInfo, count, and name.

    Raises:
      ValueError: an unknown role, a topic that is not there, or no images; names the topics that are there.
    """
    if unknown := sorted(set(wanted) - set(ROLES)):
        raise ValueError(f"topics: {unknown[0]!r} is no role; roles are {', '.join(ROLES)}")
    chooser = _Chooser(bag, wanted)
    image = chooser.image()
    depth, info = chooser.depth(image), chooser.given("camera_info")
    return Topics(
        image=image,
        depth=depth,
        camera_info=chooser.info_of(image) if info is None else info,
        depth_info=None if depth is None else chooser.info_of(depth),
        odometry=chooser.odometry(),
        truth=chooser.truth(),
        imu=chooser.imu(),
        tf=tuple(chooser.of(*TF)),
        frames=chooser.frames,
        notes=tuple(chooser.notes),
    )
