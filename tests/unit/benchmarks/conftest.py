"""The sphere that several benchmarks' tests cast rays at."""

import pytest
from make_sample_scene import llvm_library
from support.measured_sphere import measured_views

from benchmarks.oracle_geometry import fuse
from benchmarks.oracle_light import ProxySurface


@pytest.fixture(scope="module")
def surface() -> ProxySurface:
    """Return the surface fused from true views of a sphere; skips where no LLVM library can cast rays."""
    if llvm_library() is None:
        pytest.skip("needs an LLVM library to cast rays with (Debian: libllvm19)")
    views = measured_views()
    return ProxySurface(fuse(views, views, (-0.8, -0.8, -0.8), (0.8, 0.8, 0.8), resolution=40))
