"""Compiled loops of baked relighting. They release the interpreter lock and write only their outputs."""

import numpy as np
from lambent_compute.compiling import compiled
from numpy.typing import NDArray

Rows = NDArray[np.float32]


def shade_pixels(
    places: tuple[NDArray[np.int64], Rows, NDArray[np.int32], Rows, NDArray[np.int64]],
    light: tuple[Rows, Rows, Rows, Rows, Rows],
    lobes: tuple[Rows, Rows, Rows],
    num_pixels: int,
) -> tuple[Rows, ...]:
    """Return the radiance of all `num_pixels` pixels: whole, direct, indirect, diffuse, specular, [pixel, 3].

    `places`: pixels that show the object, which share of its pixel each of these rows is, their texels, how
    much each of these counts, where each row's begin. `light`: irradiance by the sky and by other surfaces
    per texel; by dominant lights, prefiltered radiance and reflected dominant lights per row. `lobes`:
    factors of diffuse, free and surrounded reflection (`lambent_relight.baked.shading.Lobes`).
    """
    out = np.zeros((5, num_pixels, 3), np.float32)
    _shade_pixels(*places, *light, *lobes, out)
    return tuple(out)


@compiled()
def _shade_pixels(
    pixel,
    within,
    texel,
    share,
    first,
    straight,
    bounced,
    lamps,
    prefiltered,
    glint,
    diffuse,
    free,
    around,
    out,
):
    zero = np.float32(0.0)
    for number in range(len(pixel)):
        start, end = first[number], first[number + 1]
        p, part = pixel[number], within[number]
        for channel in range(3):
            arriving, bounce = lamps[number, channel], np.float32(0.0)
            for place in range(start, end):
                t = texel[place]
                arriving += share[place] * straight[t, channel]
                bounce += share[place] * bounced[t, channel]
            arriving, bounce = max(arriving, zero), max(bounce, zero)
            mirrored = free[number, channel] * prefiltered[number, channel] + glint[number, channel]
            surrounding = around[number, channel] * bounce
            scattered = diffuse[number, channel] * arriving
            scattered_again = diffuse[number, channel] * bounce
            out[1, p, channel] += part * (scattered + mirrored)
            out[2, p, channel] += part * (scattered_again + surrounding)
            out[3, p, channel] += part * (scattered + scattered_again)
            out[4, p, channel] += part * (mirrored + surrounding)
            out[0, p, channel] += part * (scattered + scattered_again + mirrored + surrounding)
