"""The compiled loop over a baked picture's pixels, in plain numpy."""

import numpy as np


def shade_pixels(places, light, lobes, num_pixels):
    """Return what `lambent_relight.baked.kernels.shade_pixels` returns."""
    pixel, texel, share, first = places
    straight, bounced, prefiltered, glint = light
    diffuse, free, around = lobes

    def arriving(values):
        return np.maximum(np.add.reduceat(values * share[:, None], first[:-1], axis=0), 0.0)

    bounce, mirrored = arriving(bounced[texel]), free * prefiltered + glint
    direct, indirect = diffuse * arriving(straight[texel]) + mirrored, (diffuse + around) * bounce
    specular = mirrored + around * bounce
    out = np.zeros((5, num_pixels, 3), np.float32)
    out[:, pixel] = direct + indirect, direct, indirect, direct + indirect - specular, specular
    return tuple(out)
