import math
from dataclasses import replace

import pytest
import torch
from flashcache.data.ray_batches import TrainingPixels
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from flashcache.training.stage_one import StageOne
from support.joint_stage import DOMAIN, SCENE


def test_the_rates_of_stage_one_rise_along_a_sine_over_the_warm_up():
    config = tiny()
    settings = replace(config.stage_one, num_rays=16, num_steps=1000, warmup_steps=3, final_rate=1.0)
    torch.manual_seed(0)
    pixels = TrainingPixels(SCENE, config.pixels, torch.device("cpu"))
    made = StageOne(InverseModel(config.model, DOMAIN), pixels, settings, seed=0)
    shares = []
    for _ in range(4):
        made.step()
        shares += {group["lr"] / group["peak"] for group in made.optimiser.param_groups}
    assert shares == pytest.approx([math.sin(math.pi / 6.0), math.sin(math.pi / 3.0), 1.0, 1.0])
