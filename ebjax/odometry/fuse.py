"""The floor's steps and the wheels settled into one chain, and what each contradicts of the other."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.geometry.planar import adjoint, between, chained, compose, inverse, log
from ebjax.odometry.chain import CARRIED_M, CARRIED_RAD, Edges, carried_on, settle_chain
from ebjax.odometry.steps import Steps
from ebjax.odometry.wheels import Systematic, WheelErrors, corrected

OWN_FLOOR = 0.5
"""Power of `Steps.share` in the graph: the steps of a view share its errors in part, as each sees floor of its own."""
CONTRADICTED = "contradicts the other steps"


@dataclasses.dataclass(frozen=True)
class Jump:
    """A step of the odometry that the floor contradicts: the frame after it, the metres and degrees it counted."""

    frame: int
    metres: float
    degrees: float
    seconds: float


class Settled(NamedTuple):
    """What `Motion` has of it; `jumps` name keyframes."""

    chain: Edges
    further: Edges
    steps: Steps
    poses: Float[np.ndarray, "N 3"]
    covariance: Float[np.ndarray, "M 3 3"]
    jumps: list[Jump]
    carried: int


def fuse(
    steps: Steps,
    count: int,
    times: Float[np.ndarray, " N"],
    wheels: Float[np.ndarray, "N 3"] | None,
    wrong: Systematic | None,
    errors: WheelErrors,
) -> Settled:
    """Settles the chain of wheels and steps."""
    rows = np.arange(count - 1)
    used = np.flatnonzero(steps.used)
    # Whether a step is wrong is asked as if its views told nothing of their own.
    information = _information(steps, used, 1.0)
    parts = [Edges(steps.i[used], steps.j[used], steps.i_from_j[used], information, np.ones(len(used), bool))]
    start = np.zeros((count - 1, 3))
    if wheels is not None:
        assert wrong is not None
        counted = corrected(wheels, np.diff(times), wrong)
        weights = np.einsum("na,ab->nab", errors.step_sigmas(wheels) ** -2.0, np.eye(3))
        parts.append(Edges(rows, rows + 1, counted, weights, np.ones(count - 1, bool)))
        start = counted.copy()
    first = steps.consecutive()
    if wheels is not None:
        first = first[steps.kind[first] != "rotation"]
    start[steps.j[first]] = inverse(steps.i_from_j[first])
    if wheels is None:
        start = carried_on(start, np.isin(rows, steps.j[first]), times)
    edges = Edges(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    poses, counts = settle_chain(edges, chained(start))
    steps = steps.refuse(np.isin(np.arange(len(steps.i)), used[~counts[: len(used)]]), CONTRADICTED)
    jumps: list[Jump] = []
    believed = np.zeros(count - 1, bool)
    if wheels is not None:
        believed = counts[len(used) :]
        step = between(wheels[:-1], wheels[1:])
        for k in np.flatnonzero(~believed):
            turn = abs(float(np.degrees(step[k, 2])))
            jumps.append(Jump(int(k + 1), float(np.hypot(*step[k, :2])), turn, float(times[k + 1] - times[k])))
    used = np.flatnonzero(steps.used)
    near = used[steps.i[used] - steps.j[used] == 1]
    far = used[steps.i[used] - steps.j[used] > 1]
    chain, measured_steps = _one_edge_a_step(steps, near, parts[1] if wheels is not None else None, believed, poses)
    further = Edges(steps.i[far], steps.j[far], steps.i_from_j[far], _information(steps, far), np.zeros(len(far), bool))
    covariance = _step_covariance(chain, further, poses)
    spanned = np.zeros(count, int)
    np.add.at(spanned, further.j, 1)
    np.add.at(spanned, further.i, -1)
    carried = int((~measured_steps & (np.cumsum(spanned)[:-1] == 0)).sum())
    return Settled(chain, further, steps, poses, covariance, jumps, carried)


def _information(steps: Steps, rows: Int[np.ndarray, " K"], shared: float = OWN_FLOOR) -> Float[np.ndarray, "K 3 3"]:
    """Of steps as edges: shared views are not counted twice, and a rotation says nothing of translation."""
    wide = steps.covariance[rows] * steps.share()[rows, None, None] ** shared
    information = np.linalg.inv(wide)
    alone = steps.kind[rows] == "rotation"
    information[alone] = np.diag([CARRIED_M**-2, CARRIED_M**-2, 0.0])
    information[alone, 2, 2] = 1 / wide[alone, 2, 2]
    return information


def _one_edge_a_step(steps: Steps, near, wheels: Edges | None, believed, poses) -> tuple[Edges, Bool[np.ndarray, " M"]]:
    """Wheels and the steps from the keyframe before, fused; and which steps anything measured."""
    count = len(poses)
    rows = np.arange(count - 1)
    relative = between(poses[:-1], poses[1:])
    information = np.tile(np.diag([CARRIED_M**-2, CARRIED_M**-2, CARRIED_RAD**-2]) * 1e-2, (count - 1, 1, 1))
    pull = np.zeros((count - 1, 3))
    known = np.zeros(count - 1, bool)

    def add(at, measured, weight):
        # Both about the settled step: log(settled^-1 measured).
        off = log(compose(inverse(relative[at]), measured))
        np.add.at(information, at, weight)
        np.add.at(pull, at, np.einsum("nab,nb->na", weight, off))
        known[at] = True

    if wheels is not None:
        add(rows[believed], wheels.measured[believed], wheels.information[believed])
    if len(near):
        # i_from_j with i the later: turned round to earlier_from_later.
        back = adjoint(inverse(steps.i_from_j[near]))
        weight = np.swapaxes(back, 1, 2) @ _information(steps, near) @ back
        add(steps.j[near], inverse(steps.i_from_j[near]), weight)
    mean = np.linalg.solve(information, pull[..., None])[..., 0]
    fused = compose(relative, mean)
    return Edges(rows, rows + 1, fused, information, np.zeros(count - 1, bool)), known


def _step_covariance(chain: Edges, further: Edges, poses) -> Float[np.ndarray, "M 3 3"]:
    """Of each step of the chain: its own edge, and its part of the longer steps over it where those know more."""
    information = chain.information.copy()
    gaps = further.i - further.j
    for k in np.flatnonzero(gaps > 1):
        i, j = further.i[k], further.j[k]
        ad = adjoint(between(poses[i], poses[j]))
        covariance = ad @ np.linalg.inv(further.information[k]) @ ad.T
        for row in range(j, i):
            carry = adjoint(between(poses[row + 1], poses[i]))
            mine = np.linalg.inv(carry @ covariance @ carry.T)
            if np.trace(information[row][:2, :2]) < np.trace(mine[:2, :2]):
                information[row] = information[row] + mine / gaps[k]
    return np.linalg.inv(information)
