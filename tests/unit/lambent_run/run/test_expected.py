"""Expected times of a run, compared with measured ones."""

from dataclasses import replace

import pytest
from flashcache.presets import preset
from lambent_run.run.expected import expected_seconds
from lambent_run.run.hashes import TASKS

TRAINED = ("cache", "joint", "evaluate", "export")


def total(name: str, cores: int, **changes) -> float:
    seconds = expected_seconds(replace(preset(name), **changes), cores)
    return sum(seconds[task] for task in TRAINED)


def test_every_task_has_an_expected_time():
    assert set(expected_seconds(preset("fast"), 2)) == set(TASKS)


def test_twice_the_steps_take_twice_the_time_but_for_the_beginning():
    config = preset("fast")
    double = replace(config, stage_one=replace(config.stage_one, num_steps=2 * config.stage_one.num_steps))
    one, two = (expected_seconds(each, 2)["cache"] for each in (config, double))
    assert two == pytest.approx(2.0 * one, rel=0.05)


def test_more_cores_are_faster_but_not_without_end():
    seconds = [total("fast", cores) for cores in (1, 2, 4, 64)]
    assert seconds[:3] == sorted(seconds[:3], reverse=True)
    assert seconds[0] / seconds[1] > 1.3
    assert seconds[-1] > 0.3 * seconds[0]


def test_an_export_is_expected_to_take_about_what_it_took():
    # The still life with `fast` on two cores: 64 s of the processor, hardly any of it in parallel.
    assert 30.0 < expected_seconds(preset("fast"), 2)["export"] < 90.0
    # The limit of the mesh's cells is not what they are: photographs of 128 pixels do not fill it.
    finer = preset("fast")
    finer = replace(finer, export=replace(finer.export, mesh_resolution=4096))
    assert expected_seconds(finer, 2)["export"] == expected_seconds(preset("fast"), 2)["export"]


def test_presets_are_in_the_order_of_their_promises():
    assert total("tiny", 2) < total("quick", 2) < total("fast", 2) < total("long", 2)
