"""The same networks in torch, random weights, to compare times with; torch is no dependency of ebjax."""

from collections.abc import Callable
from typing import Any


def torch_network(name: str) -> Any:
    """A torch module in evaluation mode, channels last.

    Raises:
      ValueError: torch is not installed.
    """
    try:
        from torch import channels_last
    except ImportError:
        raise ValueError('the bench compares with torch: pip install "ebjax[torch]"') from None
    return NETWORKS[name]().eval().to(memory_format=channels_last)


def _stack(*layers: int | str) -> Any:
    """Widths are 3x3 convolutions with ReLU, negative ones dilated by 2; "max" and "avg" are pools."""
    from torch import nn

    parts: list[Any] = []
    channels = 3
    for layer in layers:
        if isinstance(layer, str):
            parts.append(nn.MaxPool2d(2) if layer == "max" else nn.AvgPool2d(2, 1))
            continue
        dilation, width = (2, -layer) if layer < 0 else (1, layer)
        parts += [nn.Conv2d(channels, width, 3, padding=dilation, dilation=dilation), nn.ReLU(inplace=True)]
        channels = width
    return nn.Sequential(*parts)


def _vgg16() -> Any:
    two, three = (64, 64, "max", 128, 128, "max"), (256, 256, 256, "max")
    return _stack(*two, *three, *(2 * (512, 512, 512, "max")))


def _d2net() -> Any:
    return _stack(64, 64, "max", 128, 128, "max", 256, 256, 256, "avg", -512, -512, -512)


def _superpoint() -> Any:
    from torch import nn
    from torch.nn.functional import normalize

    class SuperPoint(nn.Module):
        def __init__(self):
            super().__init__()
            self.encoder = _stack(64, 64, "max", 64, 64, "max", 128, 128, "max", 128, 128)
            self.encoder[0] = nn.Conv2d(1, 64, 3, padding=1)
            head = lambda out: nn.Sequential(nn.Conv2d(128, 256, 3, padding=1), nn.ReLU(), nn.Conv2d(256, out, 1))  # noqa: E731
            self.detector, self.descriptor = head(65), head(256)

        def forward(self, x):
            x = self.encoder(x)
            return self.detector(x), normalize(self.descriptor(x))

    return SuperPoint()


def _resnet50() -> Any:
    from torch import nn
    from torch.nn.functional import relu

    class Block(nn.Module):
        def __init__(self, channels, width, stride):
            super().__init__()
            conv = lambda i, o, size, s=1: nn.Sequential(  # noqa: E731
                nn.Conv2d(i, o, size, s, size // 2, bias=False), nn.BatchNorm2d(o)
            )
            self.conv1, self.conv2 = conv(channels, width, 1), conv(width, width, 3, stride)
            self.conv3 = conv(width, 4 * width, 1)
            self.project = conv(channels, 4 * width, 1, stride) if channels != 4 * width else nn.Identity()

        def forward(self, x):
            y = self.conv3(relu(self.conv2(relu(self.conv1(x)))))
            return relu(y + self.project(x))

    first = nn.Conv2d(3, 64, 7, 2, 3, bias=False), nn.BatchNorm2d(64), nn.ReLU(), nn.MaxPool2d(3, 2, 1)
    blocks, channels = [], 64
    for width, count in ((64, 3), (128, 4), (256, 6), (512, 3)):
        for n in range(count):
            blocks.append(Block(channels, width, 2 if n == 0 and width > 64 else 1))
            channels = 4 * width
    return nn.Sequential(*first, *blocks)


def _netvlad_head() -> Any:
    import torch
    from torch import nn
    from torch.nn.functional import normalize

    class Head(nn.Module):
        """As one product over the clusters: the fastest way torch has, far before the published loop."""

        def __init__(self):
            super().__init__()
            self.assign = nn.Conv2d(512, 64, 1, bias=False)
            self.centroids = nn.Parameter(torch.rand(64, 512))

        def forward(self, x):
            x = normalize(x)
            share = self.assign(x).flatten(2).softmax(1)
            total = torch.einsum("bkn,bdn->bkd", share, x.flatten(2))
            v = total - share.sum(2)[..., None] * self.centroids
            return normalize(normalize(v, dim=2).flatten(1))

    return Head()


def _floornet() -> Any:
    import torch
    from torch import nn
    from torch.nn.functional import interpolate, normalize

    from ebjax.models.floornet import CONTRAST_FLOOR, STEM, TOP, gaussian

    def stack(channels: int, layers: Any) -> Any:
        parts: list[Any] = []
        for width, size, stride in layers:
            padding = size // 2 if size % 2 else (size - stride) // 2
            parts += [nn.Conv2d(channels, width, size, stride, padding), nn.ReLU(inplace=True)]
            channels = width
        return nn.Sequential(*parts)

    class FloorNet(nn.Module):
        """Its norms folded, its pairs as plain channels."""

        def __init__(self):
            super().__init__()
            self.stem, self.top = stack(1, STEM), stack(STEM[-1][0], TOP)
            self.places = nn.Conv2d(TOP[-1][0], 64, 1, bias=False)
            self.merge = nn.Sequential(nn.Conv2d(STEM[-1][0] + TOP[-1][0], 96, 1), nn.ReLU(inplace=True))
            self.local, self.score = nn.Conv2d(96, 64, 1, bias=False), nn.Conv2d(96, 1, 1)

        def forward(self, x):
            rows, columns = (torch.from_numpy(gaussian(n)) for n in x.shape[2:])
            blur = lambda v: rows @ v @ columns.T  # noqa: E731
            seen = torch.ones_like(x)
            weight = blur(seen).clamp(min=1e-3)
            centred = (x - blur(x * seen) / weight) * seen
            fine = self.stem((centred / (blur(centred**2) / weight + CONTRAST_FLOOR**2).sqrt()).clamp(-4, 4))
            coarse = self.top(fine)
            places = self.places(coarse)
            places = places / (1 + (places**2).sum(1, keepdim=True)).sqrt()
            both = self.merge(torch.cat([fine, interpolate(coarse, scale_factor=2, mode="bilinear")], 1))
            return places, normalize(self.local(both)), self.score(both)

    return FloorNet()


NETWORKS: dict[str, Callable[[], Any]] = {
    "floornet": _floornet,
    "vgg16": _vgg16,
    "resnet50": _resnet50,
    "d2net": _d2net,
    "superpoint": _superpoint,
    "netvlad-head": _netvlad_head,
}
