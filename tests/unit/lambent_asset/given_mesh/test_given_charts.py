"""Texture coordinates are kept where they are an atlas whose charts do not touch."""

from dataclasses import replace

import numpy as np
import pytest
from lambent_asset.given_mesh.given_charts import chart_of_face, charts_of, touching_share
from lambent_asset.mesh import atlas
from lambent_core.errors import WorkerError
from support.given_glb import SQUARE, SQUARE_FACES, given_mesh

SIZE = 64


def squares(*places):
    """Return squares apart from each other; `places`: left, top, right, bottom in the atlas."""
    count = len(places)
    uv = [[(left, bottom), (right, bottom), (right, top), (left, top)] for left, top, right, bottom in places]
    vertices = np.concatenate([SQUARE + np.float32([3.0 * k, 0.0, 0.0]) for k in range(count)])
    faces = np.concatenate([SQUARE_FACES.astype(np.int32) + 4 * k for k in range(count)])
    return given_mesh(vertices, faces, np.reshape(uv, (-1, 2)))


def test_charts_two_texels_apart_are_kept_and_charts_that_touch_are_not():
    apart = squares((0.0, 0.0, 0.25, 0.5), (0.25 + 2.0 / SIZE, 0.0, 0.5, 0.5))
    touching = squares((0.0, 0.0, 0.25, 0.5), (0.25, 0.0, 0.5, 0.5))
    assert touching_share(apart, SIZE) == 0.0
    # A column of 32 texels on either side, of 32 columns.
    assert touching_share(touching, SIZE) == pytest.approx(2.0 / 32.0)
    assert charts_of(apart, SIZE)[1]
    made, kept = charts_of(touching, SIZE)
    assert not kept
    assert (
        touching_share(
            replace(touching, uv=made.uv, vertices=touching.vertices[made.source], faces=made.faces), SIZE
        )
        == 0.0
    )


def test_charts_one_above_the_other_touch_too():
    assert touching_share(squares((0.0, 0.0, 0.5, 0.25), (0.0, 0.25, 0.5, 0.5)), SIZE) == pytest.approx(
        2.0 / 32.0
    )


def test_the_distance_counts_at_the_size_that_transport_gets():
    """Covering all of the atlas, transport has fewer texels: what is one texel apart then touches."""
    edge, gap = 33.2 / SIZE, 1.1 / SIZE
    full = squares((0.0, 0.0, edge, 1.0), (edge + gap, 0.0, 1.0, 1.0))
    assert touching_share(full, SIZE) == 0.0
    assert not charts_of(full, SIZE)[1]


def test_one_chart_whose_vertices_are_doubled_is_one_chart():
    whole = squares((0.0, 0.0, 0.5, 0.5))
    split = replace(
        whole,
        vertices=whole.vertices[whole.faces.reshape(-1)],
        uv=whole.uv[whole.faces.reshape(-1)],
        normals=whole.normals[whole.faces.reshape(-1)],
        faces=np.arange(6, dtype=np.int32).reshape(-1, 3),
    )
    assert len(np.unique(chart_of_face(split))) == 1
    assert touching_share(split, SIZE) == 0.0
    assert charts_of(split, SIZE)[1]


def test_the_owner_of_a_mesh_is_told_what_an_owner_can_do(monkeypatch):
    class Failing:
        """An unwrapper that finds nothing."""

        atlas_count = chart_count = 0

        def add_mesh(self, *arrays):
            """Take a mesh."""

        def generate(self, **options):
            """Do nothing."""

    monkeypatch.setattr(atlas.xatlas, "Atlas", Failing)
    with pytest.raises(WorkerError, match=r"export\.atlas.*decimate the mesh") as caught:
        charts_of(replace(squares((0.0, 0.0, 1.0, 1.0)), has_uv=(False,)), SIZE)
    assert "max_faces" not in caught.value.message
