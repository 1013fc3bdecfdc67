"""Metrics agree with the reference script, and with what they claim to measure."""

import numpy as np
import pytest
from flashcache.evaluation import metrics
from support.predictions import reference_evaluation

REFERENCE = reference_evaluation()
GENERATOR = np.random.default_rng(0)


def pictures(seed, noise):
    generator = np.random.default_rng(seed)
    truth = generator.random((40, 30, 3))
    truth[10:30, 8:20] = truth[10:30, 8:20].mean(axis=(0, 1))
    return np.clip(truth + generator.normal(0, noise, truth.shape), 0, 1), truth


@pytest.mark.parametrize("noise", [0.0, 0.001, 0.1, 0.7])
@pytest.mark.parametrize("name", ["psnr", "ssim"])
def test_psnr_and_ssim_agree_with_the_reference(name, noise):
    pair = pictures(1, noise)
    assert getattr(metrics, name)(*pair) == pytest.approx(getattr(REFERENCE, name)(*pair), abs=1e-9)


def test_ssim_of_inverted_pictures_agrees_with_the_reference_where_covariance_is_negative():
    _, truth = pictures(3, 0.0)
    assert metrics.ssim(1.0 - truth, truth) == pytest.approx(REFERENCE.ssim(1.0 - truth, truth), abs=1e-9)
    assert metrics.ssim(1.0 - truth, truth) < 0.0


def test_ssim_agrees_with_scikit_image():
    from skimage.metrics import structural_similarity

    prediction, truth = pictures(4, 0.1)
    theirs = structural_similarity(
        prediction,
        truth,
        channel_axis=-1,
        gaussian_weights=True,
        sigma=1.5,
        truncate=5 / 1.5,
        use_sample_covariance=False,
        data_range=1.0,
        full=True,
    )[1][5:-5, 5:-5].mean()
    assert metrics.ssim(prediction, truth) == pytest.approx(theirs, abs=1e-6)


def test_compositing_over_white_agrees_with_the_reference():
    rgba = GENERATOR.random((9, 7, 4))
    np.testing.assert_allclose(metrics.over_white(rgba), REFERENCE.on(rgba, 1))


@pytest.mark.parametrize("truth_ratio", [[1.0, 1.0, 1.0], [2.0, 0.5, 1.3]])
def test_both_albedo_ratios_recover_a_known_factor(truth_ratio):
    prediction = GENERATOR.random((500, 3)) * 0.5 + 0.1
    truth = prediction * truth_ratio
    np.testing.assert_allclose(metrics.median_albedo_ratio(truth, prediction), truth_ratio)
    np.testing.assert_allclose(metrics.least_squares_albedo_ratio(truth, prediction), truth_ratio)


def test_the_median_ratio_is_not_moved_by_a_few_wild_pixels():
    prediction = np.full((101, 3), 0.5)
    truth = np.full((101, 3), 0.25)
    truth[:40] = 1.0
    np.testing.assert_allclose(metrics.median_albedo_ratio(truth, prediction), 0.5)


def test_the_least_squares_ratio_is_the_best_one():
    prediction = GENERATOR.random((400, 3))
    truth = GENERATOR.random((400, 3))
    best = metrics.least_squares_albedo_ratio(truth, prediction)

    def error(ratio):
        after = metrics.with_albedo_gamma(prediction * ratio)
        return metrics.mean_squared_error(after, metrics.with_albedo_gamma(truth))

    assert error(best) <= min(error(best * 1.02), error(best * 0.98))


def test_scaled_albedo_is_white_outside_the_mask_and_within_range():
    albedo = GENERATOR.random((6, 5, 4))
    mask = GENERATOR.random((6, 5)) > 0.5
    scaled = metrics.scaled_albedo(albedo, np.array([3.0, 1.0, 0.5]), mask)
    np.testing.assert_array_equal(scaled[~mask], 1.0)
    assert scaled.min() >= 0.0
    assert scaled.max() <= 1.0


@pytest.mark.parametrize("degrees", [0.0, 0.01, 30.0, 90.0, 180.0])
def test_angular_error_is_the_angle(degrees):
    angle = np.radians(degrees)
    first = np.array([[1.0, 0.0, 0.0]])
    second = np.array([[np.cos(angle), np.sin(angle), 0.0]])
    assert metrics.angular_error(first, second)[0] == pytest.approx(degrees, abs=1e-4)


def test_normals_with_background_agree_with_the_reference():
    encoded = GENERATOR.random((8, 8, 4))
    ours = metrics.normal_with_background(encoded[..., :3] * 2 - 1, encoded[..., 3:])
    np.testing.assert_allclose(ours, REFERENCE.normals(encoded, True), atol=1e-12)


def test_the_standard_error_of_pooled_psnr_matches_what_repeating_gives():
    generator = np.random.default_rng(5)
    errors = generator.gamma(4.0, 0.001, (4000, 20))
    spread = (-10 * np.log10(errors.mean(axis=1))).std()
    typical = np.median([metrics.psnr_standard_error(row) for row in errors])
    assert typical == pytest.approx(spread, rel=0.1)


def test_one_view_has_no_standard_error():
    assert metrics.standard_error(np.array([3.0])) == 0.0
    assert metrics.psnr_standard_error(np.array([0.0, 0.0])) == 0.0
    assert metrics.standard_error(np.array([1.0, 3.0])) == pytest.approx(1.0)


@pytest.mark.parametrize("level", [0.001, 0.02, 0.3, 0.9])
def test_the_encoded_standard_error_is_that_of_encoded_samples(level):
    width = 0.01 * level
    samples = level + width * GENERATOR.standard_normal(400_000)
    encoded = np.where(samples <= 0.0031308, 12.92 * samples, 1.055 * samples ** (1 / 2.4) - 0.055)
    rgba = np.array([[encoded.mean()] * 3 + [0.5]])
    found = metrics.encoded_standard_error(rgba, np.full((1, 3), width))
    np.testing.assert_allclose(found, 0.5 * encoded.std(), rtol=0.01)


def test_clipped_pixels_have_no_encoded_error():
    assert not metrics.encoded_standard_error(np.ones((4, 4)), np.ones((4, 3))).any()
