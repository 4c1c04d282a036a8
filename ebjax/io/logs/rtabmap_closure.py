"""A planar loop closure as RTAB-Map's link: a 3x4 transform and a 6x6 information matrix (x y z roll pitch yaw)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

PLANAR = [0, 1, 5]


@dataclass(frozen=True)
class Closure:
    """A measured closure: the pose of node `to_node` in the frame of node `from_node`, both of base_link on the floor.

    Attributes:
      from_node: the newer node, as RTAB-Map orders its own closures.
      to_node: the older node.
      x_m: of `to` in `from`.
      y_m: of `to` in `from`.
      theta_rad: of `to` in `from`.
      covariance: of (x, y, theta) in the right tangent of that pose, m and rad.
    """

    from_node: int
    to_node: int
    x_m: float
    y_m: float
    theta_rad: float
    covariance: Float[np.ndarray, "3 3"]


def information_from_closure(
    closure: Closure, typical: Float[np.ndarray, "6"], most: Float[np.ndarray, "6"]
) -> Float[np.ndarray, "6 6"]:
    """The closure's 6x6 information: S covariance^-1 S in x, y, yaw; odometry's in z, roll, pitch.

    S shrinks an axis to odometry's greatest information and keeps the correlations: else one closure outweighs the
    chain.

    Raises:
      ValueError: numbers that are not finite, or a covariance that is not positive definite; names both nodes.
    """
    covariance, pose = closure.covariance, (closure.x_m, closure.y_m, closure.theta_rad)
    finite = np.isfinite(covariance).all() and np.isfinite(pose).all()
    skew = np.abs(covariance - covariance.T).max()
    if not finite or skew > 1e-6 * np.abs(covariance).max() or np.linalg.eigvalsh(covariance).min() <= 0:
        raise ValueError(
            f"closure of nodes {closure.from_node} and {closure.to_node}: its pose and covariance must be finite, and "
            "the covariance symmetric and positive definite; leave it out"
        )
    planar = np.linalg.inv((covariance + covariance.T) / 2)
    shrink = np.sqrt(np.minimum(1.0, most[PLANAR] / planar.diagonal()))
    information = np.diag(typical)
    information[np.ix_(PLANAR, PLANAR)] = planar * shrink[:, None] * shrink
    information[PLANAR, PLANAR] = np.minimum(planar.diagonal(), most[PLANAR])  # without the rounding of the roots
    return information


def transforms_from_closure(closure: Closure) -> tuple[bytes, bytes]:
    """The closure's pose and its inverse as 12 float32 each, row-major 3x4."""
    cosine, sine = np.cos(closure.theta_rad), np.sin(closure.theta_rad)
    from_to = np.eye(4)
    from_to[:2] = [[cosine, -sine, 0, closure.x_m], [sine, cosine, 0, closure.y_m]]
    return tuple(pose[:3].astype("<f4").tobytes() for pose in (from_to, np.linalg.inv(from_to)))  # type: ignore[return-value]
