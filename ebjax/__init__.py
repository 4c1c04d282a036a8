"""ebjax: loop closures from opposing viewpoints (Early Bird), differentiable, in JAX."""

__version__ = "0.1.0"
