"""A robot's drive along an S, its poses and the text of a file that holds them in any columns."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Drive:
    times: np.ndarray
    positions: np.ndarray
    rotations: Rotation

    @property
    def columns(self):
        x, y, z = self.positions.T
        qx, qy, qz, qw = self.rotations.as_quat().T
        yaw, pitch, roll = self.rotations.as_euler("ZYX").T
        matrices = np.tile(np.eye(4), (len(self.times), 1, 1))
        matrices[:, :3, :3], matrices[:, :3, 3] = self.rotations.as_matrix(), self.positions
        named = dict(t=self.times, x=x, y=y, z=z, qx=qx, qy=qy, qz=qz, qw=qw, roll=roll, pitch=pitch, yaw=yaw)
        named |= {"n": np.arange(len(x)), "0": np.zeros(len(x)), "ns": np.round(self.times * 1e9)}
        named |= {"us": np.round(self.times * 1e6)}
        named |= {"deg": np.degrees(yaw), "unwrapped": np.unwrap(yaw)}
        return named | {f"m{k}": matrices.reshape(-1, 16)[:, k] for k in range(16)}

    def text(self, columns, separator=" ", header=""):
        """Rows of the columns named, `header` as the first line."""
        known = self.columns
        rows = [
            [f"{known[c][k]:.9f}" if c not in ("n", "ns", "us") else f"{known[c][k]:.0f}" for c in columns.split()]
            for k in range(len(self.times))
        ]
        return (header + "\n" if header else "") + "".join(separator.join(row) + "\n" for row in rows)

    def check(self, trajectory, atol=1e-7):
        assert len(trajectory.poses) == len(self.times)
        np.testing.assert_allclose(trajectory.poses[:, :3, 3], self.positions, atol=atol)
        np.testing.assert_allclose(trajectory.poses[:, :3, :3], self.rotations.as_matrix(), atol=atol)
        np.testing.assert_allclose(
            trajectory.timestamps, self.times if trajectory.timed else np.arange(len(self.times)), rtol=0, atol=1e-6
        )


def s_curve(count=80, start=1403636579.75, step=0.5, turns=2.4):
    phase = np.linspace(0, 1, count)
    heading = 0.3 + turns * np.sin(2 * np.pi * phase)
    length = 0.25 * np.ones(count)
    x, y = np.cumsum(length * np.cos(heading)), np.cumsum(length * np.sin(heading))
    rotations = Rotation.from_euler("ZYX", np.stack([heading, 0 * heading, 0 * heading], axis=1))
    return Drive(start + step * np.arange(count), np.stack([x, y, 0 * x], axis=1), rotations)


@pytest.fixture(name="drive")
def _drive():
    return s_curve()


@pytest.fixture
def hilly(drive):
    """The same with a base that rolls and pitches a little and climbs."""
    angles = drive.rotations.as_euler("ZYX") + np.array([[0, 0.05, -0.08]])
    z = 0.02 * np.arange(len(drive.times))
    return Drive(drive.times, drive.positions + np.stack([0 * z, 0 * z, z], 1), Rotation.from_euler("ZYX", angles))


@pytest.fixture
def reading(tmp_path):
    """Returns a function that writes text (or bytes) to poses.txt and reads it."""
    from ebjax.io.trajectory import read

    def write_and_read(text, name="poses.txt"):
        (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
        return read(tmp_path / name)

    return write_and_read
