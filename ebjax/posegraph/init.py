"""Starting points: odometry, spanning tree, chordal relaxation. NumPy and SciPy on the host, float64.

Each returns world_from_base for every pose. Fixed poses stay; a connected piece without one starts at its first pose.
"""

from collections import deque

import numpy as np
from jaxtyping import Float

from ebjax.posegraph.graph import PoseGraph, anchored


def to_matrices(poses: Float[np.ndarray, "N P"]) -> Float[np.ndarray, "N D D"]:
    """SE(2) or SE(3) poses as homogeneous matrices."""
    poses = np.asarray(poses, float)
    if poses.shape[1] == 3:
        out = np.tile(np.eye(3), (len(poses), 1, 1))
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        out[:, 0, 0], out[:, 0, 1], out[:, 1, 0], out[:, 1, 1] = c, -s, s, c
        out[:, :2, 2] = poses[:, :2]
        return out
    out = np.tile(np.eye(4), (len(poses), 1, 1))
    w, v = poses[:, :1, None], poses[:, 1:4]
    cross = np.cross(np.eye(3)[None], v[:, None, :])
    out[:, :3, :3] = np.eye(3) + 2 * w * cross + 2 * cross @ cross
    out[:, :3, 3] = poses[:, 4:]
    return out


def from_matrices(matrices: Float[np.ndarray, "N D D"]) -> Float[np.ndarray, "N P"]:
    """Inverse of `to_matrices`; the angle is in (-pi, pi], the quaternion has w >= 0."""
    if matrices.shape[1] == 3:
        theta = np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0])
        return np.concatenate([matrices[:, :2, 2], theta[:, None]], 1)
    from scipy.spatial.transform import Rotation

    q = Rotation.from_matrix(matrices[:, :3, :3]).as_quat(canonical=True)
    return np.concatenate([q[:, [3, 0, 1, 2]], matrices[:, :3, 3]], 1)


def _walk(graph: PoseGraph, edges: np.ndarray) -> Float[np.ndarray, "N P"]:
    """Composes the measurements of `edges` outwards from the fixed poses, breadth first."""
    graph = anchored(graph)
    i, j, fixed = (np.asarray(x) for x in (graph.i, graph.j, graph.fixed))
    links: list[list[tuple[int, int, bool]]] = [[] for _ in range(len(fixed))]
    for e in edges.tolist():
        links[i[e]].append((int(j[e]), e, False))
        links[j[e]].append((int(i[e]), e, True))
    world = to_matrices(np.asarray(graph.poses))
    forward = to_matrices(np.asarray(graph.measured))
    backward = np.linalg.inv(forward)
    queue, done = deque(np.flatnonzero(fixed).tolist()), fixed.copy()
    while queue:
        p = queue.popleft()
        for q, e, reverse in links[p]:
            if not done[q]:
                done[q] = True
                world[q] = world[p] @ (backward[e] if reverse else forward[e])
                queue.append(q)
    return from_matrices(world)


def spanning_tree(graph: PoseGraph) -> Float[np.ndarray, "N P"]:
    """Composes measurements along the fewest edges from a fixed pose."""
    return _walk(graph, np.arange(len(graph.i)))


def odometry(graph: PoseGraph) -> Float[np.ndarray, "N P"]:
    """Composes the edges between successive rows; where these leave gaps, the first other edges that bridge them."""
    graph = anchored(graph)
    i, j, fixed = (np.asarray(x) for x in (graph.i, graph.j, graph.fixed))
    order = np.argsort(np.abs(i - j) != 1, kind="stable")
    root = list(range(len(fixed) + 1))

    def find(p):
        while root[p] != p:
            root[p] = root[root[p]]
            p = root[p]
        return p

    for p in np.flatnonzero(fixed)[1:].tolist():
        root[find(p)] = find(int(np.flatnonzero(fixed)[0]))
    tree = []
    for e in order.tolist():
        a, b = find(int(i[e])), find(int(j[e]))
        if a != b:
            root[a] = b
            tree.append(e)
    return _walk(graph, np.array(tree, int))


def chordal(graph: PoseGraph) -> Float[np.ndarray, "N P"]:
    """Rotations from min sum |R_i R_ij - R_j|^2 without their constraint, projected; then translations (least squares).

    The relaxation of Martinec and Pajdla (2007): two linear problems, no starting point.
    """
    graph = anchored(graph)
    i, j, fixed = (np.asarray(x) for x in (graph.i, graph.j, graph.fixed))
    world, relative = to_matrices(np.asarray(graph.poses)), to_matrices(np.asarray(graph.measured))
    d = world.shape[1] - 1
    rotation, translation = world[:, :d, :d], world[:, :d, d]
    information = np.asarray(graph.information, float)
    weight_r = np.sqrt(information[:, d:, d:].trace(axis1=1, axis2=2))
    weight_t = np.sqrt(information[:, :d, :d].trace(axis1=1, axis2=2))
    transposed = relative[:, :d, :d].swapaxes(1, 2)
    rows = _least_squares(i, j, fixed, transposed, rotation.swapaxes(1, 2), np.zeros((len(i), d, d)), weight_r)
    u, _, vt = np.linalg.svd(rows.swapaxes(1, 2))
    u[:, :, -1] *= np.linalg.det(u @ vt)[:, None]
    rotation = np.where(fixed[:, None, None], rotation, u @ vt)
    step = (rotation[i] @ relative[:, :d, d:])[:, :, :]
    eye = np.tile(np.eye(d), (len(i), 1, 1))
    translation = _least_squares(i, j, fixed, eye, translation[:, :, None], step, weight_t)[:, :, 0]
    out = np.tile(np.eye(d + 1), (len(fixed), 1, 1))
    out[:, :d, :d], out[:, :d, d] = rotation, translation
    return from_matrices(out)


def _least_squares(i, j, fixed, block, start, step, weight):
    """Solves min sum weight^2 |block_e x_i + step_e - x_j|^2 over the free x, "N d m"; the fixed keep `start`."""
    import qdldl
    import scipy.sparse as sp

    n, (e, d) = len(fixed), block.shape[:2]
    row = np.arange(e * d).reshape(e, d)
    rows = np.concatenate([np.repeat(row[:, :, None], d, 2).ravel(), row.ravel()])
    columns = np.concatenate(
        [
            np.broadcast_to(i[:, None, None] * d + np.arange(d), (e, d, d)).ravel(),
            (j[:, None] * d + np.arange(d)).ravel(),
        ]
    )
    values = np.concatenate([(block * weight[:, None, None]).ravel(), np.repeat(-weight, d)])
    matrix = sp.csc_matrix((values, (rows, columns)), (e * d, n * d))
    free = np.repeat(~fixed, d)
    x = np.array(start, float).reshape(n * d, -1)
    right = -(weight[:, None, None] * step).reshape(e * d, -1) - matrix[:, ~free] @ x[~free]
    left = matrix[:, free]
    if free.any():
        solver = qdldl.Solver(sp.csc_matrix(left.T @ left))
        x[free] = np.stack([solver.solve(np.asarray(c)) for c in (left.T @ right).T], 1)
    return x.reshape(n, d, -1)
