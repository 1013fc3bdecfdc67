"""The evaluation protocol in short; docs/reference/protocol.md says the same with reasons."""

VERSION = "1.4"
"""Version of docs/reference/protocol.md."""

SUMMARY = (
    "Pictures are sRGB-encoded, clipped to 0..1 and composited over white in encoded values; PSNR and SSIM "
    "(11 x 11 Gaussian window, standard deviation 1.5) per view, then the mean over views.",
    "Physically based and relit pictures are means of independent repeats in linear light; each comes with "
    "its standard error per pixel, and noise_ceiling is the PSNR that this noise alone would leave.",
    "Pictures and maps are means over a grid of camera rays per pixel, two by two unless the report says "
    "otherwise, weighted with opacity; secondary rays are counted per pixel.",
    "Albedo is scaled by one factor per channel before it is compared: the median of truth / prediction "
    "(albedo_rgb_ratio), or least squares after a gamma of 2.2 (albedo_least_squares); PSNR after that "
    "gamma, over all views at once.",
    "Normals: mean angle in degrees over all pixels, where the background counts as zero (mae_all), and over "
    "the object only (mae_mask).",
    "Relit pictures use albedo times the median ratio, under every test environment for which a map was "
    "given; relight_direct has direct light only, as the paper relights, relight adds one bounce.",
    "Benchmark captures (views with ground truth or an unseen light, and published data sets) are compared "
    "on whole frames; views of other captures on the part around the object that the run's setting crop "
    "leaves.",
    "LPIPS (version 0.1, VGG or AlexNet) is computed from weights given by path, and is absent without them.",
    "Recovered environments: root mean square difference of log radiance over directions and channels, at "
    "32 x 64 pixels, with radiance below 1 % of a channel's mean raised to that, after one factor per "
    "channel (log_rmse) and as they are (log_rmse_unscaled); luminance of the brightest pixel over the true "
    "one's, and the angle between the two; only for lights that were learned and whose true map is known.",
    "OpenIllumination: pictures are multiplied by the object's mask; novel views count from a run in one "
    "light, relit pictures from a run in several; diffuse and specular objects are averaged apart.",
    "The number after plus-minus is the standard error of the mean over views, or over seeds where a table "
    "says so.",
)
"""The rules, each a sentence or two; they appear word for word in the document."""
