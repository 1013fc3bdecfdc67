"""Chooses which of a capture's lights are trained on."""

from lambent_core.errors import UsageError
from lambent_proto.v1 import scene_pb2


def select_lights(
    manifest: scene_pb2.SceneManifest, names: tuple[str, ...] | None = None
) -> scene_pb2.SceneManifest:
    """Return a copy of `manifest` that trains on `names` only; by default on its first light.

    Test frames keep the pictures of the chosen lights and of the relighting lights. Raises `UsageError` for a
    name that is not among the training lights.
    """
    if not names:
        names = tuple(manifest.lights[:1])
    unknown = [name for name in names if name not in manifest.lights]
    if unknown or len(set(names)) != len(names):
        raise UsageError(
            "scene.light_unknown",
            f"--light {','.join(names)}: each must be one of {', '.join(manifest.lights)}, and only once",
        )
    chosen = scene_pb2.SceneManifest()
    chosen.CopyFrom(manifest)
    del chosen.lights[:]
    chosen.lights.extend(names)
    # A layout may offer every light for both; one that is trained on is not a test of relighting.
    relight = [name for name in manifest.relight_lights if name not in names]
    chosen.relight_lights[:] = relight
    for frame in chosen.frames:
        kept = set(names)
        if frame.split == scene_pb2.SPLIT_TEST:
            kept |= set(relight)
        images = [image for image in frame.images if image.light in kept]
        del frame.images[:]
        frame.images.extend(images)
    return chosen
