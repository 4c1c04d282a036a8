"""Where the weights of a network lie on this computer.

One rule for every command: NAME.safetensors in the folder $EBJAX_WEIGHTS, by default ~/.cache/ebjax/weights; the option
--weights names another folder, or the file itself.
"""

import os
from pathlib import Path

from ebjax.models.catalogue import find


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
