"""Metrics of predicted against true pictures and maps, as published baselines compute them.

Pictures are float arrays in 0..1. "Encoded" means sRGB-encoded; albedo is linear. Masks are true on the
object. The protocol these functions are put together to is docs/reference/protocol.md.
"""

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from numpy.lib.stride_tricks import sliding_window_view

ALBEDO_GAMMA = 2.2
"""Exponent on which albedo is compared (TensoIR's evaluation), not the sRGB curve."""
RATIO_FLOOR = 1e-6
UP = (0.0, 0.0, 1.0)
"""Normal of the background."""


def over_white(rgba: Float[ndarray, "*shape 4"]) -> Float[ndarray, "*shape 3"]:
    """Return a straight-alpha picture composited over white, in whatever encoding it has."""
    return rgba[..., :3] * rgba[..., 3:] + (1.0 - rgba[..., 3:])


def mean_squared_error(prediction: Float[ndarray, "*shape"], truth: Float[ndarray, "*shape"]) -> float:
    """Return the mean squared difference over all pixels and channels."""
    return float(np.mean(np.square(prediction.astype(np.float64) - truth)))


def psnr_from_error(error: float) -> float:
    """Return a mean squared error as peak signal-to-noise ratio in dB for a peak of 1; infinite for none."""
    return float("inf") if error == 0.0 else float(-10.0 * np.log10(error))


def psnr(prediction: Float[ndarray, "*shape"], truth: Float[ndarray, "*shape"]) -> float:
    """Return the peak signal-to-noise ratio in dB over the whole picture, peak 1."""
    return psnr_from_error(mean_squared_error(prediction, truth))


def ssim(
    prediction: Float[ndarray, "height width channels"], truth: Float[ndarray, "height width channels"]
) -> float:
    """Return the mean structural similarity, at most 1, where the whole window fits into the picture.

    Gaussian window of 11 x 11 pixels with a standard deviation of 1.5, k1 = 0.01, k2 = 0.03, data range 1;
    the covariance is limited to what the variances allow. The picture must have at least 11 x 11 pixels.
    Source: Wang et al. 2004, in the variant that TensoIR's evaluation uses.
    """
    x, y = prediction.astype(np.float64), truth.astype(np.float64)
    mean_x, mean_y = _blurred(x), _blurred(y)
    variance_x = np.maximum(_blurred(x * x) - mean_x**2, 0.0)
    variance_y = np.maximum(_blurred(y * y) - mean_y**2, 0.0)
    bound = np.sqrt(variance_x * variance_y)
    covariance = np.clip(_blurred(x * y) - mean_x * mean_y, -bound, bound)
    c1, c2 = 0.01**2, 0.03**2
    luminance = (2.0 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1)
    structure = (2.0 * covariance + c2) / (variance_x + variance_y + c2)
    return float(np.mean(luminance * structure))


def _blurred(picture: Float[ndarray, "height width channels"]) -> Float[ndarray, "rows columns channels"]:
    offsets = np.arange(11) - 5.0
    kernel = np.exp(-0.5 * (offsets / 1.5) ** 2)
    kernel /= kernel.sum()
    down = sliding_window_view(picture, 11, axis=0) @ kernel
    return sliding_window_view(down, 11, axis=1) @ kernel


def median_albedo_ratio(
    truth: Float[ndarray, "pixels 3"], prediction: Float[ndarray, "pixels 3"]
) -> Float[ndarray, "3"]:
    """Return per channel the median of truth over prediction: the factor that albedo is only known up to.

    Source: TensoIR's evaluation, the protocol of the paper's table 1.
    """
    return np.median(truth.astype(np.float64) / np.maximum(prediction, RATIO_FLOOR), axis=0)


def least_squares_albedo_ratio(
    truth: Float[ndarray, "pixels 3"], prediction: Float[ndarray, "pixels 3"]
) -> Float[ndarray, "3"]:
    """Return per channel the factor on linear values that minimises the squared error after the gamma of 2.2.

    Source: default of the authors' code.
    """
    p = prediction.astype(np.float64).clip(0.0) ** (1.0 / ALBEDO_GAMMA)
    t = truth.astype(np.float64).clip(0.0) ** (1.0 / ALBEDO_GAMMA)
    return (np.sum(p * t, axis=0) / np.maximum(np.sum(p * p, axis=0), RATIO_FLOOR)) ** ALBEDO_GAMMA


def scaled_albedo(
    albedo: Float[ndarray, "height width 4"],
    ratio: Float[ndarray, "3"],
    mask: Bool[ndarray, "height width"],
) -> Float[ndarray, "height width 3"]:
    """Return linear albedo over white, multiplied by `ratio`, in 0..1, and white outside `mask`."""
    scaled = np.clip(over_white(albedo).astype(np.float64) * ratio, 0.0, 1.0)
    return np.where(mask[..., None], scaled, 1.0)


def with_albedo_gamma(albedo: Float[ndarray, "*shape"]) -> Float[ndarray, "*shape"]:
    """Return linear albedo on the scale on which it is compared, `x ** (1 / 2.2)`."""
    return albedo ** (1.0 / ALBEDO_GAMMA)


def normal_with_background(
    normal: Float[ndarray, "*shape 3"], alpha: Float[ndarray, "*shape 1"]
) -> Float[ndarray, "*shape 3"]:
    """Return unit normals blended by `alpha` with the background's, which points up."""
    blended = normal.astype(np.float64) * alpha + (1.0 - alpha) * np.array(UP)
    return blended / np.maximum(np.linalg.norm(blended, axis=-1, keepdims=True), 1e-9)


def angular_error(
    prediction: Float[ndarray, "*shape 3"], truth: Float[ndarray, "*shape 3"]
) -> Float[ndarray, "*shape"]:
    """Return the angle between unit normals in degrees, 0 to 180, per pixel."""
    cosine = np.clip(np.sum(prediction.astype(np.float64) * truth, axis=-1), -1.0, 1.0)
    return np.degrees(np.arccos(cosine))


def root_mean_square(prediction: Float[ndarray, "*shape"], truth: Float[ndarray, "*shape"]) -> float:
    """Return the square root of the mean squared difference."""
    return float(np.sqrt(mean_squared_error(prediction, truth)))


def standard_error(values: Float[ndarray, " views"]) -> float:
    """Return the standard error of the mean of independent values; 0 where there is only one."""
    return float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0


def psnr_standard_error(errors: Float[ndarray, " views"]) -> float:
    """Return the standard error in dB of the PSNR of pooled views, from the mean squared error of each.

    First order: the error of the mean, carried through the logarithm.
    """
    mean = float(np.mean(errors))
    return 10.0 / np.log(10.0) * standard_error(errors) / mean if mean > 0.0 else 0.0


def encoded_standard_error(
    rgba: Float[ndarray, "*shape 4"], standard_error: Float[ndarray, "*shape 3"]
) -> Float[ndarray, "*shape 3"]:
    """Return the standard error of a picture over white in sRGB values, from that in linear radiance.

    `rgba` is encoded, straight alpha. First order, so too small where the noise reaches across the bend of
    the curve; zero where the picture is clipped at white.
    """
    encoded = rgba[..., :3].astype(np.float64)
    slope = np.where(
        encoded <= 0.04045, 12.92, 1.055 / 2.4 * ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** -1.4
    )
    return np.where(encoded < 1.0, slope * standard_error * rgba[..., 3:], 0.0)
