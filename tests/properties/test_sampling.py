"""Densities integrate to one, samples follow them, and the weights of several strategies share out."""

import math

import pytest
import torch
from flashcache.geometry.directions import direction_from_uv, environment_solid_angles
from flashcache.physical.light_sampler import VmfMixture
from flashcache.physical.sampling import (
    CosineLobe,
    EnvironmentMapSampler,
    GgxLobe,
    draw_directions,
    draw_uniforms,
)
from support.shading import NORMAL, OMEGA_O, peaked_mixture, unit
from support.sphere import bin_masses, bin_shares, without_rare
from support.statistics import assert_mean

ROWS = 4000


def _environment_image(height: int = 16, width: int = 32) -> torch.Tensor:
    image = torch.rand(height, width, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    image[3, 5] = 50.0
    image[:, 20:24] = 0.0
    return image


def _expanded(vector: torch.Tensor, rows: int) -> torch.Tensor:
    return vector.expand(rows, len(vector)).contiguous()


def _strategies(rows: int) -> dict:
    alpha = torch.tensor([1.0], dtype=torch.float64)
    normal, omega_o = _expanded(NORMAL, rows), _expanded(OMEGA_O, rows)
    return {
        "cosine": CosineLobe(normal),
        "ggx_rough": GgxLobe(omega_o, normal, 0.9 * alpha.expand(rows, 1)),
        "ggx_shiny": GgxLobe(omega_o, normal, 0.25 * alpha.expand(rows, 1)),
        "vmf": peaked_mixture(rows, unit(0.5, -0.5, 0.4)),
        "map": EnvironmentMapSampler(_environment_image()),
    }


NAMES = ["cosine", "ggx_rough", "ggx_shiny", "vmf", "map"]


def _axis(name: str) -> torch.Tensor:
    return unit(0.0, 0.0, 1.0) if name == "map" else NORMAL


@pytest.mark.parametrize("name", NAMES)
def test_the_density_integrates_to_one_over_the_sphere(name):
    strategy = _strategies(1)[name]
    # 16 nodes per bin do not resolve the steps of a picture; 64 pixels fall on whole bins.
    masses = bin_masses(lambda omega: strategy.pdf(omega[None])[0], _axis(name), nodes=40)
    error = 5e-2 if name == "map" else 2e-3
    assert float(masses.sum()) == pytest.approx(1.0, abs=error)


def test_the_density_of_a_picture_sums_to_one_over_its_pixels():
    height, width = 16, 32
    v, u = torch.meshgrid(
        (torch.arange(height).double() + 0.5) / height,
        (torch.arange(width).double() + 0.5) / width,
        indexing="ij",
    )
    centres = direction_from_uv(torch.stack([u, v], dim=-1)).reshape(1, -1, 3)
    pdf = EnvironmentMapSampler(_environment_image()).pdf(centres).reshape(height, width)
    total = (pdf * environment_solid_angles(height, width, torch.float64)[:, None]).sum()
    assert float(total) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("stratified", [False, True])
@pytest.mark.parametrize("name", [name for name in NAMES if name != "map"])
def test_samples_follow_the_density(name, stratified):
    strategy = _strategies(ROWS)[name]
    like = torch.zeros(ROWS, 3, dtype=torch.float64)
    u = draw_uniforms(
        (ROWS, 6, strategy.num_uniforms), torch.Generator().manual_seed(7), like, stratified=stratified
    )
    omega = strategy.sample(u)
    torch.testing.assert_close(omega.norm(dim=-1), torch.ones(ROWS, 6, dtype=torch.float64))
    single = _strategies(1)[name]
    expected = bin_masses(lambda omega: single.pdf(omega[None])[0], _axis(name), nodes=40)
    shares, expected = without_rare(bin_shares(omega, _axis(name)), expected, 6 * ROWS)
    assert_mean(shares, expected, expected_error=1e-4)


def test_samples_of_a_picture_fall_into_pixels_in_proportion_to_their_power():
    image = _environment_image()
    sampler = EnvironmentMapSampler(image)
    u = torch.rand(ROWS, 4, 2, generator=torch.Generator().manual_seed(8), dtype=torch.float64)
    omega = sampler.sample(u)
    power = image.sum(dim=-1) * environment_solid_angles(16, 32, torch.float64)[:, None]
    # The picture's rows are bands of polar angle, so that pixels are counted, not the bins of the sphere.
    polar = torch.acos(omega[..., 2]) / math.pi
    turn = (0.5 - torch.atan2(omega[..., 1], omega[..., 0]) / (2.0 * math.pi)) % 1.0
    pixel = (polar * 16).long().clamp(0, 15) * 32 + (turn * 32).long().clamp(0, 31)
    shares = torch.nn.functional.one_hot(pixel, 512).double().mean(dim=1)
    assert_mean(*without_rare(shares, (power / power.sum()).reshape(-1), 4 * ROWS))


def test_a_black_picture_is_sampled_evenly():
    sampler = EnvironmentMapSampler(torch.zeros(8, 16, 3))
    omega = sampler.sample(torch.rand(1, 100, 2, generator=torch.Generator().manual_seed(1)))
    torch.testing.assert_close(sampler.pdf(omega), torch.full((1, 100), 1.0 / (4.0 * math.pi)))


@pytest.mark.parametrize("kappa", [0.5, 5.0, 50.0])
def test_the_mean_cosine_of_a_vmf_lobe_is_the_langevin_function(kappa):
    axis = unit(0.2, 0.7, -0.5)
    mixture = VmfMixture(
        axis.expand(ROWS, 1, 3).contiguous(),
        torch.full((ROWS, 1), kappa, dtype=torch.float64),
        torch.zeros(ROWS, 1, dtype=torch.float64),
    )
    u = torch.rand(ROWS, 25, 3, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    cosine = (mixture.sample(u) * axis).sum(dim=-1)
    assert_mean(cosine.reshape(-1), 1.0 / math.tanh(kappa) - 1.0 / kappa)


def test_a_vmf_lobe_without_concentration_is_uniform():
    mixture = VmfMixture(
        unit(0.0, 0.0, 1.0).expand(1, 1, 3), torch.zeros(1, 1).double(), torch.zeros(1, 1).double()
    )
    omega = mixture.sample(torch.rand(1, 200, 3, generator=torch.Generator().manual_seed(6)).double())
    expected = torch.full((1, 200), 1.0 / (4.0 * math.pi), dtype=torch.float64)
    torch.testing.assert_close(mixture.pdf(omega), expected, rtol=2e-4, atol=0.0)


def test_amplitude_is_the_density_scaled_by_the_total_of_the_lobes():
    mixture = peaked_mixture(1, NORMAL)
    louder = VmfMixture(mixture.means, mixture.kappa, mixture.log_amplitude + math.log(7.0))
    omega = torch.stack([NORMAL, OMEGA_O, -NORMAL])[None]
    torch.testing.assert_close(louder.pdf(omega), mixture.pdf(omega))
    torch.testing.assert_close(louder.amplitude(omega), 7.0 * mixture.pdf(omega))


def test_one_direction_carries_weights_that_share_out_to_one_among_the_strategies():
    strategies = _strategies(1)
    cosine, vmf = strategies["cosine"], strategies["vmf"]
    counts = (3, 5)
    generator = torch.Generator().manual_seed(9)
    drawn = draw_directions(
        [(cosine, counts[:1]), (vmf, counts[1:])], generator, torch.zeros(1, 3, dtype=torch.float64)
    )
    densities = torch.stack([cosine.pdf(drawn.omega_i), vmf.pdf(drawn.omega_i)])
    power = (torch.tensor(counts)[:, None, None] * densities.clamp_min(1e-5)).square()
    shares = power / power.sum(dim=0)
    torch.testing.assert_close(drawn.mis_weight[:, :3], shares[0, :, :3])
    torch.testing.assert_close(drawn.mis_weight[:, 3:], shares[1, :, 3:])
    torch.testing.assert_close(drawn.weight[:, 3:], shares[1, :, 3:] / (5.0 * densities[1, :, 3:]))


def test_two_estimates_drawn_together_are_weighted_each_among_its_own_strategies():
    strategies = _strategies(2)
    cosine, vmf = strategies["cosine"], strategies["vmf"]
    like = torch.zeros(2, 3, dtype=torch.float64)
    drawn = draw_directions([(cosine, (2, 8)), (vmf, (4, 0))], torch.Generator().manual_seed(9), like)
    assert drawn.groups == (2, 4, 8)
    assert drawn.omega_i.shape == (2, 14, 3)
    # The second estimate has the cosine alone.
    torch.testing.assert_close(drawn.mis_weight[:, 6:], torch.ones(2, 8, dtype=torch.float64))
    assert (drawn.mis_weight[:, :6] < 1.0).all()


def test_stratified_variates_of_a_point_are_spread_and_each_is_uniform():
    like = torch.zeros(ROWS, 3, dtype=torch.float64)
    u = draw_uniforms((ROWS, 16, 2), torch.Generator().manual_seed(3), like, stratified=True)
    assert_mean((u.reshape(ROWS, 32) < 0.3).double(), 0.3)
    occupied = (u * 4.0).long()
    cells = torch.nn.functional.one_hot(occupied[..., 0] * 4 + occupied[..., 1], 16).amax(dim=1).sum(dim=1)
    # Independent variates would leave more than a third of the 16 cells empty.
    assert float(cells.double().mean()) > 12.0


def test_one_lattice_goes_on_from_point_to_point_and_each_variate_is_uniform():
    def drawn(seed: int) -> torch.Tensor:
        generator = torch.Generator().manual_seed(seed)
        like = torch.zeros(64, 3, dtype=torch.float64)
        return draw_uniforms((64, 4, 2), generator, like, stratified=True, continued=True)

    several = torch.stack([drawn(seed) for seed in range(400)])
    assert_mean((several[:, 5, 2] < 0.3).double(), torch.tensor(0.3))
    # Four neighbours with four variates each fill a square of 16 cells nearly as one point with 16 would.
    occupied = (several.reshape(400, 16, 16, 2) * 4.0).long()
    cells = torch.nn.functional.one_hot(occupied[..., 0] * 4 + occupied[..., 1], 16).amax(dim=2).sum(dim=2)
    assert float(cells.double().mean()) > 12.0


def test_even_variates_give_even_directions_under_a_map():
    like = torch.zeros(1, 3, dtype=torch.float64)
    sampler = EnvironmentMapSampler(torch.ones(64, 128, 3, dtype=torch.float64))
    worst = 0
    for seed in range(20):
        u = draw_uniforms((1, 64, 2), torch.Generator().manual_seed(seed), like, stratified=True)
        octant = ((sampler.sample(u)[0] > 0.0).long() * torch.tensor([4, 2, 1])).sum(dim=-1)
        worst = max(worst, int((torch.bincount(octant, minlength=8) - 8).abs().max()))
    # 64 independent directions are five off in the worst octant of most draws.
    assert worst <= 3


def test_a_density_below_the_floor_is_raised():
    mixture = VmfMixture(
        NORMAL.expand(1, 1, 3), torch.full((1, 1), 50.0).double(), torch.zeros(1, 1).double()
    )

    class Opposite:
        num_uniforms = 2

        def sample(self, u):
            return -NORMAL.expand(1, u.shape[1], 3)

        def pdf(self, omega_i):
            return mixture.pdf(omega_i)

    drawn = draw_directions([(Opposite(), (4,))], torch.Generator(), torch.zeros(1, 3, dtype=torch.float64))
    torch.testing.assert_close(drawn.weight, torch.full((1, 4), 1.0 / (4 * 1e-5), dtype=torch.float64))


@pytest.mark.parametrize("stratified", [False, True])
def test_two_estimates_drawn_together_share_no_direction(stratified):
    cosine, like = _strategies(50)["cosine"], torch.zeros(50, 3, dtype=torch.float64)
    drawn = draw_directions([(cosine, (3, 8))], torch.Generator().manual_seed(9), like, stratified=stratified)
    exact, fast = drawn.omega_i.split((3, 8), dim=1)
    assert float(torch.cdist(exact, fast).min()) > 1e-6
