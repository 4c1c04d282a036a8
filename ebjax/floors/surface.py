"""What a floor is made of: the families by name, the options all of them share, and how elements are laid.

A family is a pure function (points, material, key) -> linear reflectance at world points of an endless floor.
`FAMILIES` names them; another one is a file and a line here.
"""

import dataclasses
import importlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from ebjax.floors.lattice import entry

FamilyName = Literal["glazed", "marble", "terrazzo", "slabs", "concrete", "wood", "carpet", "porcelain", "photograph"]
FAMILIES = {name: f"ebjax.floors.{name}:FAMILY" for name in get_args(FamilyName)}
LEARNED: tuple[FamilyName, ...] = ("glazed", "marble", "terrazzo", "slabs", "concrete", "wood", "carpet")
"""Those that floornet has learned from; the others are for tests of it."""
SIDE = 128
"""Of the table of what elements draw, elements."""


class Family(NamedTuple):
    """A family's look, what its options are where nobody sets them, and which marks wear leaves on it."""

    reflectance: Callable[..., Float[Array, "*s C"]]
    """Three channels of colour; two more where the material looks different from every side (`carpet`)."""
    size_m: float
    joint_m: float
    designs: int
    gloss: float
    marks: Mapping[str, float]
    """Kind of mark (`wear.KINDS`) -> its share; what is left of 1 does not happen to this material."""


@dataclasses.dataclass(frozen=True)
class FloorConfig:
    """A floor. Fewer designs and less disorder mean more aliasing; more wear makes places unique."""

    family: FamilyName = "glazed"
    """What it is made of; "photograph" needs `texture`."""
    texture: Path | None = None
    """An image, or a folder of images, from which the tiles of the family "photograph" are cut."""
    size_m: float | None = None
    """Side of a tile or slab, width of a plank, distance of joints, m; None: the family's own."""
    joint_m: float | None = None
    """Width of the joints, m; None: the family's own."""
    designs: int | None = None
    """Distinct tiles, slabs or planks, which repeat in a lattice; None: the family's own."""
    disorder: float = 1.0
    """Share of elements laid at random, any design, any orientation that fits, as tilers do; the others follow a
    lattice in which designs repeat exactly."""
    dirt: float = 1.0
    """Strength of grime and of the elements' differences in shade; 0 makes equal elements equal."""
    wear_per_m2: float = 4.0
    """Stains, cracks, scratches, chips, repairs per square metre (of a material that takes them all)."""
    wear: float = 1.0
    """Strength of each of them, 0 to 1."""
    ageing_per_m2: float = 0.0
    """Stains, cracks and the like per square metre that come between two passes, of the same strength."""
    texel_m: float = 0.003
    """Side of a texel, m."""


class Material(NamedTuple):
    """The options of a floor that its family reads, none left open; as in `FloorConfig`."""

    family: FamilyName
    size_m: float | int
    joint_m: float | int
    designs: int
    disorder: float | int | Float[Array, ""]
    dirt: float | int | Float[Array, ""]
    texel_m: float | int


def family(name: FamilyName) -> Family:
    """Imports a family."""
    module, attribute = FAMILIES[name].split(":")
    return getattr(importlib.import_module(module), attribute)


def check(config: FloorConfig) -> None:
    """Raises ValueError that names the key which no floor can have."""
    if (config.family == "photograph") != (config.texture is not None):
        needs = "an image or a folder" if config.texture is None else "floor.family photograph"
        raise ValueError(f"floor.texture is {config.texture}, floor.family is {config.family}: needs {needs}")
    for name in ("size_m", "designs", "texel_m"):
        value = getattr(config, name)
        if value is not None and not value > 0:
            raise ValueError(f"floor.{name} is {value}: needs a value above 0")
    size_m = material(config).size_m
    if config.joint_m is not None and not 0 <= config.joint_m < size_m:
        raise ValueError(f"floor.joint_m is {config.joint_m}: needs a value from 0 to below the size {size_m}")
    for name in ("disorder", "wear"):
        if not 0 <= getattr(config, name) <= 1:
            raise ValueError(f"floor.{name} is {getattr(config, name)}: needs a value from 0 to 1")
    for name in ("dirt", "wear_per_m2", "ageing_per_m2"):
        if not getattr(config, name) >= 0:
            raise ValueError(f"floor.{name} is {getattr(config, name)}: needs a value of 0 or more")


