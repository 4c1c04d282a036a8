"""Where the weights of a network lie on this computer, and the network that they make.

One rule for every command: NAME.safetensors in the folder $EBJAX_WEIGHTS, by default ~/.cache/ebjax/weights; the option
--weights names another folder, or the file itself. --arithmetic chooses how it computes (`ebjax.models.fast`).
"""

import os
from pathlib import Path

from flax import nnx

from ebjax.models.catalogue import find, load_network
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

    Raises:
      ValueError: there is none; the message says how to make it.
    """
    path = weights_folder() if given is None else given
    if given is None or path.is_dir():
        path = path / f"{name}.safetensors"
    if not path.is_file():
        model = find(name)
        raise ValueError(
            f"{name} needs weights, and {path} does not exist: get {model.file} ({model.source}) and run "
            f"`python -m ebjax.models convert {model.file} {path}`"
        )
    return path


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
    kind, network = load_network(path)
    if kind not in (name, *accepted):
        raise ValueError(f"{path}: weights of {kind}, not of {name}")
    return path, kind, accelerate(network, arithmetic)
