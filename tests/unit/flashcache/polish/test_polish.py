"""The whole polish on a ball that needs no training."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from flashcache.data.ray_batches import PixelChoice, TrainingPixels
from flashcache.evaluation.surface_points import project
from flashcache.polish import polish as whole
from flashcache.polish import write
from flashcache.polish.elements import MOST_OBSERVATIONS, find_elements
from flashcache.polish.incoming import BELOW, SIDE, incoming_tables
from flashcache.polish.normals import plane_normals
from flashcache.polish.octahedron import octahedral_directions
from flashcache.polish.polish import LEAST_ELEMENTS, NUM_PARTS, polish
from support import lit_sphere
from support.sphere_model import RADIUS, sphere_model

QUARTER = ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))


@pytest.fixture(scope="module")
def scene():
    before = lit_sphere.RADIUS
    # Pictures of the model's ball; its edge is soft.
    lit_sphere.RADIUS = 0.8 * RADIUS
    try:
        return lit_sphere.lit_sphere(num_views=14, side=40)
    finally:
        lit_sphere.RADIUS = before


@pytest.fixture(scope="module")
def model():
    torch.manual_seed(0)
    return sphere_model(lights=("sky",)).eval().requires_grad_(False)


def pixels_of(scene) -> TrainingPixels:
    return TrainingPixels(scene, PixelChoice(clipped="at_least"), torch.device("cpu"))


@pytest.fixture(scope="module")
def elements(scene, model):
    with torch.no_grad():
        return find_elements(model, pixels_of(scene), torch.Generator().manual_seed(0))


def test_elements_lie_on_the_surface_and_hold_what_photographs_show_there(scene, elements):
    assert len(elements) >= LEAST_ELEMENTS
    radius = elements.positions.norm(dim=-1)
    assert float(radius.std()) < 0.05
    assert int(elements.counts.min()) >= 2
    assert int(elements.counts.max()) <= MOST_OBSERVATIONS
    assert int(elements.first[-1]) == len(elements.colour)
    upper = elements.points[:, 2] > 0.1
    lower = elements.points[:, 2] < -0.1
    assert torch.allclose(elements.colour[upper].mean(dim=0), torch.from_numpy(lit_sphere.TOP), atol=0.02)
    assert torch.allclose(elements.colour[lower].mean(dim=0), torch.from_numpy(lit_sphere.BOTTOM), atol=0.02)


def test_an_observation_looks_at_its_camera(scene, elements):
    eyes = np.stack([view.camera.position for view in scene.train])
    to_eyes = torch.from_numpy(eyes).float()[None] - elements.points[:50, None]
    cosine = (torch.nn.functional.normalize(to_eyes, dim=-1) * elements.omega_o[:50, None]).sum(dim=-1)
    assert float(cosine.max(dim=1).values.min()) > 0.99999
    camera = scene.train[int(cosine[0].argmax())].camera
    where = project(camera, elements.points[:1])
    assert abs(float(where.column[0]) % 1.0 - 0.5) < 0.05


def test_a_plane_through_neighbours_faces_outwards_and_is_the_spheres(elements):
    normal = plane_normals(elements)
    outwards = torch.nn.functional.normalize(elements.positions, dim=-1)
    predicted = (elements.normal * outwards).sum(dim=-1)
    cosine = (normal * outwards).sum(dim=-1) * predicted.sign()
    assert float(cosine.median()) > 0.97
    assert torch.allclose(normal.norm(dim=-1), torch.ones(len(normal)), atol=1e-5)


def test_tables_hold_the_fast_caches_answers_above_the_horizon(model, elements):
    some = replace(elements, positions=elements.positions[:20], normal=elements.normal[:20])
    tables = incoming_tables(model, some, 1)
    directions = octahedral_directions(SIDE)
    asked = (some.normal @ directions.T) > BELOW
    row, column = (int(part[7]) for part in asked.nonzero(as_tuple=True))
    origin = some.positions[row] + model.limits.origin_offset * some.normal[row]
    answer = model.fast(origin[None], directions[column][None], torch.zeros(1, dtype=torch.long))
    assert float(tables.clear[row, column]) == pytest.approx(1.0 - float(answer.opacity), abs=1e-5)
    assert torch.allclose(tables.near[0, row, column], answer.near_radiance[0], atol=1e-5)
    assert float(tables.clear[~asked].abs().max()) == 0.0


def test_a_polish_changes_materials_normals_and_light_and_leaves_shape_and_caches(scene, model):
    polished = copy.deepcopy(model)
    parts: list[int] = []
    report = polish(polished, pixels_of(scene), seed=0, advance=parts.append)
    assert report.kept == ""
    assert parts == list(range(1, NUM_PARTS + 1))
    assert report.values["elements"] >= LEAST_ELEMENTS
    moved = {
        name.split(".")[0] + "." + name.split(".")[1]
        for (name, after), before in zip(
            polished.state_dict().items(), model.state_dict().values(), strict=True
        )
        if not torch.equal(after, before)
    }
    assert all(name.startswith(("materials.", "environment.", "nerf.normals")) for name in moved)
    assert any(name.startswith("materials.") for name in moved)
    with torch.no_grad():
        top, bottom = (
            polished.materials(torch.tensor([[0.0, 0.0, height * float(RADIUS) * 0.8]])).albedo[0]
            for height in (0.9, -0.9)
        )
    # The photographs' colours, up to the brightness of the light.
    assert top[0] - top[2] > bottom[0] - bottom[2] + 0.1


def test_the_same_seed_gives_the_same_model(scene, model, monkeypatch):
    monkeypatch.setattr(whole, "ROUNDS", 0)
    for name in ("MATERIAL_STEPS", "NORMAL_STEPS", "LIGHT_STEPS"):
        monkeypatch.setattr(write, name, 10)
    first, second = copy.deepcopy(model), copy.deepcopy(model)
    for each in (first, second):
        polish(each, pixels_of(scene), seed=3)
    for one, other in zip(first.state_dict().values(), second.state_dict().values(), strict=True):
        assert torch.equal(one, other)


def test_stage_two_is_kept_with_a_reason_where_there_is_nothing_to_fit(scene, model, monkeypatch):
    kept = copy.deepcopy(model)
    few = replace(scene, train=scene.train[:1])
    report = polish(kept, pixels_of(few), seed=0)
    assert "two photographs" in report.kept
    turns = tuple(tuple(value for row in turn for value in row) for turn in (np.eye(3).tolist(), QUARTER))
    turning = sphere_model(lights=("sky",), turns=turns)
    assert "turns" in polish(turning, pixels_of(scene), seed=0).kept
    monkeypatch.setattr(whole, "MOST_LIGHTS", 0)
    assert "lights" in polish(kept, pixels_of(scene), seed=0).kept
    for after, before in zip(kept.state_dict().values(), model.state_dict().values(), strict=True):
        assert torch.equal(after, before)


def test_a_polish_that_is_stopped_leaves_the_model_as_it_was(scene, model):
    stopped = copy.deepcopy(model)

    class EnoughError(Exception):
        pass

    def advance(part: int) -> None:
        if part == 3:
            raise EnoughError

    with pytest.raises(EnoughError):
        polish(stopped, pixels_of(scene), seed=0, advance=advance)
    for after, before in zip(stopped.state_dict().values(), model.state_dict().values(), strict=True):
        assert torch.equal(after, before)
