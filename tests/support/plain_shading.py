"""The compiled loop over a baked picture's pixels, in plain numpy."""

import numpy as np


def shade_pixels(places, light, lobes, num_pixels):
    """Return what `lambent_relight.baked.kernels.shade_pixels` returns."""
    pixel, within, texel, share, first = places
    straight, bounced, lamps, prefiltered, glint = light
    diffuse, free, around = lobes

    def arriving(values):
        return np.add.reduceat(values * share[:, None], first[:-1], axis=0)

    bounce, mirrored = np.maximum(arriving(bounced[texel]), 0.0), free * prefiltered + glint
    direct, indirect = (
        diffuse * np.maximum(arriving(straight[texel]) + lamps, 0.0) + mirrored,
        (diffuse + around) * bounce,
    )
    specular = mirrored + around * bounce
    out = np.zeros((5, num_pixels, 3), np.float32)
    parts = np.stack([direct + indirect, direct, indirect, direct + indirect - specular, specular])
    np.add.at(out, (slice(None), pixel), within[:, None] * parts)
    return tuple(out)
