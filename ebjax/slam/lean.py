"""Whether the roll and pitch that odometry reports are the robot's own: floor views tell, which agree better with them.

Odometry from wheels and an IMU knows how the robot nods; visual odometry that drifts in tilt does not.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from ebjax.features.extractor import Extractor
from ebjax.features.landmarks import take
from ebjax.features.verify_pairs import verify_blocks
from ebjax.geometry.camera import Camera
from ebjax.places.descriptor import Descriptor
from ebjax.slam.keyframes import Load, describe_keyframes
from ebjax.views.run_view import RunView

PAIRS = 12
TOLERANCE_M = 0.01


@dataclasses.dataclass(frozen=True)
class Lean:
    """How a robot leans, and what the floor says of that.

    Attributes:
      level_from_base: at every frame.
      rms_deg: of roll and pitch.
      agree: matches of successive floor views that agree to 1 cm, with it and without.
    """

    level_from_base: Float[np.ndarray, "F 4 4"]
    rms_deg: float
    agree: tuple[int, int]

    @property
    def used(self) -> bool:
        """Whether floor views agree at least as well with it."""
        return self.agree[0] >= self.agree[1]

    def says(self) -> str:
        """In one line."""
        used = "looked at accordingly" if self.used else "not used, as floor views agree worse with it"
        return (
            f"odometry's roll and pitch, {self.rms_deg:.2f} degrees rms: {used} "
            f"({self.agree[0]} matches agree with it, {self.agree[1]} without)"
        )


def leaning(
    load: Load,
    frames: list[int],
    level_from_base: Float[np.ndarray, "F 4 4"],
    camera: Camera,
    view: RunView,
    extractor: Extractor,
    descriptor: Descriptor,
    seed: int,
) -> Lean:
    """Compares the pairs of successive frames between which the robot's lean changes most, with it and without."""
    lean = np.degrees(np.arcsin(np.clip(level_from_base[:, 2, :2], -1, 1)))
    change = np.linalg.norm(np.diff(lean[frames], axis=0), axis=1)
    firsts = np.sort(np.argsort(-change, kind="stable")[:PAIRS])
    chosen = sorted({frames[k + side] for k in firsts.tolist() for side in (0, 1)})
    agree = []
    for how in (level_from_base, None):
        read, described = describe_keyframes(
            load, chosen, camera, view, extractor, descriptor, lambda items, total, label: iter(items), how
        )
        row = {frame: k for k, frame in enumerate(read.tolist())}
        pairs = [(frames[k + 1], frames[k]) for k in firsts.tolist()]
        rows = np.array([(row[i], row[j]) for i, j in pairs if i in row and j in row], int).reshape(-1, 2)
        marks = described.landmarks
        found = verify_blocks(
            lambda a, b, _, marks=marks: (take(marks, a), take(marks, b)),
            view,
            camera,
            rows[:, 0],
            rows[:, 1],
            np.zeros(len(rows), bool),
            tolerance_m=TOLERANCE_M,
            seed=seed,
        )
        agree.append(int(found[0].inliers.sum()))
    return Lean(level_from_base, float(np.sqrt((lean**2).sum(1).mean())), (agree[0], agree[1]))
