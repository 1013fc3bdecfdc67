"""The card's pixels are found in photographs that were cut, reduced, bent by a lens and turned."""

from dataclasses import replace

import numpy as np
import pytest
from flashcache.polish.polish import MOST_LIGHTS
from lambent_capture.loading.load import turned
from lambent_core.errors import UsageError
from lambent_core.scene import Camera, Margins, Scene, View
from lambent_proto.v1 import scene_pb2
from lambent_run.run.card_option import GreyCard, parse_grey_card
from lambent_run.run.card_pixels import card_of, card_pixels, check_grey_card
from support.captures import look_at
from support.lit_sphere import lit_sphere
from support.sphere_model import sphere_model

WIDTH, HEIGHT = 80, 60
"""Of the photograph; the view shows its part from column 20 and row 10 on, at half the size."""
LEFT, TOP, SIDE = 20, 10, 40
EYE = np.array([3.0, 1.0, 1.2])


def full_camera(turns: int = 0) -> Camera:
    """Return the camera of the photograph, stored turned to the right by so many quarters."""
    upright = View(
        name="v",
        camera=Camera(
            width=WIDTH, height=HEIGHT, focal_x=90.0, focal_y=92.0, centre_x=41.0, centre_y=29.0,
            camera_to_world=look_at(EYE, np.zeros(3)),
        ),
        images={},
    )  # fmt: skip
    return turned(upright, -turns).camera


def frame_for(camera: Camera, path: str = "images/a.jpg", distortion: float | None = None) -> scene_pb2.Frame:
    made = scene_pb2.Camera(
        width=camera.width,
        height=camera.height,
        focal_x=camera.focal_x,
        focal_y=camera.focal_y,
        centre_x=camera.centre_x,
        centre_y=camera.centre_y,
        camera_to_world=camera.camera_to_world.ravel().tolist(),
    )
    if distortion is not None:
        made.lens.width, made.lens.height = camera.width, camera.height
        made.lens.focal_x, made.lens.focal_y = camera.focal_x, camera.focal_y
        made.lens.centre_x, made.lens.centre_y = camera.centre_x, camera.centre_y
        made.lens.distortion.extend([distortion, *[0.0] * 7])
    return scene_pb2.Frame(
        name="v", camera=made, images=[scene_pb2.Image(light="sky", path=path)], split=scene_pb2.SPLIT_TRAIN
    )