def material(config: FloorConfig) -> Material:
    """What the family has to know, its own values in place of None."""
    own = family(config.family)
    return Material(
        config.family,
        own.size_m if config.size_m is None else config.size_m,
        own.joint_m if config.joint_m is None else config.joint_m,
        own.designs if config.designs is None else config.designs,
        config.disorder,
        config.dirt,
        config.texel_m,
    )


class Element(NamedTuple):
    """The tile, slab or plank that a point lies on."""

    local: Float[Array, "*s 2"]
    """Position in it from its centre, in the design's own orientation, m."""
    pattern: Float[Array, "*s 2"]
    """Position in the plane out of which its design is cut, m: equal designs have equal ones."""
    design: Int[Array, "*s"]
    """Number of its design."""
    edge_m: Float[Array, "*s"]
    """Distance to its nearest edge."""
    random: Float[Array, "*s 2"]
    """Two numbers in [0, 1) of its own, whatever its design."""


def lay(
    points: Float[Array, "*s 2"],
    size_m: tuple[float | int, float | int],
    floor: Material,
    *,
    key: Key[Array, ""],
    bond: float | None = 0.0,
    turns: int = 4,
) -> Element:
    """Finds each point's element in rows along x; beyond designs in their lattice nothing repeats.

    Args:
      points: world, m.
      size_m: of an element along x and y.
      floor: its designs and their disorder.
      key: of the layout.
      bond: shift of each row against the one below as a share of an element; None: at random.
      turns: orientations in which strays lie: 4, 2 (half turns) or 1.
    """
    table_key, window_key, shift_key = jax.random.split(key, 3)
    table = jax.random.uniform(table_key, (SIDE * SIDE, 5), points.dtype)
    windows = jax.random.uniform(window_key, (floor.designs, 2), points.dtype, 0.0, 40.0)
    y = points[..., 1] / size_m[1]
    row = jnp.floor(jax.lax.stop_gradient(y)).astype(jnp.int32)
    if bond is None:
        shifts = jax.random.uniform(shift_key, (SIDE,), points.dtype)
        shift = shifts[entry(row, jnp.zeros_like(row), (SIDE, 1), SIDE)]
    else:
        shift = bond * row.astype(points.dtype)
    x = points[..., 0] / size_m[0] + shift
    column = jnp.floor(jax.lax.stop_gradient(x)).astype(jnp.int32)
    draw = table[entry(column, row, (SIDE, SIDE), SIDE)]
    stray = draw[..., 0] < floor.disorder
    of_lattice = (column + 2 * row) % floor.designs
    design = jnp.where(stray, (draw[..., 1] * floor.designs).astype(jnp.int32), of_lattice)
    turn = jnp.where(stray, (draw[..., 2] * turns).astype(jnp.int32) * (4 // turns), 0)
    u, v = (x - column - 0.5) * size_m[0], (y - row - 0.5) * size_m[1]
    edge = jnp.minimum(size_m[0] / 2 - jnp.abs(u), size_m[1] / 2 - jnp.abs(v))
    sign = jnp.where(turn >= 2, -1, 1).astype(points.dtype)
    across = turn % 2 == 1
    local = jnp.stack([sign * jnp.where(across, v, u), sign * jnp.where(across, -u, v)], axis=-1)
    return Element(local, local + windows[design], design, edge, draw[..., 3:])


def joint(edge_m: Float[Array, "*s"], joint_m: float | int, texel_m: float | int) -> Float[Array, "*s"]:
    """Share of a texel, `edge_m` from the middle of a joint, that is joint; thin joints stay faint."""
    half = texel_m / 2
    overlap = jnp.minimum(edge_m + half, joint_m / 2) - jnp.maximum(edge_m - half, -joint_m / 2)
    return jnp.clip(overlap / texel_m, 0, 1)


def mix(
    colour: Float[Array, "*s 3"], other: Float[Array, "*s 3"] | tuple[float, float, float], share: Float[Array, "*s"]
) -> Float[Array, "*s 3"]:
    """Colour + share (other - colour), per channel."""
    return colour + share[..., None] * (tint(other, colour) - colour)


def tint(other: Float[Array, "*s 3"] | tuple[float, float, float], like: Float[Array, "*s 3"]) -> Float[Array, "*s 3"]:
    """A colour spread over the shape and dtype of another array."""
    return jnp.broadcast_to(jnp.asarray(other, like.dtype), like.shape)


def spread(colour: tuple[float, float, float], by: Float[Array, "*s"]) -> Float[Array, "*s 3"]:
    """One colour times a brightness at every point."""
    return by[..., None] * jnp.broadcast_to(jnp.asarray(colour, by.dtype), (*by.shape, 3))
