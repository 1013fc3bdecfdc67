"""Training and relighting must reflect light alike: the torch and the numpy model are compared."""

import numpy as np
import pytest
import torch
from flashcache.color import alpha_from_perceptual_roughness
from flashcache.geometry import directions as torch_directions
from flashcache.physical import brdf as torch_brdf
from flashcache.physical.sampling import CosineLobe, GgxLobe
from lambent_core import directions as numpy_directions
from lambent_relight import brdf as numpy_brdf

COUNT = 500


def _unit(rng: np.random.Generator) -> np.ndarray:
    return numpy_directions.normalise(rng.normal(size=(COUNT, 3)))


@pytest.fixture
def setting() -> dict[str, np.ndarray]:
    """Return random directions on either side of random surfaces, and random materials."""
    rng = np.random.default_rng(6)
    return {
        "omega_o": _unit(rng),
        "omega_i": _unit(rng),
        "normal": _unit(rng),
        "albedo": rng.random((COUNT, 3)),
        "perceptual_roughness": rng.uniform(0.05, 1.0, (COUNT, 1)),
        "metalness": rng.random((COUNT, 1)),
    }


def _tensors(setting: dict[str, np.ndarray]) -> dict[str, torch.Tensor]:
    return {name: torch.from_numpy(value) for name, value in setting.items()}


def test_both_lobes_are_the_same(setting):
    given = _tensors(setting)
    alpha = alpha_from_perceptual_roughness(given["perceptual_roughness"])
    found = torch_brdf.brdf_cos(
        given["omega_o"],
        given["omega_i"],
        given["normal"],
        torch_brdf.Materials(given["albedo"], alpha, given["metalness"]),
    )
    materials = numpy_brdf.materials_from_roughness(
        setting["albedo"], setting["perceptual_roughness"], setting["metalness"]
    )
    expected = numpy_brdf.brdf_cos(setting["omega_o"], setting["omega_i"], setting["normal"], materials)
    for ours, theirs in zip(found, expected, strict=True):
        assert float(ours.max()) > 0.0
        np.testing.assert_allclose(ours.numpy(), theirs, rtol=1e-9, atol=1e-12)


def test_densities_of_both_lobes_are_the_same_above_the_surface(setting):
    given = _tensors(setting)
    alpha = given["perceptual_roughness"].square()
    omega_i = given["omega_i"].unsqueeze(1)
    above = ((setting["omega_i"] * setting["normal"]).sum(-1) > 0) & (
        (setting["omega_o"] * setting["normal"]).sum(-1) > 0
    )
    cosine = CosineLobe(given["normal"]).pdf(omega_i).numpy()
    ggx = GgxLobe(given["omega_o"], given["normal"], alpha).pdf(omega_i).numpy()
    half = numpy_brdf.half_vector(setting["omega_o"], setting["omega_i"], setting["normal"])
    np.testing.assert_allclose(
        cosine, numpy_brdf.cosine_pdf(setting["omega_i"], setting["normal"]), atol=1e-12
    )
    np.testing.assert_allclose(ggx[above], numpy_brdf.ggx_pdf(half, alpha.numpy())[above], rtol=1e-9)


def test_both_look_up_environments_in_the_same_direction(setting):
    u, v = numpy_directions.uv_of_directions(setting["omega_i"])
    uv = torch_directions.uv_from_direction(torch.from_numpy(setting["omega_i"]))
    np.testing.assert_allclose(uv.numpy(), np.stack([u, v], axis=-1), atol=1e-12)
    pixels = torch_directions.environment_directions(8, 16, torch.float64)
    np.testing.assert_allclose(pixels.numpy(), numpy_directions.pixel_directions(8, 16), atol=1e-12)
    areas = torch_directions.environment_solid_angles(8, 16, torch.float64)
    np.testing.assert_allclose(areas.numpy(), numpy_directions.pixel_solid_angles(8, 16), atol=1e-12)
