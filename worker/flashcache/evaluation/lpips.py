"""LPIPS, a distance between pictures in the features of a network, with weights from the user's files.

Nothing is downloaded, and this code includes no weights. It accepts safetensors and .pth files (read as
plain tensors, never as pickled code) that together hold a backbone and the linear layers, in the names of
the reference implementation (`net.slice1.0.weight`, `lin0.model.1.weight`) or of the backbone's own
checkpoint (`features.0.weight`).
Source: Zhang et al. 2018, The Unreasonable Effectiveness of Deep Features, version 0.1.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from numpy import ndarray
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from flashcache.errors import ConfigError

SHIFT = (-0.030, -0.088, -0.188)
SCALE = (0.458, 0.448, 0.450)
"""Mean and width of pictures in -1..1 that the backbones were trained with."""
NORM_FLOOR = 1e-10


@dataclass(frozen=True, slots=True)
class Backbone:
    """A network of convolutions, and where its features are taken."""

    name: str
    convolutions: tuple[tuple[int, int, int], ...]
    """Position among the layers of the checkpoint, stride and padding of each convolution."""
    pools: tuple[int, ...]
    """Positions of the pooling layers."""
    pool_size: int
    taps: tuple[int, ...]
    """Convolutions (counted from 0) whose rectified output is a feature."""


ALEXNET = Backbone(
    "alex", ((0, 4, 2), (3, 1, 2), (6, 1, 1), (8, 1, 1), (10, 1, 1)), (2, 5), 3, (0, 1, 2, 3, 4)
)
VGG16 = Backbone(
    "vgg",
    tuple((index, 1, 1) for index in (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)),
    (4, 9, 16, 23),
    2,
    (1, 3, 6, 9, 12),
)


class Lpips(nn.Module):
    """The distance; `name` is "alex" or "vgg"."""

    shift: Tensor
    scale: Tensor

    def __init__(self, backbone: Backbone, weights: Mapping[str, Tensor]) -> None:
        super().__init__()
        self.name = backbone.name
        self.backbone = backbone
        kernels = [weights[f"features.{index}.weight"] for index, _, _ in backbone.convolutions]
        biases = [weights[f"features.{index}.bias"] for index, _, _ in backbone.convolutions]
        linear = [weights[f"lin{number}"].reshape(-1) for number in range(len(backbone.taps))]
        for tap, factors in zip(backbone.taps, linear, strict=True):
            if len(factors) != len(kernels[tap]):
                raise ConfigError(
                    f"LPIPS weights do not fit together: a linear layer of {len(factors)} channels for a "
                    f"feature of {len(kernels[tap])}; give the backbone and linear layers of one network"
                )
        self.kernels = nn.ParameterList(nn.Parameter(k.float(), requires_grad=False) for k in kernels)
        self.biases = nn.ParameterList(nn.Parameter(b.float(), requires_grad=False) for b in biases)
        self.linear = nn.ParameterList(nn.Parameter(w.float(), requires_grad=False) for w in linear)
        self.register_buffer("shift", torch.tensor(SHIFT)[:, None, None])
        self.register_buffer("scale", torch.tensor(SCALE)[:, None, None])

    @torch.no_grad()
    def forward(
        self, first: Float[Tensor, "batch 3 height width"], second: Float[Tensor, "batch 3 height width"]
    ) -> Float[Tensor, " batch"]:
        """Return the distance of encoded pictures in 0..1; 0 for equal ones.

        Raises `ConfigError` for pictures that are too small for the network.
        """
        total = first.new_zeros(len(first))
        pairs = zip(self._features(first), self._features(second), self.linear, strict=True)
        for mine, other, factors in pairs:
            difference = (_normalised(mine) - _normalised(other)).square()
            total = total + (difference * factors[:, None, None]).sum(dim=1).mean(dim=(1, 2))
        return total

    def distance(
        self, first: Float[ndarray, "height width 3"], second: Float[ndarray, "height width 3"]
    ) -> float:
        """Return the distance of two encoded pictures in 0..1."""
        pair = [
            torch.from_numpy(picture).to(self.linear[0]).permute(2, 0, 1)[None] for picture in (first, second)
        ]
        return float(self(*pair)[0])

    def _features(self, picture: Tensor) -> list[Tensor]:
        features = []
        values = (2.0 * picture - 1.0 - self.shift) / self.scale
        pools = iter((*self.backbone.pools, -1))
        pool = next(pools)
        for number, (index, stride, padding) in enumerate(self.backbone.convolutions):
            if 0 <= pool < index:
                self._check_size(values, picture)
                values = nn.functional.max_pool2d(values, self.backbone.pool_size, stride=2)
                pool = next(pools)
            values = nn.functional.conv2d(
                values, self.kernels[number], self.biases[number], stride=stride, padding=padding
            ).relu()
            if number in self.backbone.taps:
                features.append(values)
        return features

    def _check_size(self, values: Tensor, picture: Tensor) -> None:
        if min(values.shape[-2:]) < self.backbone.pool_size:
            raise ConfigError(
                f"LPIPS with {self.name} needs larger pictures, got {picture.shape[-1]} x "
                f"{picture.shape[-2]}; evaluate at 64 pixels or more, or without --lpips-weights"
            )


def _normalised(features: Tensor) -> Tensor:
    return features / (features.square().sum(dim=1, keepdim=True).sqrt() + NORM_FLOOR)


def load_lpips(paths: Iterable[Path]) -> Lpips:
    """Return the distance whose weights lie in `paths`, one file or backbone and linear layers apart.

    Raises `ConfigError` for a file that cannot be read as tensors, or where something is missing.
    """
    weights: dict[str, Tensor] = {}
    for path in paths:
        for name, tensor in _read(path).items():
            plain = _plain_name(name)
            if plain is not None:
                weights[plain] = tensor
    for backbone in (VGG16, ALEXNET):
        wanted = {f"features.{index}.weight" for index, _, _ in backbone.convolutions}
        if wanted == {name for name in weights if re.fullmatch(r"features\.\d+\.weight", name)}:
            missing = [f"lin{n}" for n in range(len(backbone.taps)) if f"lin{n}" not in weights]
            missing += [
                name
                for name in (f"features.{index}.bias" for index, _, _ in backbone.convolutions)
                if name not in weights
            ]
            if missing:
                raise ConfigError(
                    f"LPIPS weights lack {', '.join(missing)}; give the file with the backbone and the one "
                    "with the linear layers, each with --lpips-weights"
                )
            return Lpips(backbone, weights)
    raise ConfigError(
        "LPIPS weights hold neither all convolutions of VGG16 nor those of AlexNet; give a file with names "
        "like features.0.weight or net.slice1.0.weight, and one with lin0.model.1.weight"
    )


def _read(path: Path) -> Mapping[str, Tensor]:
    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        stored = torch.load(path, map_location="cpu", weights_only=True)
    # torch.load raises whatever its unpickler meets: the file holds more than plain tensors.
    except (OSError, SafetensorError) as error:
        raise ConfigError(f'LPIPS weights "{path}" cannot be read: {error}') from error
    except Exception as error:
        raise ConfigError(
            f'LPIPS weights "{path}" are not plain tensors; convert them to safetensors, or save the state '
            "dictionary alone"
        ) from error
    if not isinstance(stored, Mapping) or not all(isinstance(value, Tensor) for value in stored.values()):
        raise ConfigError(f'LPIPS weights "{path}" must be a mapping of names to tensors')
    return stored


def _plain_name(name: str) -> str | None:
    """Return `features.N.weight`, `features.N.bias` or `linN`, or None for a tensor that is not needed."""
    match = re.fullmatch(r"(?:net\.slice\d+|features)\.(\d+)\.(weight|bias)", name)
    if match:
        return f"features.{match[1]}.{match[2]}"
    match = re.fullmatch(r"lin(?:s\.)?(\d)\.model\.1\.weight", name)
    return f"lin{match[1]}" if match else None
