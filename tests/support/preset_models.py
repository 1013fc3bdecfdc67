"""Untrained models of the presets' sizes, with weights like those of trained ones."""

from dataclasses import replace

import torch
from flashcache import presets
from flashcache.encoding.hash_grid import HashGrid
from flashcache.encoding.occupancy import OccupancyConfig
from flashcache.export.reference import GbufferRule
from flashcache.fields.density import NormalConfig
from flashcache.physical.model import Domain, InverseModel

DOMAIN = Domain(
    bounds_min=(-1.0, -1.0, -1.0),
    bounds_max=(1.0, 1.0, 1.0),
    primary=(2.0, 6.0),
    secondary=(0.05, 2.0),
    contraction_radius=1.3,
    lights=("sky",),
)
RULE = GbufferRule(box_min=(-1.0, -1.1, -1.0), box_max=(1.0, 1.0, 1.2), num_samples=48, group=4)


def preset_model(variant: str) -> InverseModel:
    """Return a model whose weights are of the size of trained ones, in every layer."""
    torch.manual_seed(0)
    config = presets.fast().model if variant in ("fast", "gloss grid") else presets.tiny().model
    if variant == "other shapes":
        # What the small presets do not have: a skip connection, ReLU, normals straight from the density.
        density = replace(config.nerf.density, softplus_beta=None)
        config = replace(
            config,
            nerf=replace(config.nerf, density=density, normals=NormalConfig(own_grid=None)),
            fast=replace(config.fast, distance_layers=4, code_layers=2),
        )
    # One variant has a grid for gloss, as presets do; the others are as bundles of before were.
    own = (
        replace(config.materials.grid, finest_resolution=24, num_levels=2)
        if variant == "gloss grid"
        else None
    )
    config = replace(config, materials=replace(config.materials, gloss_grid=own))
    if variant == "occupancy":
        config = replace(config, occupancy=OccupancyConfig(cells=20))
    model = InverseModel(config, DOMAIN)
    with torch.no_grad():
        for module in model.modules():
            if isinstance(module, HashGrid):
                module.table.normal_(0.0, 0.1)
            if isinstance(module, torch.nn.Linear):
                module.bias.normal_(0.0, 0.2)
        model.fast.distance_head.weight.normal_(0.0, 0.3)
        model.nerf.density.head.weight.mul_(20.0)
        model.nerf.density.head.bias.fill_(2.0)
        if model.nerf.occupancy is not None:
            filled = torch.ones_like(model.nerf.occupancy.cells, dtype=torch.bool)
            filled[:7] = False
            model.nerf.occupancy.set(filled)
    return model
