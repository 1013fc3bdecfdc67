"""The whole polish on a ball that needs no training."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from flashcache.data.ray_batches import PixelChoice, TrainingPixels
from flashcache.evaluation.surface_points import project
from flashcache.geometry.octahedron import octahedral_directions
from flashcache.physical.model import InverseModel
from flashcache.polish import gate as gate_of
from flashcache.polish import polish as whole
from flashcache.polish import write
from flashcache.polish.correction import MOST
from flashcache.polish.elements import MOST_OBSERVATIONS, find_elements
from flashcache.polish.gate import blended, gate
from flashcache.polish.incoming import BELOW, SIDE, incoming_tables
from flashcache.polish.known_light import KnownLightVerdict
from flashcache.polish.light import Reflectance
from flashcache.polish.neighbours import Neighbours
from flashcache.polish.normals import plane_normals, tilted
from flashcache.polish.polish import LEAST_ELEMENTS, NUM_PARTS, polish
from support import lit_sphere
from support.polished_ball import pictures_of_the_model, trained_ball
from support.sphere_model import sphere_model

QUARTER = ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))


@pytest.fixture(scope="module")
def scene():
    return pictures_of_the_model()


@pytest.fixture(scope="module")
def model():
    return trained_ball()


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


def test_places_of_a_pixel_lie_on_its_ray_and_around_what_it_shows(elements):
    away = elements.places - elements.points[:, None]
    across = away - (away * elements.omega_o[:, None]).sum(dim=-1, keepdim=True) * elements.omega_o[:, None]
    assert float(across.norm(dim=-1).max()) < 1e-4
    depth = (away * elements.omega_o[:, None]).sum(dim=-1)
    # From near to far, in equal parts of the weight.
    assert bool((depth.diff(dim=1) <= 1e-6).all())
    assert float(depth.mean(dim=1).abs().mean()) < elements.size


def test_every_fifth_photograph_is_kept_from_the_fit(elements):
    seen, checks = elements.split()
    assert int(seen.counts.min()) >= 2
    assert bool((checks.photograph % 5 == 4).all())
    assert len(seen.colour) + len(checks.colour) == len(elements.colour)
    assert not set(seen.pixel.tolist()) & set(checks.pixel.tolist())
    torch.testing.assert_close(seen.positions, elements.positions)
    # Rows stay with their elements.
    rows = {int(pixel): int(element) for pixel, element in zip(elements.pixel, elements.element, strict=True)}
    for part in (seen, checks):
        assert [rows[int(pixel)] for pixel in part.pixel] == part.element.tolist()


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


def test_a_polish_changes_materials_normals_and_light_and_leaves_shape_and_caches(
    scene, model, elements, monkeypatch
):
    # A light that takes on the colours would explain them as well.
    monkeypatch.setattr(whole, "LIGHT_STEPS", 0)
    polished = copy.deepcopy(model)
    polished.environment.set_texture(torch.ones(1, 16, 3))
    parts: list[int] = []
    report = polish(polished, pixels_of(scene), seed=0, advance=parts.append)
    assert report.kept == ""
    assert parts == list(range(1, NUM_PARTS + 1))
    assert report.values["elements"] >= LEAST_ELEMENTS
    begun = model.state_dict()
    assert set(polished.state_dict()) - set(begun) == {"environment.texture"}
    moved = {
        name.split(".")[0] + "." + name.split(".")[1]
        for name, after in polished.state_dict().items()
        if name not in begun or not torch.equal(after, begun[name])
    }
    assert all(name.startswith(("materials.", "environment.", "nerf.normals")) for name in moved)
    assert any(name.startswith("materials.") for name in moved)
    with torch.no_grad():
        albedo = polished.materials(elements.points).albedo
    top, bottom = (
        albedo[side].mean(dim=0) for side in (elements.points[:, 2] > 0.1, elements.points[:, 2] < -0.1)
    )
    # The photographs' colours, up to the brightness of the light.
    assert top[0] - top[2] > bottom[0] - bottom[2] + 0.1


def test_what_unseen_photographs_contradict_is_given_up_and_the_rest_stays(scene, model, elements):
    """A fit that is black below the equator, where photographs are blue, and right above it."""
    pixels = pixels_of(scene)
    _, checks = elements.split()
    with torch.no_grad():
        right = Reflectance(
            torch.where(
                elements.positions[:, 2:] > 0.0, torch.tensor(lit_sphere.TOP), torch.tensor(lit_sphere.BOTTOM)
            ),
            torch.full((len(elements),), 0.3),
            torch.zeros(len(elements)),
            elements.normal,
        )
        below = elements.positions[:, 2] < -0.05
        wrong = replace(right, albedo=torch.where(below[:, None], torch.tensor(0.01), right.albedo))
        even = torch.ones(1, (2 * SIDE) ** 2, 3)
        before, fitted = (
            whole._written(model, elements, each, even, torch.Generator().manual_seed(0)).model
            for each in (right, wrong)
        )
        neighbours = Neighbours.of(elements)
        found = gate(before, fitted, pixels, checks, neighbours, seed=0)
        assert found.fitted > 1.1 * found.before
        assert float(found.share[below].mean()) < 0.2
        # Pooling reaches far on so small a ball.
        assert float(found.share[elements.positions[:, 2] > 0.2].mean()) > 0.6
        assert float(gate(before, before, pixels, checks, neighbours, seed=0).share.min()) == 1.0


def test_noise_of_renderings_is_no_error_of_the_model(scene, model, monkeypatch):
    """Metals have more noise than paint, and would be given up for it."""
    pixels = pixels_of(scene)
    # Neither dark nor white, where noise would be cut.
    colour = pixels.at(pixels.inside).colour
    index = pixels.inside[((colour > 0.02) & (colour < 0.7)).all(dim=1)]
    colour = pixels.at(index).colour
    assert len(index) > 200

    def noisy(model, pixels, index, repeat, *, seed):
        generator = torch.Generator().manual_seed(seed + repeat)
        return colour * (1.0 + 0.1 * torch.randn(colour.shape, generator=generator))

    monkeypatch.setattr(gate_of, "rendered", noisy)
    found = gate_of.picture_errors(model, pixels, index, 7)
    shown = [gate_of._shown(noisy(None, None, None, repeat, seed=7)) for repeat in range(2)]
    one = (shown[0] - gate_of._shown(pixels.at(index).colour)).square().mean()
    assert float(found.mean()) < 0.3 * float(one)


def test_a_second_writing_keeps_the_normals_of_the_first(model, elements):
    turned = Reflectance(
        torch.full((len(elements), 3), 0.5),
        torch.full((len(elements),), 0.3),
        torch.zeros(len(elements)),
        tilted(elements.normal, torch.tensor([[0.3, 0.0]]).expand(len(elements), 2)),
    )
    generator = torch.Generator().manual_seed(0)
    first = whole._written(model, elements, turned, None, generator)
    darker = replace(turned, albedo=0.6 * turned.albedo)
    second = whole._written(model, elements, darker, None, generator, before=first)
    states = [each.nerf.normals.state_dict() for each in (model, first.model, second.model)]
    for name, learned in states[1].items():
        assert torch.equal(states[2][name], learned), name
    assert any(not torch.equal(states[0][name], learned) for name, learned in states[1].items())


def test_a_mean_of_two_reflectances_has_each_at_its_end():
    one = Reflectance(torch.full((2, 3), 0.2), torch.full((2,), 0.1), torch.zeros(2), torch.eye(3)[:2])
    other = Reflectance(torch.full((2, 3), 0.8), torch.full((2,), 0.4), torch.ones(2), torch.eye(3)[1:])
    for share, expected in ((0.0, one), (1.0, other)):
        found = blended(one, other, torch.full((2,), share))
        for name in ("albedo", "alpha", "metalness", "normal"):
            torch.testing.assert_close(getattr(found, name), getattr(expected, name))
    half = blended(one, other, torch.full((2,), 0.5))
    torch.testing.assert_close(half.albedo, torch.full((2, 3), 0.4))
    torch.testing.assert_close(half.alpha, torch.full((2,), 0.2))


def with_photographs(scene, change) -> object:
    """Return the scene with every training photograph, and which of its channels are clipped, changed."""
    views = []
    for view in scene.train:
        changed = {light: change(picture) for light, picture in view.images.items()}
        views.append(
            replace(
                view,
                images={light: picture for light, (picture, _) in changed.items()},
                clipped={light: flags for light, (_, flags) in changed.items()},
            )
        )
    return replace(scene, train=tuple(views))


def all_clipped(picture):
    white = picture.copy()
    white[..., :3] = 1.0
    return white, np.ones((*picture.shape[:2], 3), bool)


def black(picture):
    dark = picture.copy()
    dark[..., :3] = 0.0
    return dark, np.zeros((*picture.shape[:2], 3), bool)


def only_reflections(picture):
    """Stripes that stand still in the picture and so move over the ball: no place has a colour of its own."""
    striped = picture.copy()
    stripe = (np.arange(picture.shape[1]) // 3 % 2).astype(np.float32)
    striped[..., :3] = (0.05 + 0.9 * stripe)[None, :, None]
    return striped, np.zeros((*picture.shape[:2], 3), bool)


def learn_little(monkeypatch):
    monkeypatch.setattr(write, "MATERIAL_STEPS", 10)
    for name in ("FIRST", "AGAIN"):
        monkeypatch.setattr(whole, name, replace(getattr(write, name), steps=10))


@pytest.mark.parametrize("change", [all_clipped, black, only_reflections])
def test_photographs_that_say_nothing_leave_no_value_that_is_not_finite(scene, model, change, monkeypatch):
    learn_little(monkeypatch)
    polished = copy.deepcopy(model)
    report = polish(polished, pixels_of(with_photographs(scene, change)), seed=0)
    for name, value in polished.state_dict().items():
        assert not value.is_floating_point() or bool(torch.isfinite(value).all()), name
    if change is all_clipped:
        assert "clipped" in report.kept
    if change is only_reflections:
        assert report.values["error_fitted"] < report.values["error_before"]


@pytest.mark.parametrize(("believed", "is_metal"), [(0.0, False), (0.7, True)])
def test_where_photographs_leave_it_open_stage_two_says_what_is_metal(
    scene, model, believed, is_metal, monkeypatch
):
    learn_little(monkeypatch)
    joined = whole._joined

    def believing(*given):
        trained = joined(*given)
        return replace(trained, metalness=torch.full_like(trained.metalness, believed))

    monkeypatch.setattr(whole, "_joined", believing)
    report = polish(copy.deepcopy(model), pixels_of(with_photographs(scene, only_reflections)), seed=0)
    assert (report.values["metal_share"] > 0.5) == is_metal
    assert report.values["metal_share"] == 0.0 or is_metal


def test_what_rendered_pixels_ask_for_is_what_the_networks_learn(scene, model, monkeypatch):
    monkeypatch.setattr(whole, "ROUNDS", 1)
    monkeypatch.setattr(whole, "gate", lambda *given: gate_of.Gate(torch.ones(len(given[4].index)), 1.0, 1.0))
    asked = []

    def corrected(render, elements, found, neighbours, seed):
        asked.append((render(elements.pixel[:8], 0), elements.positions, found.albedo))
        return replace(found, albedo=found.albedo / MOST)

    monkeypatch.setattr(whole, "corrected_albedo", corrected)
    polished = copy.deepcopy(model)
    polish(polished, pixels_of(scene), seed=0)
    ((radiance, places, fitted),) = asked
    assert radiance.shape == (8, 3)
    with torch.no_grad():
        learned = polished.materials(places).albedo
    # The largest change that pixels may ask for is learned whole.
    assert float((learned / fitted).median()) == pytest.approx(1.0 / MOST, rel=0.03)


def test_the_same_seed_gives_the_same_model(scene, model, monkeypatch):
    monkeypatch.setattr(whole, "ROUNDS", 1)
    learn_little(monkeypatch)
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


def test_a_polish_says_how_sure_it_is_of_every_element(scene, model, monkeypatch):
    learn_little(monkeypatch)
    monkeypatch.setattr(whole, "LEAST_SHARE", 0.0)
    report = polish(copy.deepcopy(model), pixels_of(scene), seed=0)
    assert report.confidence is not None
    assert len(report.confidence.positions) == report.values["elements"]
    assert float(report.confidence.log_albedo.median()) < 0.7
    assert float(report.confidence.log_albedo.min()) > 0.0


def test_where_photographs_contradict_a_known_light_stage_two_is_kept_and_the_user_is_told(
    scene, model, monkeypatch
):
    known = InverseModel(model.config, replace(model.domain, known_lights=model.domain.lights)).eval()
    known.load_state_dict(model.state_dict(), strict=False)
    rows = model.config.environment.known_height
    known.environment.set_known(0, torch.ones(rows, 2 * rows, 3))
    known.requires_grad_(False)
    verdict = KnownLightVerdict(contradicted=True, error=3.0, excess=8.0, sureness=9.0)
    asked = []

    def judged(elements, tables, sky, *given, known, refit):
        asked.append((float(sky.min()), float(sky.max()), tuple(known)))
        return verdict

    monkeypatch.setattr(whole, "judge_by_elements", judged)
    kept = copy.deepcopy(known)
    report = polish(kept, pixels_of(scene), seed=0)
    assert asked == [(1.0, 1.0, (0,))]
    assert "contradict the known light" in report.kept
    assert report.findings == verdict.findings
    assert report.confidence is None
    for after, before in zip(kept.state_dict().values(), known.state_dict().values(), strict=True):
        assert torch.equal(after, before)
