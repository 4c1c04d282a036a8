"""ebjax: loop closures from opposing viewpoints (Early Bird), differentiable, in JAX.

    import ebjax

    run = ebjax.close_loops("run.bag")
    print(run.summary())

Names are imported when they are first used, so that `import ebjax` costs nothing.
"""

import importlib
from typing import Any

__version__ = "0.2.0"

_FROM = {
    "close_loops": "ebjax.front.close",
    "open_log": "ebjax.front.log",
    "demo": "ebjax.front.demo",
    "Mapper": "ebjax.front.mapper",
    "Localiser": "ebjax.front.localiser",
    "Run": "ebjax.front.run",
    "Frame": "ebjax.slam.frame",
    "Update": "ebjax.slam.frame",
    "Camera": "ebjax.geometry.camera",
    "FloorView": "ebjax.geometry.camera",
    "Descriptor": "ebjax.places.descriptor",
    "Places": "ebjax.places.descriptor",
    "Extractor": "ebjax.features.extractor",
    "Features": "ebjax.features.matching",
    "PoseGraph": "ebjax.posegraph.graph",
    "make_graph": "ebjax.posegraph.graph",
    "solve": "ebjax.posegraph.lm",
    "setup_jax": "ebjax.command",
}
_MODULES = ("testing",)

__all__ = ["__version__", *_FROM, *_MODULES]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(f"ebjax.{name}")
    if name not in _FROM:
        raise AttributeError(f"module 'ebjax' has no attribute {name!r}")
    found = globals()[name] = getattr(importlib.import_module(_FROM[name]), name)
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
