"""The front of the engine: frames in, updates out, and at the end the whole run thought over."""

from ebjax.geometry.camera import Camera
from ebjax.slam.drive import drive
from ebjax.slam.engine import Engine
from ebjax.slam.finish import Again, finish
from ebjax.slam.lean import Lean
from ebjax.slam.run import Run


class Mapper(Engine):
    """Closes loops from opposing views as the robot drives.

    Args:
      camera: of the images, as it is mounted.
      config: see there.
      view: the floor that is looked at, or what chooses it for a camera; None: what the camera sees well.
      recording: what of the run can be asked again; None where it cannot, as on a robot.
      lean: how the robot leans at every frame, where that is known beforehand.
      remember: of a network's name and weights, gives what wraps its functions so that they look up what they know.
      store: where keyframes are kept; one that holds some is gone on with: frames up to its last keyframe, which is
        `next_frame`, are given to `pass_by`, those from there on to `add`. None: in memory.

    Raises:
      ValueError: wheels are asked for alone or not at all against what the frames have; an unknown descriptor or
        extractor; the camera sees no floor.
    """

    def finish(self, again: Again | None = None) -> Run:
        """Thinks the whole run over.

        Args:
          again: drives a recorded run once more; None: in memory.

        Raises:
          ValueError: fewer than two frames could be read.
        """
        return finish(self, driven_again if again is None else again)


def driven_again(engine: Engine, camera: Camera, lean: Lean | None) -> Engine:
    """The same recording, as that camera sees it, through an engine that keeps it in memory."""
    assert engine.recording is not None
    ways = {"view": engine.view_of, "recording": engine.recording, "remember": engine.remember}
    another = Engine(camera, engine.config, lean=lean, **ways)
    drive(another, engine.recording)
    return another
