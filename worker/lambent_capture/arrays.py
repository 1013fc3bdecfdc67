"""The arrays of this package by name: kinds of numbers and axes that many functions share.

All are `jaxtyping` annotations, so an axis has one length wherever its name is in a signature. A figure at
the end of a name is the number of bits.
"""

from jaxtyping import Bool, Float, Float32, Float64, Int, Int8, Shaped, UInt8
from numpy import ndarray

Grey = Float[ndarray, "height width"]
"""A number for each pixel."""
Grey32 = Float32[ndarray, "height width"]
Grey8 = UInt8[ndarray, "height width"]
Reduced = Float[ndarray, "rows columns"]
"""A number for each pixel of a picture of another size."""
Reduced32 = Float32[ndarray, "rows columns"]
Region = Bool[ndarray, "height width"]
"""Pixels that something holds for."""
Marks = Int8[ndarray, "height width"]
"""A person's marks: 1 object, -1 background, 0 nothing."""
Bins = Int[ndarray, "height width"]
"""The cell of a table that each pixel falls into."""
Rgb = UInt8[ndarray, "height width 3"]
"""A picture in 8-bit sRGB."""
Colours32 = Float32[ndarray, "height width 3"]
"""Three numbers for each pixel."""
Channels32 = Float32[ndarray, "height width channels"]
Levels = Shaped[ndarray, "height width channels"]
"""Pixels as a file stores them, of any kind of number."""
Plane = Shaped[ndarray, "height width"]
"""One channel of them."""
Vector = Float[ndarray, "3"]
"""A place or a direction."""
Vector64 = Float64[ndarray, "3"]
Rotation64 = Float64[ndarray, "3 3"]
Pose64 = Float64[ndarray, "4 4"]
"""A camera-to-world matrix."""
Points = Float[ndarray, "points 3"]
Points64 = Float64[ndarray, "points 3"]
Cells = Float[ndarray, " cells"]
"""A number for each cell of a lattice or a table."""
PerView = Float[ndarray, " views"]
"""A number for each view."""
Texels32 = Float32[ndarray, "cells cells"]
"""A number for each texel of an orthophoto."""
