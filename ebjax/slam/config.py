"""How loops are searched, verified, believed and used: the settings of the engine."""

import dataclasses
from pathlib import Path
from typing import Literal

from ebjax.models.fast import Arithmetic
from ebjax.odometry.wheels import WheelErrors
from ebjax.slam.believe import BeliefConfig


@dataclasses.dataclass(frozen=True)
class MountConfig:
    """How far the camera's mount is trusted."""

    refine: Literal["tilt", "all", "none"] = "tilt"
    """Which of it is estimated with the run and put right where the floor contradicts it: pitch and roll, or height and
    x too (where depth, or wheels with their declared --odometry.scale-sigma, tell them)."""


@dataclasses.dataclass(frozen=True)
class PipelineConfig:
    """How loops are searched, verified and used."""

    descriptor: str = "floornet"
    """Global descriptor: floornet, rootsift-vlad, hog, joint (floor and whole image), or of a network whose weights are
    not ours netvlad, superpoint, resnet50 or vgg19 (flattened map), resnet50-pooled, vgg19-pooled; or your own,
    package.module:NAME, whose code is then run."""
    ranking: Literal["auto", "correlation", "cosine"] = "auto"
    """Ranking of candidates: the paper's cosine of global descriptors, or shift-maximised correlation of floor maps
    (floornet and rootsift-vlad only, and their default)."""
    extractor: str = "floornet"
    """Local features: floornet, rootsift (upright, on blobs), sift, orb, surf, or another network: superpoint, d2net,
    alike; or your own, package.module:NAME, whose code is then run."""
    weights: Path | None = None
    """Of a network: its .safetensors file, or a folder of them; None: $EBJAX_WEIGHTS or ~/.cache/ebjax/weights."""
    arithmetic: Arithmetic = "exact"
    """Of a network: float32 convolutions, the same by Winograd's algorithm (equal to rounding), or in part bfloat16."""
    keyframe_m: float = 0.15
    """A frame is looked at when the robot has moved so far since the last one, m."""
    keyframe_deg: float = 10.0
    """... or turned so far, degrees."""
    min_gap_s: float = 5.0
    """A view is compared with views at least so much earlier, s."""
    min_gap_m: float = 4.0
    """... and, in the same direction, at least so much path earlier, m."""
    verify: int = 2
    """Candidates of each view that are verified in each direction, the best that odometry does not rule out."""
    tolerance_m: float = 0.02
    """Largest distance of matching points on the floor, m."""
    kernel: str = "consensus"
    """How the pose graph survives false closures among those selected, as in `ebjax.posegraph.solve`: consensus,
    cauchy, none, huber, geman-mcclure, dcs, tls, gnc-tls, gnc-gm, pcm, or a function of your own, package.module:NAME,
    whose code is then run."""
    kernel_width: float | None = None
    """Width of that kernel, standard deviations; None is 1, and for those that cut off the 99.9 % point."""
    motion: Literal["wheels+floor", "floor", "wheels"] | None = None
    """What measures the robot's steps; None: wheels+floor where the run has odometry, else floor. With wheels alone the
    camera's mount and the images' clock are taken as they are given."""
    seed: int = 0
    """Of the vocabulary and of RANSAC."""
    believe: BeliefConfig = dataclasses.field(default_factory=BeliefConfig)
    odometry: WheelErrors = dataclasses.field(default_factory=WheelErrors)
    mount: MountConfig = dataclasses.field(default_factory=MountConfig)
