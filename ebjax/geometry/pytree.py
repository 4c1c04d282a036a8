"""Data that JAX takes apart and builds again: frozen dataclasses of arrays."""

import dataclasses
import typing

import jax

Data = typing.TypeVar("Data")


@typing.dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def pytree(cls: type[Data]) -> type[Data]:
    """Makes a frozen dataclass of a class, and a pytree whose leaves are its fields but for those marked static.

    Its annotations say the shapes. They are not checked at run time: vmap and tree_map build it anew with batched
    leaves, tracers or placeholders.
    """
    whole = dataclasses.dataclass(frozen=True)(cls)
    typing.no_type_check(whole)
    for member in vars(whole).values():
        if isinstance(member, property) and member.fget is not None:  # no_type_check passes them by
            typing.no_type_check(member.fget)
    return jax.tree_util.register_dataclass(whole)
