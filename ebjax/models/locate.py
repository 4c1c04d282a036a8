"""Where the weights of a network lie on this computer, and the network that they make.

One rule for every command: NAME.safetensors in the folder $EBJAX_WEIGHTS, by default ~/.cache/ebjax/weights; the option
--weights names another folder, or the file itself. Where the folder has none, the published file of an installed Python
package that carries it (`Model.carrier`) is read; the package is not imported. --arithmetic chooses how the network
computes (`ebjax.models.fast`).
"""

import importlib.util
import os
from pathlib import Path

from flax import nnx

from ebjax.models.catalogue import Model, find, load_network, restore
from ebjax.models.convert import convert_checkpoint
from ebjax.models.fast import Arithmetic, accelerate


def weights_folder() -> Path:
    """$EBJAX_WEIGHTS, else ebjax/weights in $XDG_CACHE_HOME or ~/.cache."""
    if named := os.environ.get("EBJAX_WEIGHTS"):
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ebjax" / "weights"


def locate(name: str, given: Path | None = None) -> Path:
    """The weights file of a network.

    Args:
      name: a name of `ebjax.models.catalogue.MODELS`.
      given: a file, or a folder that holds NAME.safetensors; None is `weights_folder()`.

    Returns:
      That file; where there is none, the published one that an installed package carries.

    Raises:
      ValueError: there is neither; the message says how to get it.
    """
    model = find(name)
    path = weights_folder() if given is None else given
    if given is None or path.is_dir():
        path = path / f"{name}.safetensors"
        if not path.is_file() and (carried := carried_file(model)) is not None:
            return carried
    if not path.is_file():
        install = f"{model.install}, or " if model.carrier else ""
        raise ValueError(
            f"{name} needs weights, and {path} does not exist: {install}get {model.file} ({model.source}) and run "
            f"`python -m ebjax.models convert {model.file} {path}`"
        )
    return path


def carried_file(model: Model) -> Path | None:
    """The published file of a network, where an installed package carries it."""
    package, _, inside = model.carrier.partition("/")
    spec = importlib.util.find_spec(package) if package else None
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        if (path := Path(folder) / inside).is_file():
            return path
    return None


def open_network(
    name: str, weights: Path | None = None, arithmetic: Arithmetic = "exact", *, accepted: tuple[str, ...] = ()
) -> tuple[Path, str, nnx.Module]:
    """Loads a network: its file, which of the accepted ones it is, and the network.

    Args:
      name: a name of `ebjax.models.catalogue.MODELS`.
      weights: as in `locate`.
      arithmetic: "exact" float32 convolutions; "winograd", equal to rounding; "bfloat16", reduced precision.
      accepted: names of others that will do.

    Raises:
      ValueError: there are no such weights, or they are another network's.
      OSError: they cannot be read.
    """
    path = locate(name, weights)
    if path == carried_file(find(name)):
        kind, arrays, _ = convert_checkpoint(path)
        network = restore(kind, arrays)
    else:
        kind, network = load_network(path)
    if kind not in (name, *accepted):
        raise ValueError(f"{path}: weights of {kind}, not of {name}")
    return path, kind, accelerate(network, arithmetic)
