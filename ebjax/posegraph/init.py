"""Starting points: odometry, spanning tree, chordal relaxation. NumPy and SciPy on the host, float64.

Each returns world_from_base for every pose. Fixed poses stay; a connected piece without one starts at its first pose.
"""

from collections import deque

import numpy as np
from jaxtyping import Bool, Float

from ebjax.posegraph.gauge import anchored
from ebjax.posegraph.graph import PoseGraph, steps_of
from ebjax.posegraph.matrices import from_matrices, to_matrices


def _positions(graph: PoseGraph) -> tuple[Bool[np.ndarray, " E"], Bool[np.ndarray, " E"]]:
    """Edges that measure a position only; those among them that place a landmark, which can be walked one way."""
    if graph.position is None:
        return (np.zeros(len(graph.i), bool),) * 2
    position = np.asarray(graph.position)
    point = np.zeros(len(graph.poses), bool) if graph.landmark is None else np.asarray(graph.landmark)
    return position, position & point[np.asarray(graph.j)]


def _roots(graph: PoseGraph) -> Bool[np.ndarray, " N"]:
    """Where walks begin: fixed rows, the first of every other piece of poses, landmarks that nothing places."""
    position, places = _positions(graph)
    roots = _tied(graph, ~position)
    placed = np.asarray(graph.j)[places]
    roots[placed] = np.asarray(graph.fixed)[placed]
    return roots


def _walk(graph: PoseGraph, edges: np.ndarray) -> Float[np.ndarray, "N P"]:
    """Composes the measurements of `edges` outwards from the fixed poses, breadth first."""
    i, j, fixed = np.asarray(graph.i), np.asarray(graph.j), _roots(graph)
    position, _ = _positions(graph)
    links: list[list[tuple[int, int, bool]]] = [[] for _ in range(len(fixed))]
    for e in edges.tolist():
        links[i[e]].append((int(j[e]), e, False))
        if not position[e]:
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
    return from_matrices(_upright(graph, world))


def _upright(graph, world):
    """Landmarks are not turned."""
    if graph.landmark is not None:
        world[np.asarray(graph.landmark), :-1, :-1] = np.eye(world.shape[1] - 1)
    return world


def spanning_tree(graph: PoseGraph) -> Float[np.ndarray, "N P"]:
    """Composes measurements along the fewest edges from a fixed pose."""
    position, places = _positions(graph)
    return _walk(graph, np.flatnonzero(~position | places))


def odometry(graph: PoseGraph) -> Float[np.ndarray, "N P"]:
    """Composes the edges between successive poses; where these leave gaps, the first other edges that bridge them."""
    i, j, fixed = np.asarray(graph.i), np.asarray(graph.j), _roots(graph)
    position, places = _positions(graph)
    order = np.argsort(~steps_of(graph) + 1 * position, kind="stable")
    order = order[(~position | places)[order]]
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

    The relaxation of Martinec and Pajdla (2007): two linear problems, no starting point. Edges that measure a position
    count in the second; pieces whose rotations nothing ties to a fixed pose keep that of their first.
    """
    i, j = np.asarray(graph.i), np.asarray(graph.j)
    world, relative = to_matrices(np.asarray(graph.poses)), to_matrices(np.asarray(graph.measured))
    d = world.shape[1] - 1
    rotation, translation = world[:, :d, :d], world[:, :d, d]
    information = np.asarray(graph.information, float)
    position = np.zeros(len(i), bool) if graph.position is None else np.asarray(graph.position)
    weight_r = np.sqrt(information[:, d:, d:].trace(axis1=1, axis2=2)) * ~position
    weight_t = np.sqrt(information[:, :d, :d].trace(axis1=1, axis2=2))
    fixed = _tied(graph, weight_r > 0)
    transposed = relative[:, :d, :d].swapaxes(1, 2)
    rows = _least_squares(i, j, fixed, transposed, rotation.swapaxes(1, 2), np.zeros((len(i), d, d)), weight_r)
    u, _, vt = np.linalg.svd(rows.swapaxes(1, 2))
    u[:, :, -1] *= np.linalg.det(u @ vt)[:, None]
    rotation = np.where(fixed[:, None, None], rotation, u @ vt)
    fixed = _tied(graph, weight_t > 0)
    step = (rotation[i] @ relative[:, :d, d:])[:, :, :]
    eye = np.tile(np.eye(d), (len(i), 1, 1))
    translation = _least_squares(i, j, fixed, eye, translation[:, :, None], step, weight_t)[:, :, 0]
    out = np.tile(np.eye(d + 1), (len(fixed), 1, 1))
    out[:, :d, :d], out[:, :d, d] = rotation, translation
    return from_matrices(_upright(graph, out))


def _tied(graph, counts):
    """`fixed`, and the first row of every piece that the edges that count do not tie to a fixed one."""
    return anchored(graph.fixed, np.asarray(graph.i)[counts], np.asarray(graph.j)[counts])


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
