"""LPIPS is what the reference implementation computes, from files that hold plain tensors only."""

import numpy as np
import pytest
import torch
from flashcache.errors import ConfigError
from flashcache.evaluation.lpips import load_lpips
from safetensors.torch import save_file
from torch import nn

NARROW = 16
REFERENCE = 0.02981018
VGG = [64, 64, "pool", 128, 128, "pool", *[256] * 3, "pool", *[512] * 3, "pool", *[512] * 3]
TAPS = {"vgg": (3, 8, 15, 22, 29), "alex": (1, 4, 7, 9, 11)}


def vgg_layers(narrow: int) -> nn.Sequential:
    """Return the convolutions of VGG16 with `1 / narrow` of its channels."""
    layers: list[nn.Module] = []
    channels = 3
    for width in VGG:
        if width == "pool":
            layers.append(nn.MaxPool2d(2, 2))
            continue
        layers += [nn.Conv2d(channels, width // narrow, 3, padding=1), nn.ReLU()]
        channels = width // narrow
    return nn.Sequential(*layers)


def alexnet_layers(narrow: int) -> nn.Sequential:
    """Return the convolutions of AlexNet with `1 / narrow` of its channels."""
    a, b, c, d = (width // narrow for width in (64, 192, 384, 256))
    return nn.Sequential(
        *(nn.Conv2d(3, a, 11, stride=4, padding=2), nn.ReLU(), nn.MaxPool2d(3, 2)),
        *(nn.Conv2d(a, b, 5, padding=2), nn.ReLU(), nn.MaxPool2d(3, 2)),
        *(nn.Conv2d(b, c, 3, padding=1), nn.ReLU()),
        *(nn.Conv2d(c, d, 3, padding=1), nn.ReLU()),
        *(nn.Conv2d(d, d, 3, padding=1), nn.ReLU()),
    )


LAYERS = {"vgg": vgg_layers, "alex": alexnet_layers}


def fill(layers: nn.Sequential, net: str) -> dict[str, torch.Tensor]:
    """Set the weights of `layers` from a fixed stream and return those of the linear layers."""
    stream = np.random.RandomState(5)
    linear = {}
    for index, layer in enumerate(layers):
        if isinstance(layer, nn.Conv2d):
            shape = layer.weight.shape
            values = stream.standard_normal(shape) * (2.0 / np.prod(shape[1:])) ** 0.5
            layer.weight.data = torch.tensor(values, dtype=torch.float32)
            layer.bias.data = torch.tensor(0.1 * stream.standard_normal(shape[0]), dtype=torch.float32)
            if index + 1 in TAPS[net]:
                factors = stream.uniform(0.0, 0.2, (1, shape[0], 1, 1))
                linear[f"lin{len(linear)}.model.1.weight"] = torch.tensor(factors, dtype=torch.float32)
    return linear


def pictures(side: int = 64) -> tuple[np.ndarray, np.ndarray]:
    stream = np.random.RandomState(6)
    first, second = stream.uniform(size=(2, side, side, 3))
    return first, 0.7 * first + 0.3 * second


def by_hand(layers: nn.Sequential, linear, net: str, first, second) -> float:
    """Return the distance straight from its definition."""
    shift, scale = torch.tensor([-0.030, -0.088, -0.188]), torch.tensor([0.458, 0.448, 0.450])
    found = []
    with torch.no_grad():
        for picture in (first, second):
            values = ((2.0 * torch.tensor(picture) - 1.0 - shift) / scale).permute(2, 0, 1)[None].float()
            taps = []
            for index, layer in enumerate(layers):
                values = layer(values)
                if index in TAPS[net]:
                    taps.append(values / (values.norm(dim=1, keepdim=True) + 1e-10))
            found.append(taps)
        parts = [
            ((a - b) ** 2 * factors).sum(dim=1).mean()
            for a, b, factors in zip(*found, linear.values(), strict=True)
        ]
    return float(sum(parts))


def saved(tmp_path, net: str, narrow: int = NARROW):
    layers = LAYERS[net](narrow)
    linear = fill(layers, net)
    backbone = {f"features.{name}": tensor for name, tensor in layers.state_dict().items()}
    save_file(backbone, tmp_path / "backbone.safetensors")
    torch.save(linear, tmp_path / "linear.pth")
    return layers, linear, [tmp_path / "backbone.safetensors", tmp_path / "linear.pth"]


@pytest.mark.parametrize("net", ["vgg", "alex"])
def test_the_distance_is_its_definition(tmp_path, net):
    layers, linear, paths = saved(tmp_path, net)
    lpips = load_lpips(paths)
    assert lpips.name == net
    expected = by_hand(layers, linear, net, *pictures())
    assert expected > 0.001
    assert lpips.distance(*pictures()) == pytest.approx(expected, rel=1e-4)


@pytest.mark.slow
def test_the_distance_is_that_of_the_reference_implementation(tmp_path):
    # Computed with the package lpips 0.1.4 on the same weights (AlexNet at its full width) and pictures.
    _, _, paths = saved(tmp_path, "alex", narrow=1)
    assert load_lpips(paths).distance(*pictures()) == pytest.approx(REFERENCE, rel=1e-4)


def test_equal_pictures_have_no_distance_and_others_have_the_same_both_ways(tmp_path):
    lpips = load_lpips(saved(tmp_path, "vgg")[2])
    first, second = pictures(32)
    assert lpips.distance(first, first) == 0.0
    assert lpips.distance(first, second) == pytest.approx(lpips.distance(second, first), rel=1e-5)


def test_the_reference_implementations_own_names_are_understood(tmp_path):
    layers, linear, paths = saved(tmp_path, "vgg")
    slices = {index: 1 + sum(index > tap for tap in TAPS["vgg"]) for index in range(len(layers))}
    state = {
        f"net.slice{slices[int(name.split('.')[0])]}.{name}": tensor
        for name, tensor in layers.state_dict().items()
    }
    state |= linear | {"scaling_layer.shift": torch.zeros(1)}
    torch.save(state, tmp_path / "all.pth")
    together = load_lpips([tmp_path / "all.pth"]).distance(*pictures(32))
    assert together == load_lpips(paths).distance(*pictures(32))


def test_pickled_code_is_refused(tmp_path):
    torch.save({"features.0.weight": print}, tmp_path / "weights.pth")
    with pytest.raises(ConfigError, match="not plain tensors"):
        load_lpips([tmp_path / "weights.pth"])


def test_incomplete_weights_say_what_is_missing(tmp_path):
    _, _, (backbone, linear) = saved(tmp_path, "alex")
    with pytest.raises(ConfigError, match="lack lin0"):
        load_lpips([backbone])
    with pytest.raises(ConfigError, match="neither all convolutions"):
        load_lpips([linear])
    with pytest.raises(ConfigError, match="cannot be read"):
        load_lpips([tmp_path / "absent.pth"])


def test_linear_layers_of_another_network_are_refused(tmp_path):
    _, _, (backbone, _) = saved(tmp_path, "alex")
    (tmp_path / "other").mkdir()
    _, _, (_, linear) = saved(tmp_path / "other", "vgg")
    with pytest.raises(ConfigError, match="do not fit together"):
        load_lpips([backbone, linear])


def test_pictures_that_are_too_small_are_refused(tmp_path):
    lpips = load_lpips(saved(tmp_path, "alex")[2])
    with pytest.raises(ConfigError, match="larger pictures"):
        lpips.distance(*pictures(8))