def view_of(camera: Camera) -> View:
    """Return the view of the part from `LEFT` and `TOP` on, of `SIDE` pixels squared, at half the size."""
    part = replace(
        camera,
        width=SIDE,
        height=SIDE,
        centre_x=camera.centre_x - LEFT,
        centre_y=camera.centre_y - TOP,
    ).resized(SIDE // 2, SIDE // 2)
    picture = np.ones((SIDE // 2, SIDE // 2, 4), np.float32)
    margins = Margins(
        left=LEFT // 2,
        top=TOP // 2,
        right=(camera.width - LEFT - SIDE) // 2,
        bottom=(camera.height - TOP - SIDE) // 2,
    )
    return View(name="v", camera=part, images={"sky": picture}, margins=margins)


def scene_of(view: View, *, held_back: bool = False, lights: tuple[str, ...] = ("sky",)) -> Scene:
    base = lit_sphere(2, side=4)
    train, test = ((), (view,)) if held_back else ((view,), ())
    return replace(base, train=train, test=test, lights=lights)


def manifest_of(*frames: scene_pb2.Frame, layout: str = "colmap") -> scene_pb2.SceneManifest:
    return scene_pb2.SceneManifest(frames=frames, lights=["sky"], layout=layout)


VIEW = view_of(full_camera())
MANIFEST = manifest_of(frame_for(full_camera()))


def found(box: str, view: View = VIEW, manifest: scene_pb2.SceneManifest = MANIFEST) -> np.ndarray:
    return card_pixels(parse_grey_card(f"a.jpg:{box}"), scene_of(view), manifest)[1]


def refusal(code: str, text: str = "") -> object:
    return pytest.raises(UsageError, match=rf"grey_card\.{code}: .*{text}")


def test_pixels_that_lie_wholly_in_the_box_are_the_cards():
    inside = found("30,20,8,6")
    rows, columns = np.nonzero(inside)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (5, 7, 5, 8)
    assert inside.sum() == 12
    # One pixel of the photograph less on each side cuts a ring of pixels away.
    assert found("29,19,10,8").sum() == 12
    assert found("31,21,8,6").sum() == 3 * 2


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_a_photograph_is_turned_upright_as_its_camera_was_held(turns):
    upright = found("30,20,8,6")
    stored = full_camera(turns)
    lying = turned(VIEW, -turns)
    manifest = manifest_of(frame_for(stored), layout="photographs")
    np.testing.assert_array_equal(found("30,20,8,6", turned(lying, turns), manifest), upright)


def test_captures_with_cameras_keep_the_pixels_of_their_files():
    turns = 1
    stored, lying = full_camera(turns), turned(VIEW, -turns)
    # Turned to the right: what was at row 20 to 26 from above is that far from the right border.
    box = f"{HEIGHT - 26},30,6,8"
    inside = found(box, lying, manifest_of(frame_for(stored)))
    np.testing.assert_array_equal(np.rot90(inside, turns), found("30,20,8,6"))


def test_a_lens_moves_the_box_as_it_moves_the_picture():
    bent = manifest_of(frame_for(full_camera(), distortion=-0.3))
    corner = "20,10,12,12"
    assert found(corner).sum() == 36
    moved = found(corner, manifest=bent)
    # What the file shows at the box's inner edges lies a little farther from the middle without the lens.
    assert moved.sum() == 25
    assert moved[:5, :5].all()


def test_the_rays_go_through_the_cards_pixels_also_of_views_that_are_held_back():
    model = sphere_model(lights=("sky",))
    card = card_of(parse_grey_card("a.jpg:44,28,8,8:0.4"), scene_of(VIEW, held_back=True), MANIFEST, model)
    assert (len(card.rays), card.reflectance) == (16, 0.4)
    local = card.rays.directions.numpy() @ VIEW.camera.camera_to_world[:3, :3]
    column = VIEW.camera.centre_x + VIEW.camera.focal_x * local[:, 0] / -local[:, 2]
    row = VIEW.camera.centre_y - VIEW.camera.focal_y * local[:, 1] / -local[:, 2]
    np.testing.assert_allclose(np.unique(column.round(3)), [12.5, 13.5, 14.5, 15.5], atol=2e-3)
    np.testing.assert_allclose(np.unique(row.round(3)), [9.5, 10.5, 11.5, 12.5], atol=2e-3)


def test_a_photograph_that_is_not_used_or_could_be_two_is_refused():
    with refusal("photograph_unused", "sky"):
        card_pixels(parse_grey_card("b.jpg:1,1,8,8"), scene_of(VIEW), MANIFEST)
    twice = manifest_of(frame_for(full_camera()), frame_for(full_camera(), "other/a.jpg"))
    with refusal("photograph_ambiguous", "images/a.jpg, other/a.jpg"):
        found("30,20,8,6", manifest=twice)
    named = card_pixels(parse_grey_card("images/a.jpg:30,20,8,6"), scene_of(VIEW), twice)
    assert named[1].sum() == 12


def test_a_box_outside_the_photograph_is_refused_with_its_size():
    for box in ("73,20,8,6", "30,55,8,6"):
        with refusal("box_outside", "80 x 60"):
            found(box)


def test_a_box_of_hardly_a_pixel_is_refused():
    with refusal("box_small", "2 whole pixels"):
        found("30,20,4,3")


def test_a_card_beside_the_mask_or_the_part_that_is_kept_is_refused():
    with refusal("outside_mask", "25 %"):
        found("16,6,8,8")
    half = VIEW.images["sky"].copy()
    half[:, 7:, 3] = 0.5
    masked = replace(VIEW, images={"sky": half})
    assert found("30,20,8,6", masked).sum() == 6
    half[:, 6:, 3] = 0.5
    with refusal("outside_mask", "25 %"):
        found("30,20,8,6", masked)


def test_an_overexposed_card_is_refused():
    flags = np.zeros((SIDE // 2, SIDE // 2, 3), bool)
    flags[:, 6:, 1] = True
    with refusal("clipped", "overexposed"):
        found("30,20,8,6", replace(VIEW, clipped={"sky": flags}))
    flags[:, :, 1] = False
    flags[:, 7:, 2] = True
    assert found("30,20,8,6", replace(VIEW, clipped={"sky": flags})).sum() == 12


def test_a_capture_whose_materials_are_not_fitted_once_more_cannot_use_a_card():
    card = parse_grey_card("a.jpg:30,20,8,6")
    check_grey_card(card, scene_of(VIEW), MANIFEST)
    with refusal("light_turns"):
        check_grey_card(card, scene_of(replace(VIEW, light_turn=np.eye(3))), MANIFEST)
    many = tuple(f"light{number}" for number in range(MOST_LIGHTS + 1))
    with refusal("many_lights", str(MOST_LIGHTS)):
        check_grey_card(card, scene_of(VIEW, lights=many), MANIFEST)
    with refusal("box_outside"):
        check_grey_card(GreyCard("a.jpg", (0.0, 0.0, 100.0, 1.0)), scene_of(VIEW), MANIFEST)
