"""Means, standard errors and differences of a benchmark are those of the numbers behind them."""

import numpy as np
import pytest
from lambent_run.benchmark.results import average_rows, differences, finished, scene_rows
from support.benchmark_cells import cell, write_result

PSNR = "nvs/psnr"


def made(tmp_path, table):
    """Write results `{(scene, ablation, seed): value}` and return them as read back."""
    cells = [cell(*key) for key in table]
    for key, of in zip(table, cells, strict=True):
        write_result(tmp_path, of, nvs__psnr=(table[key], 0.25))
    return finished(cells, tmp_path)


def test_only_results_of_the_same_inputs_count(tmp_path):
    one, other = cell(), cell(ablation="depth")
    write_result(tmp_path, one, nvs__psnr=(30.0, 0.5))
    write_result(tmp_path, other, nvs__psnr=(29.0, 0.5))
    path = tmp_path / "cells" / other.name / "result.json"
    path.write_text(path.read_text().replace(other.inputs, "c" * 64))
    assert [found.ablation for found, _ in finished([one, other], tmp_path)] == ["full"]


def test_over_seeds_the_error_is_that_of_their_mean(tmp_path):
    numbers = [30.0, 31.0, 33.5]
    results = made(tmp_path, {("crate", "full", seed): value for seed, value in enumerate(numbers)})
    (row,) = scene_rows(results)
    value = row.values[PSNR]
    assert (row.num_runs, value.count, value.over) == (3, 3, "seeds")
    assert value.mean == pytest.approx(np.mean(numbers))
    assert value.standard_error == pytest.approx(np.std(numbers, ddof=1) / np.sqrt(3))


def test_with_one_seed_the_error_is_the_reports_over_views(tmp_path):
    (row,) = scene_rows(made(tmp_path, {("crate", "full", 0): 30.0}))
    assert row.values[PSNR].standard_error == 0.25
    assert row.values[PSNR].over == "views"


def test_means_over_scenes_combine_the_errors_of_the_scenes(tmp_path):
    table = {
        (scene, "full", seed): 30.0 + seed + 4.0 * (scene == "bowl")
        for scene in ("crate", "bowl")
        for seed in (0, 1)
    }
    rows = scene_rows(made(tmp_path, table))
    (mean,) = average_rows(rows)
    errors = [row.values[PSNR].standard_error for row in rows]
    assert mean.scene == ""
    assert mean.num_runs == 4
    assert mean.values[PSNR].mean == pytest.approx(32.5)
    assert mean.values[PSNR].standard_error == pytest.approx(np.hypot(*errors) / 2)


def test_there_is_no_mean_over_scenes_where_an_ablation_lacks_one(tmp_path):
    table = {("crate", "full", 0): 30.0, ("bowl", "full", 0): 31.0, ("crate", "depth", 0): 29.0}
    assert average_rows(scene_rows(made(tmp_path, table))) == []


def test_differences_are_paired_by_scene_and_seed(tmp_path):
    table, gains = {}, []
    for number, (scene, seed) in enumerate([("crate", 0), ("crate", 1), ("bowl", 0)]):
        gains.append(-0.5 - 0.1 * number)
        # The scenes lie far apart, which a difference of means would show as noise.
        table[scene, "full", seed] = 20.0 + 7.0 * number
        table[scene, "depth", seed] = table[scene, "full", seed] + gains[-1]
    value = differences(made(tmp_path, table), [PSNR])["depth"][PSNR]
    assert value.mean == pytest.approx(np.mean(gains))
    assert value.standard_error == pytest.approx(np.std(gains, ddof=1) / np.sqrt(3))
    assert value.count == 3


def test_a_single_pair_has_a_difference_without_an_error(tmp_path):
    value = differences(made(tmp_path, {("crate", "full", 0): 30.0, ("crate", "k2", 0): 30.5}), [PSNR])
    assert value["k2"][PSNR].mean == pytest.approx(0.5)
    assert value["k2"][PSNR].standard_error is None


def test_a_run_without_its_partner_has_no_difference(tmp_path):
    assert differences(made(tmp_path, {("crate", "k2", 0): 30.5}), [PSNR]) == {}
